/* Sweep: where straight approaches must stop and may stop, over all configurations of a cell. The same as
   `palpate.recognizer.numpy_cells` and `approach` work out with whole arrays. */

#include "calls.h"
#include "sweep.h"

#define STILL 1e-15

typedef struct {
    double x, y, u, v, rho; /* in the frame of the object in the cell's middle configuration */
} ray;

static void slab(double at, double speed, double lo, double hi, double *enter, double *leave)
{
    if (fabs(speed) < STILL) {
        int inside = at >= lo && at <= hi;
        *enter = inside ? -INFINITY : INFINITY;
        *leave = -*enter;
        return;
    }
    double one = (lo - at) / speed, two = (hi - at) / speed;
    *enter = smaller(one, two);
    *leave = larger(one, two);
}

/* Whether the ray crosses an edge's line between its ends. Neighbours share their corner's numbers, so a ray through a
   corner crosses both of them or neither. */
static int is_crossed(const edge_set *edges, int64_t edge, const ray *path)
{
    const double *start = edges->start + 2 * edge, *end = edges->end + 2 * edge;
    double begins = path->u * (start[1] - path->y) - path->v * (start[0] - path->x);
    double ends = path->u * (end[1] - path->y) - path->v * (end[0] - path->x);
    return (begins > 0) != (ends > 0);
}

/* Where the ray's line is within ρ of an edge: one interval, as a capsule is convex. */
static capsule capsule_of(const edge_set *edges, int64_t edge, const ray *path)
{
    const double *start = edges->start + 2 * edge, *d = edges->direction + 2 * edge;
    double length = edges->length[edge], radius = path->rho;
    double x = path->x - start[0], y = path->y - start[1];
    double along = x * d[0] + y * d[1], across = d[0] * y - d[1] * x;
    double head_along = path->u * d[0] + path->v * d[1], head_across = d[0] * path->v - d[1] * path->u;
    double enter_1, leave_1, enter_2, leave_2;
    slab(along, head_along, 0.0, length, &enter_1, &leave_1);
    slab(across, head_across, -radius, radius, &enter_2, &leave_2);
    capsule found = {larger(enter_1, enter_2), smaller(leave_1, leave_2), 0, edge};
    if (found.enter > found.leave) {
        found.enter = INFINITY;
        found.leave = -INFINITY;
    }
    for (int k = 0; k < 2; k++) {
        double at = k ? along - length : along;
        double middle = -(at * head_along + across * head_across), miss = at * head_across - across * head_along;
        double square = radius * radius - miss * miss;
        if (square >= 0) {
            double half = sqrt(square);
            found.enter = smaller(found.enter, middle - half);
            found.leave = larger(found.leave, middle + half);
        }
    }
    found.crossing = is_crossed(edges, edge, path);
    return found;
}

static int by_enter(const void *one, const void *two)
{
    double a = ((const capsule *)one)->enter, b = ((const capsule *)two)->enter;
    return (a > b) - (a < b);
}

static void sort_by_enter(capsule *near, int count)
{
    if (count > 32) {
        qsort(near, (size_t)count, sizeof(capsule), by_enter);
        return;
    }
    for (int k = 1; k < count; k++) {
        capsule one = near[k];
        int j = k;
        for (; j > 0 && near[j - 1].enter > one.enter; j--)
            near[j] = near[j - 1];
        near[j] = one;
    }
}

/* Edges of a state that may come within ρ of the ray's line before `travel`, into `near`; how many. */
static int beside_line(const edge_set *edges, int64_t state, const ray *path, double travel, int64_t *near)
{
    const double u = path->u, v = path->v, offset = path->y * u - path->x * v, reach = path->rho + 1e-9;
    const double stop = path->x * u + path->y * v + travel;
    const int64_t begin = edges->first[state], end = edges->first[state + 1];
    const struct edge_block *block = edges->blocks + edges->first_block[state];
    int count = 0;
    for (int64_t from = begin; from < end; from += BLOCK_EDGES, block++) {
        const double most = block->reach + reach;
        if (fabs(block->y * u - block->x * v - offset) > most || block->x * u + block->y * v - stop > most)
            continue;
        for (int64_t k = from; k < end && k < from + BLOCK_EDGES; k++) {
            const struct round_edge *one = &edges->around[k];
            const double wide = one->half + reach;
            near[count] = one->edge;
            count += (fabs(one->y * u - one->x * v - offset) <= wide) & (one->x * u + one->y * v - stop <= wide);
        }
    }
    return count;
}

/* Whether the ray can pass `travel`: it cannot pass a place where it is inside of the outline and in no capsule. The
   first such place comes after it has crossed an edge and left that edge's capsule: mostly a look at the edges crossed
   is enough. `room`: for as many capsules as the state has edges. */
static int may_travel(const edge_set *edges, int64_t state, const ray *path, double travel, capsule *room,
                      int64_t *near)
{
    capsule first = {INFINITY, INFINITY, 1, 0};
    int inside = 0;
    /* What is met after the end of the travel opens no place before it. */
    const int count = beside_line(edges, state, path, travel, near);
    for (int k = 0; k < count; k++) {
        room[k].edge = near[k];
        room[k].crossing = is_crossed(edges, near[k], path);
        if (room[k].crossing) {
            capsule one = capsule_of(edges, near[k], path);
            if (one.enter < first.enter)
                first = one;
        }
    }
    if (first.leave >= travel)
        return 1;
    int left = 0;
    for (int k = 0; k < count; k++) {
        capsule one = capsule_of(edges, room[k].edge, path);
        if (one.enter < travel)
            room[left++] = one;
    }
    sort_by_enter(room, left);
    double covered = -INFINITY;
    for (int k = 0; k < left && covered < travel; k++) {
        double following = k + 1 < left ? room[k + 1].enter : INFINITY;
        covered = larger(covered, room[k].leave);
        inside ^= room[k].crossing;
        if (inside && following > covered && following > 0 && larger(covered, 0.0) < travel)
            return 0;
    }
    return 1;
}

typedef struct {
    double cos, sin, half_width, x, y, radius; /* the middle of the polygon's box, and how far its vertices are */
} body;

static body body_of(double lo, double hi, const double *polygon, Py_ssize_t vertices)
{
    double least[2] = {INFINITY, INFINITY}, most[2] = {-INFINITY, -INFINITY}, square = 0.0;
    for (Py_ssize_t k = 0; k < 2 * vertices; k++) {
        least[k % 2] = smaller(least[k % 2], polygon[k]);
        most[k % 2] = larger(most[k % 2], polygon[k]);
    }
    double middle = (lo + hi) / 2;
    body found = {cos(middle), sin(middle), (hi - lo) / 2, (least[0] + most[0]) / 2, (least[1] + most[1]) / 2, 0.0};
    for (Py_ssize_t k = 0; k < vertices; k++) {
        double x = polygon[2 * k] - found.x, y = polygon[2 * k + 1] - found.y;
        square = larger(square, x * x + y * y);
    }
    found.radius = sqrt(square);
    return found;
}

/* ρ covers the whole cell, the outline's slack and the approach's bound. */
static ray ray_of(const edge_set *edges, int64_t state, const body *part, const approach *path)
{
    double lever = edges->state_reach[state] + part->radius + sqrt(part->x * part->x + part->y * part->y);
    ray found = {
        part->cos * path->x + part->sin * path->y - part->x,
        part->cos * path->y - part->sin * path->x - part->y,
        part->cos * path->u + part->sin * path->v,
        part->cos * path->v - part->sin * path->u,
        part->half_width * lever + part->radius + edges->state_slack[state] + path->bound,
    };
    return found;
}

int take_paths(buffers *all, PyObject *sets_in, PyObject *paths_in, paths *taken)
{
    memset(taken, 0, sizeof(paths));
    taken->count = PyTuple_Size(sets_in);
    if (!(taken->sets = malloc((size_t)(taken->count + 1) * sizeof(edge_set *)))) {
        PyErr_NoMemory();
        return 0;
    }
    if (!take_sets(sets_in, taken->sets) ||
        !(taken->path = borrow(all, paths_in, taken->count * (Py_ssize_t)sizeof(approach))))
        return 0;
    int64_t most = 1;
    for (Py_ssize_t k = 0; k < taken->count; k++)
        most = taken->sets[k]->most_edges > most ? taken->sets[k]->most_edges : most;
    taken->room = malloc((size_t)most * sizeof(capsule));
    taken->near = malloc((size_t)(most + 1) * sizeof(int64_t));
    if (!taken->room || !taken->near) {
        PyErr_NoMemory();
        return 0;
    }
    return 1;
}

void end_paths(paths *taken)
{
    free(taken->sets);
    free(taken->room);
    free(taken->near);
}

int paths_are_free(const paths *of, int64_t state, double lo, double hi, const double *polygon, Py_ssize_t vertices,
                   const char *skipped)
{
    const body part = body_of(lo, hi, polygon, vertices);
    for (Py_ssize_t k = 0; k < of->count; k++) {
        if (skipped && skipped[k])
            continue;
        ray way = ray_of(of->sets[k], state, &part, &of->path[k]);
        if (!may_travel(of->sets[k], state, &way, of->path[k].travel, of->room, of->near))
            return 0;
    }
    return 1;
}

typedef struct {
    paths of;
    Py_ssize_t cells, vertices;
    const int64_t *state;
    const double *lo, *hi, *polygon;
    const char *skipped;
} sweeping;

static int take_sweeping(buffers *all, sweeping *job, PyObject *arguments)
{
    PyObject *sets_in, *paths_in, *state_in, *lo_in, *hi_in, *polygon_in, *skipped_in;
    memset(job, 0, sizeof(sweeping));
    if (!PyArg_ParseTuple(arguments, "O!OOOOOnnO", &PyTuple_Type, &sets_in, &paths_in, &state_in, &lo_in, &hi_in,
                          &polygon_in, &job->cells, &job->vertices, &skipped_in))
        return 0;
    Py_ssize_t row = job->cells * (Py_ssize_t)sizeof(double);
    return take_paths(all, sets_in, paths_in, &job->of) && (job->state = borrow(all, state_in, row)) &&
           (job->lo = borrow(all, lo_in, row)) && (job->hi = borrow(all, hi_in, row)) &&
           (job->polygon = borrow(all, polygon_in, 2 * job->vertices * row)) &&
           (skipped_in == Py_None || (job->skipped = borrow(all, skipped_in, job->cells * job->of.count)));
}

static void end_sweeping(buffers *all, sweeping *job)
{
    release(all);
    end_paths(&job->of);
}

static const char *skipped_of(const sweeping *job, Py_ssize_t cell)
{
    return job->skipped ? job->skipped + cell * job->of.count : NULL;
}

static const double *polygon_of(const sweeping *job, Py_ssize_t cell)
{
    return job->polygon + 2 * job->vertices * cell;
}

/* free_paths(outlines of m paths, paths (m × 6), states, lo, hi, polygons (k × v × 2), k, v, skipped (k × m) or None):
   which cells (k) no path rules out: its latest stop is not before the end of its travel. */
PyObject *free_paths(PyObject *self, PyObject *arguments)
{
    buffers all = {.count = 0};
    sweeping job;
    PyObject *found = NULL;
    (void)self;
    if (take_sweeping(&all, &job, arguments))
        found = PyByteArray_FromStringAndSize(NULL, job.cells);
    for (Py_ssize_t cell = 0; found && cell < job.cells; cell++)
        PyByteArray_AsString(found)[cell] =
            (char)paths_are_free(&job.of, job.state[cell], job.lo[cell], job.hi[cell], polygon_of(&job, cell),
                                 job.vertices, skipped_of(&job, cell));
    end_sweeping(&all, &job);
    return found;
}

/* What rays look for: seen from against the travel, normals that a stop may have, and whether all may (`vague`). */
typedef struct {
    const edge_set *edges;
    Py_ssize_t count;
    const int64_t *state;
    const double *start, *heading, *rho, *against, *half_width, *lean;
    const char *vague;
} stops;

/* First travel ≥ 0 at which the ray is inside the outline and in no capsule, of those sorted; infinite if never. */
static double latest_of(const capsule *sorted, int count)
{
    double covered = -INFINITY;
    int inside = 0;
    for (int k = 0; k < count; k++) {
        double following = k + 1 < count ? sorted[k + 1].enter : INFINITY;
        covered = larger(covered, sorted[k].leave);
        inside ^= sorted[k].crossing;
        if (inside && following > covered && following > 0)
            return larger(covered, 0.0);
    }
    return INFINITY;
}

/* Earliest, latest and furthest stop of a ray, and the least and the greatest normal, into every `count`-th number. */
static void enclose(const stops *of, Py_ssize_t row, capsule *room, int64_t *near, double *into)
{
    const edge_set *edges = of->edges;
    const ray path = {of->start[2 * row], of->start[2 * row + 1], of->heading[2 * row], of->heading[2 * row + 1],
                      of->rho[row]};
    const int beside = beside_line(edges, of->state[row], &path, INFINITY, near), vague = of->vague[row];
    int count = 0;
    for (int k = 0; k < beside; k++) {
        room[count] = capsule_of(edges, near[k], &path);
        count += room[count].enter <= room[count].leave;
    }
    sort_by_enter(room, count);
    const double latest = latest_of(room, count), lean = of->lean[row];
    double earliest = INFINITY, furthest = -INFINITY, lo = INFINITY, hi = -INFINITY;
    for (int k = 0; k < count; k++) {
        if (room[k].leave < 0)
            continue;
        earliest = smaller(earliest, larger(room[k].enter, 0.0));
        if (room[k].enter > latest)
            break;
        const double off = wrapped(edges->normal_rad[room[k].edge] - of->against[row]);
        const double spread = edges->span[room[k].edge] + of->half_width[row] + 1e-9;
        if (!vague && fabs(off) - spread > lean)
            continue;
        furthest = larger(furthest, smaller(room[k].leave, latest));
        lo = smaller(lo, off - spread);
        hi = larger(hi, off + spread);
    }
    const double found[5] = {earliest, latest, furthest, vague ? -PI : larger(lo, -lean), vague ? PI : smaller(hi, lean)};
    for (int k = 0; k < 5; k++)
        into[k * of->count + row] = found[k];
}

static int take_stops(buffers *all, stops *of, PyObject *arguments)
{
    PyObject *edges, *in[8];
    memset(of, 0, sizeof(stops));
    if (!PyArg_ParseTuple(arguments, "OOOOOOOOOn", &edges, &in[0], &in[1], &in[2], &in[3], &in[4], &in[5], &in[6], &in[7],
                          &of->count))
        return 0;
    const Py_ssize_t row = of->count * (Py_ssize_t)sizeof(double);
    return (of->edges = edges_of(edges)) && (of->state = borrow(all, in[0], row)) &&
           (of->start = borrow(all, in[1], 2 * row)) && (of->heading = borrow(all, in[2], 2 * row)) &&
           (of->rho = borrow(all, in[3], row)) && (of->against = borrow(all, in[4], row)) &&
           (of->half_width = borrow(all, in[5], row)) && (of->lean = borrow(all, in[6], row)) &&
           (of->vague = borrow(all, in[7], of->count));
}

/* enclose_stops(outlines, states, starts (r × 2), headings (r × 2), ρ, against, half widths, lean, vague, r): earliest,
   latest and furthest stop of each ray, least and greatest normal (5 × r). */
PyObject *enclose_stops(PyObject *self, PyObject *arguments)
{
    buffers all = {.count = 0};
    stops of;
    PyObject *found = NULL;
    capsule *room = NULL;
    int64_t *near = NULL;
    (void)self;
    if (take_stops(&all, &of, arguments)) {
        room = malloc((size_t)(of.edges->most_edges + 1) * sizeof(capsule));
        near = malloc((size_t)(of.edges->most_edges + 1) * sizeof(int64_t));
        if (room && near)
            found = PyByteArray_FromStringAndSize(NULL, 5 * of.count * (Py_ssize_t)sizeof(double));
        else
            PyErr_NoMemory();
    }
    for (Py_ssize_t row = 0; found && row < of.count; row++)
        enclose(&of, row, room, near, (double *)PyByteArray_AsString(found));
    free(room);
    free(near);
    release(&all);
    return found;
}

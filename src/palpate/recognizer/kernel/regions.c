/* Regions: connected cells, a witness for each region where one is found, and the cells that are to be cut finer: a
   round as `palpate.recognizer.numpy_regions.search_round` does it with whole arrays. */

#include "calls.h"
#include "groups.h"
#include "polish.h"
#include "shapes.h"

/* Settings of `witness_search`. */
#define PARTS 4
#define OF_ONE 16
#define CANDIDATES 4
#define LEVER_MM 40.0

/* What the round is given: cells, and what is asked of them. */
typedef struct {
    Py_ssize_t count, vertices, nodes, touched, states;
    const int64_t *node, *state;
    const double *lo, *hi;
    const point *polygon, *spot;
    const char *holds;
    const int64_t *label;       /* components, or NULL: not known yet */
    const int64_t *symmetry;    /* orders, of states */
    const char *null, *skipped; /* of interpretations: nodes × touched, nodes × evidence; or NULL */
    const double *anchor;
    int64_t room, pieces;
    int refinable, unpaired;
} asked;

/* The cells in the order of their regions: each turned to its region's branch of the symmetry. */
typedef struct {
    int64_t *row, *label, *node, *first;
    double *lo, *hi, *middle, *half, *share, *rank;
    point *polygon, *spot, *centre, *turned_centre;
    double *radius, *area;
    char *kept, *skipped, *wanted;
    int64_t *fit_state;
    Py_ssize_t regions;
    char *refinable, *verified, *doubtful;
    double *theta;
    point *position;
    int64_t *witness;
    double *term;
    box *boxes;
} round_room;

static void *room_for(int *fine, Py_ssize_t count, size_t width)
{
    void *found = *fine ? calloc((size_t)count + 1, width) : NULL;
    if (*fine && !found) {
        PyErr_NoMemory();
        *fine = 0;
    }
    return found;
}

static int take_room(round_room *r, const asked *of, Py_ssize_t evidence_count)
{
    const Py_ssize_t k = of->count;
    int fine = 1;
    int64_t **ints[] = {&r->row, &r->label, &r->node, &r->first, &r->fit_state, &r->witness};
    double **numbers[] = {&r->lo, &r->hi, &r->middle, &r->half, &r->share, &r->rank, &r->radius, &r->area, &r->theta};
    point **points[] = {&r->spot, &r->centre, &r->turned_centre, &r->position};
    char **flags[] = {&r->kept, &r->wanted, &r->refinable, &r->verified, &r->doubtful};
    for (size_t j = 0; j < sizeof ints / sizeof *ints; j++)
        *ints[j] = room_for(&fine, k + 1, sizeof(int64_t));
    for (size_t j = 0; j < sizeof numbers / sizeof *numbers; j++)
        *numbers[j] = room_for(&fine, k, sizeof(double));
    for (size_t j = 0; j < sizeof points / sizeof *points; j++)
        *points[j] = room_for(&fine, k, sizeof(point));
    for (size_t j = 0; j < sizeof flags / sizeof *flags; j++)
        *flags[j] = room_for(&fine, k, 1);
    r->polygon = room_for(&fine, k * of->vertices, sizeof(point));
    r->term = room_for(&fine, of->vertices, sizeof(double));
    r->skipped = of->skipped ? room_for(&fine, k * evidence_count, 1) : NULL;
    r->boxes = of->label ? NULL : room_for(&fine, k, sizeof(box));
    return fine;
}

static void end_room(round_room *r)
{
    void *all[] = {r->row, r->label, r->node, r->first, r->fit_state, r->witness, r->lo, r->hi, r->middle,
                   r->half, r->share, r->rank, r->radius, r->area, r->theta, r->spot, r->centre, r->turned_centre,
                   r->position, r->kept, r->wanted, r->refinable, r->verified, r->doubtful, r->polygon, r->term,
                   r->skipped, r->boxes};
    for (size_t j = 0; j < sizeof all / sizeof *all; j++)
        free(all[j]);
}

static point turned(point a, double angle)
{
    const double c = cos(angle), s = sin(angle);
    point found = {c * a.x - s * a.y, s * a.x + c * a.y};
    return found;
}

/* The same to 1e-10 mm, for what is rounded to more than that. */
static point near_turned(point a, double angle)
{
    double c, s;
    near_cosine_sine(angle, &c, &s);
    point found = {c * a.x - s * a.y, s * a.x + c * a.y};
    return found;
}

/* Components of cells, few of each state, by boxes of the positions that they allow. */
static int64_t labels_of_few(const asked *of, round_room *r, int64_t *label)
{
    static const point nothing = {0, 0};
    for (Py_ssize_t k = 0; k < of->count; k++) {
        double far[4];
        furthest_of(of->polygon + k * of->vertices, of->vertices, nothing, of->lo[k], of->hi[k], far);
        const int64_t state = of->state[k];
        box one = {of->anchor[0] - far[2] - 1e-9, of->anchor[1] - far[3] - 1e-9, of->anchor[0] + far[0] + 1e-9,
                   of->anchor[1] + far[1] + 1e-9, (of->lo[k] + of->hi[k]) / 2, (of->hi[k] - of->lo[k]) / 2,
                   TURN / (double)of->symmetry[state], state};
        r->boxes[k] = one;
    }
    return components_of_few(r->boxes, of->count, of->states, label);
}

/* What cells of a region are sorted by: what they are, not how they were found. */
typedef struct {
    double middle, x, y;
    int64_t row;
} sort_key;

static int by_key(const void *a, const void *b)
{
    const sort_key *one = a, *two = b;
    if (one->middle != two->middle)
        return one->middle < two->middle ? -1 : 1;
    if (one->x != two->x)
        return one->x < two->x ? -1 : 1;
    if (one->y != two->y)
        return one->y < two->y ? -1 : 1;
    return (one->row > two->row) - (one->row < two->row);
}

/* Sort cells by region, and within it: fills in `row`, `label`, `first`, `centre`, `radius` and `area`. */
static int order_cells(const asked *of, round_room *r)
{
    int fine = 1;
    int64_t *label = room_for(&fine, of->count, sizeof(int64_t)), *at = room_for(&fine, of->count + 1, sizeof(int64_t));
    sort_key *keys = room_for(&fine, of->count, sizeof(sort_key));
    shape *shapes = room_for(&fine, of->count, sizeof(shape));
    if (fine) {
        r->regions = 0;
        if (of->label)
            for (Py_ssize_t k = 0; k < of->count; k++) {
                label[k] = of->label[k];
                r->regions = label[k] + 1 > r->regions ? label[k] + 1 : r->regions;
            }
        else
            r->regions = labels_of_few(of, r, label);
        if (r->regions < 0)
            PyErr_NoMemory();
        fine = r->regions >= 0;
    }
    if (fine) {
        for (Py_ssize_t k = 0; k < of->count; k++)
            at[label[k] + 1]++;
        for (Py_ssize_t j = 0; j < r->regions; j++)
            at[j + 1] += at[j];
        memcpy(r->first, at, (size_t)(r->regions + 1) * sizeof(int64_t));
        for (Py_ssize_t k = 0; k < of->count; k++) {
            shapes[k] = shape_of(of->polygon + k * of->vertices, of->vertices, r->term);
            sort_key one = {rint((of->lo[k] + of->hi[k]) / 2 * 1e9), rint(shapes[k].centre.x * 1e6),
                            rint(shapes[k].centre.y * 1e6), k};
            keys[at[label[k]]++] = one;
        }
        for (Py_ssize_t j = 0; j < r->regions; j++)
            if (r->first[j + 1] - r->first[j] > 1)
                qsort(keys + r->first[j], (size_t)(r->first[j + 1] - r->first[j]), sizeof(sort_key), by_key);
        for (Py_ssize_t k = 0; k < of->count; k++) {
            r->row[k] = keys[k].row;
            r->label[k] = label[keys[k].row];
            r->centre[k] = shapes[keys[k].row].centre;
            r->radius[k] = shapes[keys[k].row].radius;
            r->area[k] = shapes[keys[k].row].area;
        }
    }
    free(label);
    free(at);
    free(keys);
    free(shapes);
    return fine;
}

/* Turn the cells of a region to the branch of the symmetry on which its largest cell is, brought into [−π, π). */
static void turn_region(const asked *of, round_room *r, Py_ssize_t region)
{
    const int64_t begin = r->first[region], end = r->first[region + 1];
    double most = -1, reference = 0;
    for (int64_t k = begin; k < end; k++) {
        const double volume = to_nine_digits(r->area[k] * (of->hi[r->row[k]] - of->lo[r->row[k]]));
        if (volume > most) {
            most = volume;
            reference = (of->lo[r->row[k]] + of->hi[r->row[k]]) / 2;
        }
    }
    const double whole = TURN * floor(rounded((reference + PI) / TURN, 1e9));
    for (int64_t k = begin; k < end; k++) {
        const int64_t row = r->row[k];
        const double lo = of->lo[row], hi = of->hi[row], middle = (lo + hi) / 2;
        const double turn = TURN / (double)of->symmetry[of->state[row]];
        const double angle = rint(rounded((middle - reference) / turn, 1e9)) * turn, shift = angle + whole;
        const point *polygon = of->polygon + row * of->vertices;
        point *to = r->polygon + k * of->vertices;
        r->node[k] = of->node[row];
        r->lo[k] = lo - shift;
        r->hi[k] = hi - shift;
        r->middle[k] = (r->lo[k] + r->hi[k]) / 2;
        r->half[k] = (hi - lo) / 2;
        const point spot = of->holds[row] ? of->spot[row] : r->centre[k];
        double area = r->area[k];
        if (angle != 0) {
            for (Py_ssize_t j = 0; j < of->vertices; j++)
                to[j] = turned(polygon[j], angle);
            const shape found = shape_of(to, of->vertices, r->term);
            r->turned_centre[k] = found.centre;
            area = found.area;
            r->spot[k] = turned(spot, angle);
        } else {
            memcpy(to, polygon, (size_t)of->vertices * sizeof(point));
            r->turned_centre[k] = r->centre[k];
            r->spot[k] = spot;
        }
        r->share[k] = area * (r->hi[k] - r->lo[k]) + 1e-300;
    }
}

static int64_t null_count(const asked *of, int64_t node)
{
    int64_t count = 0;
    for (Py_ssize_t j = 0; of->null && j < of->touched; j++)
        count += of->null[node * of->touched + j];
    return count;
}

/* Priority of a cell as its region's witness: `numpy_regions._witness_priority`. */
static int priority(const asked *of, const round_room *r, int64_t k, int64_t fewest)
{
    if (!of->null || null_count(of, r->node[k]) == fewest)
        return 2;
    return of->holds[r->row[k]] && !r->refinable[r->label[k]];
}

/* How gladly a region's cells are taken: those that may hold, the nearer to the middle the rather; then the largest.
   Rounded: of cells that are as near or as large, the first is taken. */
static void rank_cells(const asked *of, round_room *r, Py_ssize_t region)
{
    const int64_t begin = r->first[region], end = r->first[region + 1];
    double whole = 0, mean[3] = {0, 0, 0};
    int64_t fewest = INT64_MAX;
    for (int64_t k = begin; k < end; k++) {
        const point at = near_turned(r->turned_centre[k], r->middle[k]);
        whole += r->share[k];
        mean[0] += r->share[k] * (r->middle[k] * LEVER_MM);
        mean[1] += r->share[k] * at.x;
        mean[2] += r->share[k] * at.y;
        if (of->null) {
            const int64_t nulls = null_count(of, r->node[k]);
            fewest = nulls < fewest ? nulls : fewest;
        }
    }
    for (int64_t k = begin; k < end; k++) {
        const int eligible = priority(of, r, k, fewest);
        if (!eligible)
            r->rank[k] = -1.0;
        else if (of->holds[r->row[k]]) {
            const point at = near_turned(r->spot[k], r->middle[k]);
            const double x = r->middle[k] * LEVER_MM - mean[0] / whole, y = at.x - mean[1] / whole,
                         z = at.y - mean[2] / whole, off = rounded(sqrt(x * x + y * y + z * z), 1e6);
            r->rank[k] = 1.0 + eligible - off / (1.0 + off);
        } else {
            const double size = to_nine_digits(r->share[k]);
            r->rank[k] = size / (1.0 + size);
        }
    }
}

/* The best-ranked cell of a region, of equals the first; with `kept` those that are not come last. */
static int64_t best_of(const round_room *r, Py_ssize_t region, int with_kept)
{
    int64_t best = r->first[region];
    double most = -INFINITY;
    for (int64_t k = r->first[region]; k < r->first[region + 1]; k++) {
        const double rank = with_kept && !r->kept[k] ? -2.0 : r->rank[k];
        if (rank > most) {
            most = rank;
            best = k;
        }
    }
    return best;
}

/* All that is needed to polish. */
typedef struct {
    evidence by;
    region_cells cells;
    equation *rows;
} polishing;

/* Take a candidate for its region's witness if it is verified once it is polished. */
static int try_cell(const asked *of, round_room *r, polishing *job, Py_ssize_t region, int64_t k, point spot)
{
    pose at = {of->state[r->row[k]], r->middle[k], {spot.x, spot.y}};
    const char *skipped = r->skipped ? r->skipped + k * job->by.count : NULL;
    if (!polish_pose(&job->by, &job->cells, region, k, skipped, job->rows, &at))
        return 0;
    r->theta[region] = at.theta;
    r->position[region].x = at.position.x;
    r->position[region].y = at.position.y;
    r->witness[region] = r->node[k];
    r->verified[region] = 1;
    return 1;
}

static void place_at(round_room *r, Py_ssize_t region, int64_t k)
{
    r->theta[region] = r->middle[k];
    r->position[region] = r->spot[k];
    r->witness[region] = r->node[k];
}

/* Which of the cells that are `wanted` may hold a witness: `kept`. */
static int rule_out_cells(const asked *of, round_room *r, const evidence *by)
{
    Py_ssize_t count = 0;
    int fine = 1;
    for (Py_ssize_t k = 0; k < of->count; k++)
        count += r->wanted[k];
    if (!count)
        return 1;
    int64_t *states = room_for(&fine, count, 8);
    double *theta = room_for(&fine, count, 8), *turn = room_for(&fine, count, 8), *shift = room_for(&fine, count, 8);
    vector *at = room_for(&fine, count, sizeof(vector));
    char *skipped = r->skipped ? room_for(&fine, count * by->count, 1) : NULL, *left = room_for(&fine, count, 1);
    Py_ssize_t n = 0;
    for (Py_ssize_t k = 0; fine && k < of->count; k++) {
        if (!r->wanted[k])
            continue;
        const int64_t row = r->row[k];
        states[n] = of->state[row];
        theta[n] = (of->lo[row] + of->hi[row]) / 2;
        at[n].x = r->centre[k].x;
        at[n].y = r->centre[k].y;
        turn[n] = r->half[k];
        shift[n] = r->radius[k];
        if (skipped)
            memcpy(skipped + n * by->count, r->skipped + k * by->count, (size_t)by->count);
        n++;
    }
    const pose_cells cells = {states, theta, at, turn, shift, skipped, count};
    fine = fine && rule_out_all(by, &cells, of->pieces, left);
    n = 0;
    for (Py_ssize_t k = 0; fine && k < of->count; k++)
        if (r->wanted[k])
            r->kept[k] = left[n++];
    free(states);
    free(theta);
    free(turn);
    free(shift);
    free(at);
    free(skipped);
    free(left);
    return fine;
}

/* The floor of (nth · share) / size, also for nth = −1. */
static int64_t passed(int64_t nth, int64_t share, int64_t size) { return nth < 0 ? -1 : nth * share / size; }

/* Cells of a region in which a witness is looked for: up to CANDIDATES of those kept, evenly among them, the best
   first. `numpy_regions._spread_candidates`. */
static int spread(const round_room *r, Py_ssize_t region, int64_t found[CANDIDATES])
{
    int64_t size = 0, nth = 0;
    int count = 0;
    for (int64_t k = r->first[region]; k < r->first[region + 1]; k++)
        size += r->kept[k] && r->rank[k] >= 0;
    const int64_t share = size < CANDIDATES ? size : CANDIDATES;
    for (int64_t k = r->first[region]; k < r->first[region + 1]; k++) {
        if (!(r->kept[k] && r->rank[k] >= 0))
            continue;
        if (passed(nth, share, size) != passed(nth - 1, share, size)) {
            int at = count++;
            for (; at > 0 && r->rank[found[at - 1]] < r->rank[k]; at--)
                found[at] = found[at - 1];
            found[at] = k;
        }
        nth++;
    }
    return count;
}

/* What has been tried, the spot of the region's best cell first and then each cell's, is not tried again. */
static void search_region(const asked *of, round_room *r, polishing *job, Py_ssize_t region)
{
    int64_t found[CANDIDATES];
    const int64_t best = best_of(r, region, 0);
    const int count = spread(r, region, found);
    place_at(r, region, best_of(r, region, 1));
    for (int k = 0; k < count; k++)
        if (found[k] != best && try_cell(of, r, job, region, found[k], r->spot[found[k]]))
            return;
    for (int k = 0; k < count; k++) {
        const point spot = r->spot[found[k]], centre = r->turned_centre[found[k]];
        if ((spot.x != centre.x || spot.y != centre.y) && try_cell(of, r, job, region, found[k], centre))
            return;
    }
}

typedef struct {
    int64_t size, region;
} sized;

static int by_size(const void *a, const void *b)
{
    const sized *one = a, *two = b;
    if (one->size != two->size)
        return one->size < two->size ? -1 : 1;
    return (one->region > two->region) - (one->region < two->region);
}

/* Which regions are cut finer: as many as there is room for, the smallest first. */
static int choose_doubtful(const asked *of, round_room *r)
{
    int fine = 1;
    sized *wanted = room_for(&fine, r->regions, sizeof(sized));
    Py_ssize_t count = 0;
    for (Py_ssize_t j = 0; fine && j < r->regions; j++) {
        if (!r->refinable[j] || r->verified[j])
            continue;
        int64_t size = 0;
        for (int64_t k = r->first[j]; k < r->first[j + 1]; k++)
            size += r->kept[k];
        sized one = {size * (of->touched > 1 ? of->touched : 1), j};
        wanted[count++] = one;
    }
    if (fine && count > 1)
        qsort(wanted, (size_t)count, sizeof(sized), by_size);
    int64_t sum = 0;
    for (Py_ssize_t n = 0; fine && n < count; n++) {
        sum += wanted[n].size;
        r->doubtful[wanted[n].region] = sum <= of->room;
    }
    free(wanted);
    return fine;
}

static int find_regions(const asked *of, round_room *r, polishing *job)
{
    if (!order_cells(of, r))
        return 0;
    for (Py_ssize_t j = 0; j < r->regions; j++) {
        turn_region(of, r, j);
        r->refinable[j] = of->refinable && (r->first[j + 1] - r->first[j]) * PARTS <= of->room / OF_ONE;
        rank_cells(of, r, j);
    }
    for (Py_ssize_t k = 0; r->skipped && k < of->count; k++)
        memcpy(r->skipped + k * job->by.count, of->skipped + r->node[k] * job->by.count, (size_t)job->by.count);
    const region_cells cells = {of->count, of->vertices, r->regions, of->nodes, of->touched, r->node, r->first, r->lo,
                                r->hi, (const vector *)r->polygon, of->null};
    job->cells = cells;
    memset(r->kept, 1, (size_t)of->count);
    for (Py_ssize_t j = 0; j < r->regions; j++) {
        const int64_t best = best_of(r, j, 0);
        place_at(r, j, best);
        const int found = try_cell(of, r, job, j, best, r->spot[best]);
        memset(r->wanted + r->first[j], !found || of->unpaired, (size_t)(r->first[j + 1] - r->first[j]));
    }
    if (!rule_out_cells(of, r, &job->by))
        return 0;
    for (Py_ssize_t j = 0; j < r->regions; j++)
        if (!r->verified[j])
            search_region(of, r, job, j);
    return choose_doubtful(of, r);
}

#define AS(type, array) ((type *)PyByteArray_AsString(array))

/* What Python gets: of the regions that are done, and have cells left: rows, lo, hi, polygons of their cells, where
   they begin, θ, positions, whether verified, interpretations; and rows of the cells to be cut finer. */
static PyObject *regions_found(const asked *of, const round_room *r)
{
    Py_ssize_t left = 0, again = 0, regions = 0;
    for (Py_ssize_t j = 0; j < r->regions; j++) {
        Py_ssize_t size = 0;
        for (int64_t k = r->first[j]; k < r->first[j + 1]; k++)
            size += r->kept[k];
        *(r->doubtful[j] ? &again : &left) += size;
        regions += !r->doubtful[j] && size;
    }
    const Py_ssize_t bytes[10] = {left * 8, left * 8, left * 8, left * of->vertices * 16, (regions + 1) * 8,
                                  regions * 8, regions * 16, regions, regions * 8, again * 8};
    PyObject *out[10] = {NULL};
    int fine = 1;
    for (int k = 0; k < 10 && fine; k++)
        fine = (out[k] = PyByteArray_FromStringAndSize(NULL, bytes[k])) != NULL;
    if (!fine) {
        for (int k = 0; k < 10; k++)
            Py_XDECREF(out[k]);
        return NULL;
    }
    Py_ssize_t at = 0, finer = 0, region = 0;
    for (Py_ssize_t j = 0; j < r->regions; j++) {
        const Py_ssize_t begin = at;
        for (int64_t k = r->first[j]; k < r->first[j + 1]; k++) {
            if (!r->kept[k])
                continue;
            if (r->doubtful[j]) {
                AS(int64_t, out[9])[finer++] = r->row[k];
                continue;
            }
            AS(int64_t, out[0])[at] = r->row[k];
            AS(double, out[1])[at] = r->lo[k];
            AS(double, out[2])[at] = r->hi[k];
            memcpy(AS(point, out[3]) + at * of->vertices, r->polygon + k * of->vertices,
                   (size_t)of->vertices * sizeof(point));
            at++;
        }
        if (at == begin)
            continue;
        AS(int64_t, out[4])[region] = begin;
        AS(double, out[5])[region] = r->theta[j];
        AS(point, out[6])[region] = r->position[j];
        AS(char, out[7])[region] = r->verified[j];
        AS(int64_t, out[8])[region++] = r->witness[j];
    }
    AS(int64_t, out[4])[region] = at;
    return Py_BuildValue("NNNNNNNNNN", out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7], out[8], out[9]);
}

static int cells_fit(const asked *of, const evidence *by)
{
    for (Py_ssize_t k = 0; k < of->count; k++)
        if (of->node[k] < 0 || of->node[k] >= of->nodes || of->state[k] < 0 || of->state[k] >= of->states ||
            (of->label && (of->label[k] < 0 || of->label[k] >= of->count))) {
            PyErr_SetString(PyExc_IndexError, "there is no such interpretation, state or component");
            return 0;
        }
    return states_exist(by, of->state, of->count);
}

/* regions(evidence, (cells' nodes, states, lo, hi, polygons, spots, holds, components or None, how many cells and
   vertices), (symmetry orders, anchor, null (nodes × touched), null (nodes × evidence), or None, how many states,
   nodes and touched), (cells, times contacts, that may be cut finer, pieces or −1, whether any may be, whether some
   contact is unpaired)): see `regions_found`. */
PyObject *regions(PyObject *self, PyObject *arguments)
{
    PyObject *evidence_in, *cells_in, *rules_in, *limits_in, *cell[8], *rule[4];
    buffers all = {.count = 0};
    asked of = {.count = 0};
    polishing job;
    long long room, pieces;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!O!O!O!", &PyTuple_Type, &evidence_in, &PyTuple_Type, &cells_in, &PyTuple_Type,
                          &rules_in, &PyTuple_Type, &limits_in) ||
        !PyArg_ParseTuple(cells_in, "OOOOOOOOnn", &cell[0], &cell[1], &cell[2], &cell[3], &cell[4], &cell[5], &cell[6],
                          &cell[7], &of.count, &of.vertices) ||
        !PyArg_ParseTuple(rules_in, "OOOOnnn", &rule[0], &rule[1], &rule[2], &rule[3], &of.states, &of.nodes,
                          &of.touched) ||
        !PyArg_ParseTuple(limits_in, "LLpp", &room, &pieces, &of.refinable, &of.unpaired))
        return NULL;
    of.room = room;
    of.pieces = pieces;
    round_room r;
    memset(&r, 0, sizeof r);
    const Py_ssize_t k = of.count;
    int fine = take_evidence(&all, evidence_in, &job.by) && (of.node = borrow(&all, cell[0], k * 8)) &&
               (of.state = borrow(&all, cell[1], k * 8)) && (of.lo = borrow(&all, cell[2], k * 8)) &&
               (of.hi = borrow(&all, cell[3], k * 8)) && (of.polygon = borrow(&all, cell[4], k * of.vertices * 16)) &&
               (of.spot = borrow(&all, cell[5], k * 16)) && (of.holds = borrow(&all, cell[6], k)) &&
               (cell[7] == Py_None || (of.label = borrow(&all, cell[7], k * 8))) &&
               (of.symmetry = borrow(&all, rule[0], of.states * 8)) && (of.anchor = borrow(&all, rule[1], 16)) &&
               (rule[2] == Py_None || (of.null = borrow(&all, rule[2], of.nodes * of.touched))) &&
               (rule[3] == Py_None || (of.skipped = borrow(&all, rule[3], of.nodes * job.by.count))) &&
               cells_fit(&of, &job.by) && take_room(&r, &of, job.by.count);
    job.rows = room_for(&fine, job.by.count, sizeof(equation));
    PyObject *found = fine && find_regions(&of, &r, &job) ? regions_found(&of, &r) : NULL;
    free(job.rows);
    end_room(&r);
    end_evidence(&job.by);
    release(&all);
    return found;
}

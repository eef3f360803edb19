/* Levels of the interpretation tree (memo §2.2): look-up by angle, look at distances, model tests.

   What circles about edges cannot reach is left out before anything exact is done; that rules out nothing that
   the exact tests would keep. No table of pairs is needed: edges lie sorted by normal. */

#include "calls.h"
#include "edges.h"

#define BLOCK 512
#define SQRT2 1.4142135623730951
#define ROUNDING_MM 1e-6
#define TURN_ROUNDING_RAD 4e-6 /* of the table of pairs that does the same by whole arrays */
#define FINE_EDGES 600         /* of a state with more, only edges that are near count as looked up */

/* One interpretation: its edges, in contact order, and orientations. `parent`: the row it grew from. */
typedef struct {
    int64_t parent, edge;
    interval at;
} grown;

/* Of edges [from, to), those whose circles meet all of the rings, the first a disc: a centre, a least and a largest distance from
   there to the middle of the edge's rectangle, each wider by the half diagonal of the edge's own rectangle. */
typedef struct {
    double x, y, least, most;
} ring;

/* Two discs' worth of tests for each edge cost less than to guess which of them it passes: mostly about ten are looked
   at, and few of these are left. */
static int within_rings(const edge_set *edges, int64_t from, int64_t to, const ring *rings, int count, int32_t *found)
{
    const double *restrict mx = edges->middle_x + from, *restrict my = edges->middle_y + from;
    const double *restrict wide = edges->half_diagonal + from;
    const ring disc = rings[0], around = rings[1];
    const int size = (int)(to - from);
    int left = 0, kept = 0;
    for (int j = 0; j < size; j++) {
        const double dx = mx[j] - disc.x, dy = my[j] - disc.y, outer = disc.most + wide[j];
        const double ex = mx[j] - around.x, ey = my[j] - around.y, square = ex * ex + ey * ey;
        const double furthest = around.most + wide[j], nearest = larger(around.least - wide[j], 0.0);
        found[left] = j;
        left += (dx * dx + dy * dy <= outer * outer) & (square <= furthest * furthest) & (square >= nearest * nearest);
    }
    for (int i = 0; i < left; i++) {
        const int j = found[i];
        int within = 1;
        for (int k = 2; k < count && within; k++) {
            double dx = mx[j] - rings[k].x, dy = my[j] - rings[k].y, square = dx * dx + dy * dy;
            double outer = rings[k].most + wide[j], inner = larger(rings[k].least - wide[j], 0.0);
            within = square <= outer * outer && square >= inner * inner;
        }
        found[kept] = j;
        kept += within;
    }
    return kept;
}

/* Square of the distance of a point from a segment. */
static double point_segment(double px, double py, const double *start, const double *u, double length)
{
    double x = px - start[0], y = py - start[1];
    double along = clipped(x * u[0] + y * u[1], 0.0, length);
    double dx = x - along * u[0], dy = y - along * u[1];
    return dx * dx + dy * dy;
}

/* Whether the distance of two contacts is one that their edges allow (memo §2.2.1). Mostly their ends say so. */
static int distance_fits(const edge_set *first, int64_t a, const edge_set *second, int64_t b, double measured,
                         double bound)
{
    const double *p = first->start + 2 * a, *q = first->end + 2 * a;
    const double *r = second->start + 2 * b, *s = second->end + 2 * b;
    double slack = first->slack_mm[a] + second->slack_mm[b] + bound + ROUNDING_MM;
    const double *ends[4][2] = {{p, r}, {p, s}, {q, r}, {q, s}};
    double longest = 0.0, shortest = INFINITY;
    for (int k = 0; k < 4; k++) {
        double dx = ends[k][0][0] - ends[k][1][0], dy = ends[k][0][1] - ends[k][1][1], square = dx * dx + dy * dy;
        longest = larger(longest, square);
        shortest = smaller(shortest, square);
    }
    const double least = measured - slack, most = larger(measured + slack, 0.0);
    if (least > 0 && least * least > longest)
        return 0;
    if (shortest <= most * most)
        return 1;
    const double *u = first->direction + 2 * a, *v = second->direction + 2 * b;
    shortest = point_segment(p[0], p[1], r, v, second->length[b]);
    shortest = smaller(shortest, point_segment(q[0], q[1], r, v, second->length[b]));
    shortest = smaller(shortest, point_segment(r[0], r[1], p, u, first->length[a]));
    shortest = smaller(shortest, point_segment(s[0], s[1], p, u, first->length[a]));
    if (shortest <= most * most)
        return 1;
    double ux = q[0] - p[0], uy = q[1] - p[1], vx = s[0] - r[0], vy = s[1] - r[1];
    double one = (ux * (r[1] - p[1]) - uy * (r[0] - p[0])) * (ux * (s[1] - p[1]) - uy * (s[0] - p[0]));
    double two = (vx * (p[1] - r[1]) - vy * (p[0] - r[0])) * (vx * (q[1] - r[1]) - vy * (q[0] - r[0]));
    return one < 0 && two < 0 && measured >= -slack;
}

/* Orientations as a look from an edge needs them: the middle one, and how far a unit vector turned by it and one
   turned by another of them may be apart. */
typedef struct {
    double cos, sin, swing;
} sector;

static double swing_of(double half)
{
    double cosine, sine;
    if (half >= PI)
        return 2;
    near_cosine_sine(half / 2, &cosine, &sine);
    return 2 * sine;
}

static sector sector_of(interval at)
{
    double middle = (at.lo + at.hi) / 2;
    sector found = {.swing = swing_of((at.hi - at.lo) / 2)};
    near_cosine_sine(middle, &found.cos, &found.sin);
    return found;
}

/* Where the last of two contacts is, `away` from the first, seen from an edge of the first; and by distance alone. */
static void rings_of(const edge_set *first, int64_t edge, const tip *a, const tip *b, double away, const sector *at,
                     ring found[2])
{
    double x = b->x - a->x, y = b->y - a->y;
    double slack = first->half_diagonal[edge] + SQRT2 * (a->bound + b->bound) + ROUNDING_MM;
    ring place = {
        first->middle_x[edge] + at->cos * x + at->sin * y,
        first->middle_y[edge] + at->cos * y - at->sin * x,
        0.0,
        at->swing * away + slack,
    };
    ring around = {first->middle_x[edge], first->middle_y[edge], away - slack, away + slack};
    found[0] = place;
    found[1] = around;
}

/* A contact to be paired, and those before it: their edge sets, tips, and the range of normals of each. */
typedef struct {
    int earlier;
    const edge_set *sets[3];
    tip tips[3];
    double normals_lo[3], normals_hi[3];
    double away[2], bound[2]; /* of the last contact from each earlier one, and the bound on it */
    chord chords[2];          /* from each earlier one to the last */
    runs looked;              /* what was looked up last */
    int64_t looked_up, near;
    int modelled; /* whether the model tests are done, too */
    list *found;
} pairing;

static void measure(pairing *all)
{
    const tip *last = &all->tips[all->earlier];
    for (int k = 0; k < all->earlier; k++) {
        all->away[k] = hypot(last->x - all->tips[k].x, last->y - all->tips[k].y);
        all->bound[k] = all->tips[k].bound + last->bound;
        all->chords[k] = chord_of(&all->tips[k], last);
    }
}

/* Pair the last contact with edges of `state` under an interpretation; 0 with an exception set if it failed. */
static int pair(pairing *all, int64_t parent, int64_t state, const int64_t *paired, interval at, const sector *seen)
{
    const edge_set *edges = all->sets[all->earlier];
    const tip *tips = all->tips;
    double lo = all->normals_lo[all->earlier], hi = all->normals_hi[all->earlier];
    double margin = edges->most_span;
    ring rings[4];
    for (int k = 0; k < all->earlier; k++)
        rings_of(all->sets[k], paired[k], &tips[k], &tips[all->earlier], all->away[k], seen, rings + 2 * k);
    runs looked = by_normal(edges, state, lo - margin - at.hi, smaller(hi - lo + 2 * margin + at.hi - at.lo, TURN),
                            &all->looked);
    all->looked = looked;
    int fine = edges->first[state + 1] - edges->first[state] > FINE_EDGES;
    /* The second run, where there is one, begins at the state's first edge: children are in the edges' order. */
    for (int run = looked.count - 1; run >= 0; run--)
        for (int64_t from = looked.from[run]; from < looked.to[run]; from += BLOCK) {
            int64_t to = from + BLOCK < looked.to[run] ? from + BLOCK : looked.to[run];
            int32_t found[BLOCK];
            int count = within_rings(edges, from, to, rings, 2 * all->earlier, found);
            all->looked_up += fine ? count : to - from;
            for (int j = 0; j < count; j++) {
                int64_t edge = from + found[j];
                int fits = 1;
                for (int k = 0; k < all->earlier && fits; k++)
                    fits = distance_fits(all->sets[k], paired[k], edges, edge, all->away[k], all->bound[k]);
                interval left = intersect(at, orientation_range(edges, edge, lo, hi));
                if (!fits || !(left.lo <= left.hi))
                    continue;
                all->near++;
                for (int k = 0; k < all->earlier && all->modelled && left.lo <= left.hi; k++)
                    left = two_contacts(all->sets[k], paired[k], edges, edge, &tips[k], &tips[all->earlier],
                                        &all->chords[k], left);
                if (all->earlier == 2 && all->modelled && left.lo <= left.hi) {
                    const int64_t three[3] = {paired[0], paired[1], edge};
                    const tip *const places[3] = {&tips[0], &tips[1], &tips[2]};
                    left = three_contacts(all->sets, three, places, left);
                }
                if (!(left.lo <= left.hi))
                    continue;
                grown *child = list_add(all->found);
                if (!child) {
                    PyErr_NoMemory();
                    return 0;
                }
                child->parent = parent;
                child->edge = edge;
                child->at = left;
            }
        }
    return 1;
}

/* Pairs of edges of the first two contacts that their normals allow. */
static int64_t pairs_by_angle(const pairing *all)
{
    const edge_set *first = all->sets[0], *second = all->sets[1];
    double margin = first->most_span + second->most_span + TURN_ROUNDING_RAD;
    double turn = all->normals_lo[1] - all->normals_hi[0] - margin;
    double width = all->normals_hi[1] - all->normals_lo[0] + margin - turn;
    int64_t count = 0;
    for (int64_t state = 0; state < first->states; state++) {
        if (larger((double)(first->first[state + 1] - first->first[state]),
                   (double)(second->first[state + 1] - second->first[state])) > FINE_EDGES)
            continue;
        runs found = {{-1, -1}, {-1, -1}, 0};
        for (int64_t edge = first->first[state]; edge < first->first[state + 1]; edge++)
            if (first->representative[edge]) {
                found = by_normal(second, state, first->normal_rad[edge] + turn, width, &found);
                for (int k = 0; k < found.count; k++)
                    count += found.to[k] - found.from[k];
            }
    }
    return count;
}

/* What Python gets: whether there was too much to look at, how many were looked up and near, and the children. */
static PyObject *answer_of(pairing *all, int spent)
{
    PyObject *found = list_bytes(all->found);
    if (!found)
        return NULL;
    return Py_BuildValue("iLLN", spent, (long long)all->looked_up, (long long)all->near, found);
}

/* second_level(first, second, (x, y, bound, normals lo, hi) twice, most, modelled): children of every
   representative edge; `parent` of a child is that edge. */
PyObject *second_level(PyObject *self, PyObject *arguments)
{
    PyObject *arrays[2];
    list found = new_list(sizeof(grown));
    pairing job = {.earlier = 1, .found = &found};
    long long most;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OO(ddddd)(ddddd)Li", &arrays[0], &arrays[1], &job.tips[0].x, &job.tips[0].y,
                          &job.tips[0].bound, &job.normals_lo[0], &job.normals_hi[0], &job.tips[1].x, &job.tips[1].y,
                          &job.tips[1].bound, &job.normals_lo[1], &job.normals_hi[1], &most, &job.modelled))
        return NULL;
    measure(&job);
    const edge_set *first = job.sets[0] = edges_of(arrays[0]);
    int fine = first && (job.sets[1] = edges_of(arrays[1]));
    int spent = fine && most >= 0 && pairs_by_angle(&job) > most;
    const double middle = (job.normals_lo[0] + job.normals_hi[0]) / 2, width = job.normals_hi[0] - job.normals_lo[0];
    const double c = cos(middle), s = sin(middle), swing = swing_of(width / 2 + TURN_ROUNDING_RAD);
    for (int64_t state = 0; fine && !spent && state < first->states; state++)
        for (int64_t edge = first->first[state]; fine && edge < first->first[state + 1]; edge++)
            if (first->representative[edge]) {
                interval at = orientation_range(first, edge, job.normals_lo[0], job.normals_hi[0]);
                const double *normal = first->normal + 2 * edge;
                /* the middle orientation is that of the normals, less the angle of the edge's */
                const sector turned = {c * normal[0] + s * normal[1], s * normal[0] - c * normal[1], swing};
                const sector seen = first->span[edge] > 0 || width > TURN ? sector_of(at) : turned;
                fine = pair(&job, edge, state, &edge, at, &seen);
            }
    if (!fine) {
        free_list(&found);
        return NULL;
    }
    return answer_of(&job, spent);
}

/* third_level(edge sets of 3 contacts, (x, y, bound, normals lo, hi) of each, states, edges, lo, hi, count, most,
   modelled): children of interpretations of two contacts. */
PyObject *third_level(PyObject *self, PyObject *arguments)
{
    PyObject *sets_in, *states_in, *edges_in, *lo_in, *hi_in;
    buffers all = {.count = 0};
    list found = new_list(sizeof(grown));
    pairing job = {.earlier = 2, .found = &found};
    double normals[3][2];
    long long most;
    Py_ssize_t count;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!(ddddd)(ddddd)(ddddd)OOOOnLi", &PyTuple_Type, &sets_in,
                          &job.tips[0].x, &job.tips[0].y, &job.tips[0].bound, &normals[0][0], &normals[0][1],
                          &job.tips[1].x, &job.tips[1].y, &job.tips[1].bound, &normals[1][0], &normals[1][1],
                          &job.tips[2].x, &job.tips[2].y, &job.tips[2].bound, &normals[2][0], &normals[2][1],
                          &states_in, &edges_in, &lo_in, &hi_in, &count, &most, &job.modelled))
        return NULL;
    if (PyTuple_Size(sets_in) != 3) {
        PyErr_SetString(PyExc_ValueError, "three contacts are needed");
        return NULL;
    }
    for (int k = 0; k < 3; k++) {
        job.normals_lo[k] = normals[k][0];
        job.normals_hi[k] = normals[k][1];
    }
    const Py_ssize_t row = count * (Py_ssize_t)sizeof(double);
    measure(&job);
    const int64_t *states = NULL, *edges = NULL;
    const double *lo = NULL, *hi = NULL;
    int fine = take_sets(sets_in, job.sets);
    fine = fine && (states = borrow(&all, states_in, row)) && (edges = borrow(&all, edges_in, 2 * row)) &&
           (lo = borrow(&all, lo_in, row)) && (hi = borrow(&all, hi_in, row));
    for (Py_ssize_t node = 0; fine && node < count && job.looked_up <= most; node++) {
        interval at = {lo[node], hi[node]};
        const sector seen = sector_of(at);
        fine = pair(&job, node, states[node], edges + 2 * node, at, &seen);
    }
    release(&all);
    if (!fine) {
        free_list(&found);
        return NULL;
    }
    return answer_of(&job, job.looked_up > most);
}

/* extend(edges, (x, y, bound, normals lo, hi) of a contact, states, lo, hi, middles (k × 2) and reach: where it lies
   in the object's frame in each of k cells, k, most): children of the cells, as of interpretations. */
PyObject *extend(PyObject *self, PyObject *arguments)
{
    PyObject *set_in, *state_in, *lo_in, *hi_in, *place_in, *reach_in;
    Py_ssize_t count;
    long long most;
    double normals_lo, normals_hi;
    tip contact;
    buffers all = {.count = 0};
    list found = new_list(sizeof(grown));
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O(ddddd)OOOOOnL", &set_in, &contact.x, &contact.y, &contact.bound, &normals_lo,
                          &normals_hi, &state_in, &lo_in, &hi_in, &place_in, &reach_in, &count, &most))
        return NULL;
    const edge_set *edges = edges_of(set_in);
    const int64_t *state = NULL;
    const double *lo = NULL, *hi = NULL, *place = NULL, *reach = NULL;
    Py_ssize_t row = count * (Py_ssize_t)sizeof(double);
    int fine = edges && (state = borrow(&all, state_in, row)) && (lo = borrow(&all, lo_in, row)) &&
               (hi = borrow(&all, hi_in, row)) && (place = borrow(&all, place_in, 2 * row)) &&
               (reach = borrow(&all, reach_in, row));
    int64_t looked_up = 0;
    for (Py_ssize_t cell = 0; fine && cell < count && looked_up <= most; cell++) {
        double margin = edges->most_span, wide = normals_hi - normals_lo + 2 * margin + hi[cell] - lo[cell];
        runs looked = by_normal(edges, state[cell], normals_lo - margin - hi[cell], smaller(wide, TURN), NULL);
        int large = edges->first[state[cell] + 1] - edges->first[state[cell]] > FINE_EDGES;
        for (int run = looked.count - 1; run >= 0; run--) {
            looked_up += large ? 0 : looked.to[run] - looked.from[run];
            for (int64_t edge = looked.from[run]; edge < looked.to[run]; edge++) {
                double square = point_segment(place[2 * cell], place[2 * cell + 1], edges->start + 2 * edge,
                                              edges->direction + 2 * edge, edges->length[edge]);
                if (sqrt(square) > reach[cell] + edges->slack_mm[edge])
                    continue;
                looked_up += large;
                interval at = {lo[cell], hi[cell]};
                at = intersect(at, orientation_range(edges, edge, normals_lo, normals_hi));
                if (!(at.lo <= at.hi))
                    continue;
                grown *child = list_add(&found);
                if (!child) {
                    PyErr_NoMemory();
                    fine = 0;
                    break;
                }
                child->parent = cell;
                child->edge = edge;
                child->at = at;
            }
        }
    }
    release(&all);
    if (!fine) {
        free_list(&found);
        return NULL;
    }
    pairing counts = {.found = &found, .looked_up = looked_up, .near = (int64_t)found.size};
    return answer_of(&counts, looked_up > most);
}

/* narrow(edge sets of k ≤ 3 contacts, (x, y, bound) of each, edges (n × k), lo, hi, n): how far the model test of
   two, or of three, narrow intervals; one bytearray each. */
PyObject *narrow(PyObject *self, PyObject *arguments)
{
    PyObject *sets_in, *tips_in, *edges_in, *lo_in, *hi_in;
    Py_ssize_t count;
    buffers all = {.count = 0};
    const edge_set *sets[3];
    tip tips[3];
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!O!OOOn", &PyTuple_Type, &sets_in, &PyTuple_Type, &tips_in, &edges_in, &lo_in,
                          &hi_in, &count))
        return NULL;
    Py_ssize_t many = PyTuple_Size(sets_in), row = count * (Py_ssize_t)sizeof(double);
    if (many < 2 || many > 3 || PyTuple_Size(tips_in) != many) {
        PyErr_SetString(PyExc_ValueError, "two or three contacts are needed");
        return NULL;
    }
    const int64_t *edges = NULL;
    const double *lo = NULL, *hi = NULL;
    PyObject *lo_out = NULL, *hi_out = NULL;
    int fine = take_sets(sets_in, sets) && take_tips(tips_in, tips);
    fine = fine && (edges = borrow(&all, edges_in, many * row)) && (lo = borrow(&all, lo_in, row)) &&
           (hi = borrow(&all, hi_in, row));
    if (fine) {
        lo_out = PyByteArray_FromStringAndSize(NULL, row);
        hi_out = PyByteArray_FromStringAndSize(NULL, row);
        fine = lo_out && hi_out;
    }
    const chord between = fine ? chord_of(&tips[0], &tips[1]) : (chord){0, 0};
    for (Py_ssize_t k = 0; fine && k < count; k++) {
        const int64_t *edge = edges + many * k;
        interval at = {lo[k], hi[k]};
        if (many == 2)
            at = two_contacts(sets[0], edge[0], sets[1], edge[1], &tips[0], &tips[1], &between, at);
        else {
            const tip *const places[3] = {&tips[0], &tips[1], &tips[2]};
            at = three_contacts(sets, edge, places, at);
        }
        ((double *)PyByteArray_AsString(lo_out))[k] = at.lo;
        ((double *)PyByteArray_AsString(hi_out))[k] = at.hi;
    }
    release(&all);
    if (!fine) {
        Py_XDECREF(lo_out);
        Py_XDECREF(hi_out);
        return NULL;
    }
    return Py_BuildValue("NN", lo_out, hi_out);
}

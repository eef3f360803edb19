/* Verification: whether configurations satisfy every contact and every free path. The same as
   `verification.verify` and `verification.may_fit`, pose by pose. */

#include "verify.h"
#include "calls.h"

#define NEAR_MM 1.0 /* `proximity.NEAR_MM` */
#define BESIDE 8
#define WITHIN (1.0 - 1e-9)
#define AT_ONCE 2000 /* `proximity._POINTS_AT_ONCE`: after so many points it is seen how much was looked at */

int take_evidence(buffers *all, PyObject *tuple, evidence *taken)
{
    PyObject *boundaries, *rows;
    memset(taken, 0, sizeof(evidence));
    if (!PyArg_ParseTuple(tuple, "O!O", &PyTuple_Type, &boundaries, &rows))
        return 0;
    Py_ssize_t count = PyTuple_Size(boundaries), sides = 1;
    taken->count = count;
    if (!(taken->contacts = borrow(all, rows, count * (Py_ssize_t)sizeof(contact))))
        return 0;
    taken->on = calloc((size_t)count + 1, sizeof(boundary *));
    taken->places = calloc((size_t)count + 1, sizeof(place));
    taken->fits = calloc((size_t)count + 1, 1);
    for (Py_ssize_t k = 0; taken->on && k < count; k++) {
        if (!(taken->on[k] = boundary_of(PyTuple_GetItem(boundaries, k))))
            return 0;
        if (taken->on[k]->most_sides > sides)
            sides = taken->on[k]->most_sides;
    }
    taken->room = malloc((size_t)sides * sizeof(passed_side));
    if (!taken->on || !taken->places || !taken->fits || !taken->room) {
        PyErr_NoMemory();
        return 0;
    }
    return 1;
}

void end_evidence(evidence *taken)
{
    free(taken->on);
    free(taken->places);
    free(taken->fits);
    free(taken->room);
}

int states_exist(const evidence *by, const int64_t *state, Py_ssize_t count)
{
    for (Py_ssize_t k = 0; k < by->count; k++)
        for (Py_ssize_t i = 0; i < count; i++)
            if (state[i] < 0 || state[i] >= by->on[k]->states) {
                PyErr_SetString(PyExc_IndexError, "there is no such state");
                return 0;
            }
    return 1;
}

static int moved_is_free(const evidence *by, Py_ssize_t k, int64_t state, vector start, vector end, vector by_mm)
{
    vector from = {start.x + by_mm.x, start.y + by_mm.y}, to = {end.x + by_mm.x, end.y + by_mm.y};
    return line_is_free(by->on[k], state, from, to, by->room);
}

/* Whether a path is free if it is moved by something, at most its bound: `verification._some_way_is_free`. */
static int some_way_is_free(const evidence *by, Py_ssize_t k, int64_t state, vector start, vector end, vector offset)
{
    double bound = WITHIN * by->contacts[k].path_bound;
    double share = smaller(1.0, bound / larger(length_of(offset), NEXT_TO_NOTHING));
    vector move = {offset.x * share, offset.y * share}, nothing = {0, 0};
    if (moved_is_free(by, k, state, start, end, move) || moved_is_free(by, k, state, start, end, nothing))
        return 1;
    vector along = {end.x - start.x, end.y - start.y};
    double travel = larger(length_of(along), NEXT_TO_NOTHING);
    vector ahead = {along.x / travel, along.y / travel};
    for (int nth = 0; nth < BESIDE; nth++) {
        double angle = PI + TURN * nth / BESIDE, c = cos(angle), s = sin(angle);
        move.x = (c * ahead.x - s * ahead.y) * bound;
        move.y = (s * ahead.x + c * ahead.y) * bound;
        if (moved_is_free(by, k, state, start, end, move))
            return 1;
    }
    return 0;
}

int judge(evidence *by, const pose *at, const char *skipped, int thorough)
{
    double c = cos(-at->theta), s = sin(-at->theta);
    int holds = 1;
    for (Py_ssize_t k = 0; k < by->count; k++) {
        const contact *of = &by->contacts[k];
        by->places[k] = nowhere;
        by->fits[k] = 1;
        if (!of->touched || (skipped && skipped[k]))
            continue;
        claim claimed = {seen_from(at, c, s, of->end), of->lo - at->theta, of->width, of->bound, NEAR_MM};
        nearest_place(by->on[k], at->state, &claimed, 1, &by->places[k]);
        by->fits[k] = by->places[k].fits;
        holds &= by->fits[k];
        if (!thorough && isinf(by->places[k].distance))
            return 0;
    }
    for (Py_ssize_t k = 0; k < by->count && holds; k++)
        if (!(skipped && skipped[k]))
            holds = some_way_is_free(by, k, at->state, seen_from(at, c, s, by->contacts[k].start),
                                     seen_from(at, c, s, by->contacts[k].end), by->places[k].offset);
    return holds;
}

static PyObject *array_of(Py_ssize_t count, size_t width)
{
    return PyByteArray_FromStringAndSize(NULL, count * (Py_ssize_t)width);
}

#define AS(type, array) ((type *)PyByteArray_AsString(array))

/* verify(evidence, states, θ, positions, n, skipped (n × m) or None): fits, holds, gap, offset, normal, limited. */
PyObject *verify(PyObject *self, PyObject *arguments)
{
    PyObject *evidence_in, *states_in, *theta_in, *positions_in, *skipped_in;
    Py_ssize_t n;
    buffers all = {.count = 0};
    evidence by;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!OOOnO", &PyTuple_Type, &evidence_in, &states_in, &theta_in, &positions_in, &n,
                          &skipped_in))
        return NULL;
    int fine = take_evidence(&all, evidence_in, &by);
    Py_ssize_t m = by.count;
    const int64_t *states = NULL;
    const double *theta = NULL;
    const vector *positions = NULL;
    const char *skipped = NULL;
    fine = fine && (states = borrow(&all, states_in, n * 8)) && (theta = borrow(&all, theta_in, n * 8)) &&
           (positions = borrow(&all, positions_in, n * 16)) &&
           (skipped_in == Py_None || (skipped = borrow(&all, skipped_in, n * m))) && states_exist(&by, states, n);
    PyObject *out[6] = {NULL};
    const Py_ssize_t count[6] = {n * m, n, n * m, n * m, n * m, n * m};
    const size_t width[6] = {1, 1, 8, 16, 16, 1};
    for (int k = 0; k < 6 && fine; k++)
        fine = (out[k] = array_of(count[k], width[k])) != NULL;
    for (Py_ssize_t i = 0; i < n && fine; i++) {
        pose at = {states[i], theta[i], positions[i]};
        AS(char, out[1])[i] = (char)judge(&by, &at, skipped ? skipped + i * m : NULL, 1);
        for (Py_ssize_t k = 0; k < m; k++) {
            Py_ssize_t row = i * m + k;
            AS(char, out[0])[row] = by.fits[k];
            AS(double, out[2])[row] = by.places[k].distance;
            AS(vector, out[3])[row] = by.places[k].offset;
            AS(vector, out[4])[row] = by.places[k].normal;
            AS(char, out[5])[row] = by.places[k].limited;
        }
    }
    end_evidence(&by);
    release(&all);
    if (fine)
        return Py_BuildValue("NNNNNN", out[0], out[1], out[2], out[3], out[4], out[5]);
    for (int k = 0; k < 6; k++)
        Py_XDECREF(out[k]);
    return NULL;
}

/* A contact of a pose, which may be off by `bound`. */
typedef struct {
    double bound;
    int64_t order, pose, contact;
} question;

static int by_bound(const void *a, const void *b)
{
    const question *one = a, *two = b;
    if (one->bound != two->bound)
        return one->bound < two->bound ? -1 : 1;
    return one->order < two->order ? -1 : 1;
}

static int is_asked(const evidence *by, const pose_cells *cells, Py_ssize_t i, Py_ssize_t k, Py_ssize_t kind)
{
    return by->on[k] == by->on[kind] && by->contacts[k].touched &&
           !(cells->skipped && cells->skipped[i * by->count + k]);
}

static double bound_of(const pose_cells *cells, Py_ssize_t i, const contact *of)
{
    return of->bound + (cells->turn[i] * length_of(of->end) + cells->shift[i]);
}

/* Whether there is a place for a contact near pose i; to `near` is added how many pieces have one. */
static int has_place(const evidence *by, const pose_cells *cells, Py_ssize_t i, Py_ssize_t k, vector point,
                     double bound, int64_t *near)
{
    const contact *of = &by->contacts[k];
    double wider = cells->turn[i], width = of->width >= 0 ? of->width + 2 * wider : of->width;
    claim claimed = {point, of->lo - cells->theta[i] - wider, width, bound, 10 * ALLOWANCE_MM};
    place found;
    *near += nearest_place(by->on[k], cells->states[i], &claimed, 0, &found);
    return found.distance <= bound + ALLOWANCE_MM;
}

/* Rule out poses by contacts of one kind of finger in any order; whether no more than `most` pieces were near by.
   Where there are few contacts to look at, the budget is not asked, and no more is looked at than need be. */
static int rule_out(const evidence *by, const pose_cells *cells, Py_ssize_t kind, int few, int64_t most, char *left)
{
    int64_t near = 0;
    for (Py_ssize_t i = 0; i < cells->count; i++) {
        pose at = {cells->states[i], cells->theta[i], cells->positions[i]};
        double c = cos(-at.theta), s = sin(-at.theta);
        for (Py_ssize_t k = kind; k < by->count; k++) {
            const contact *of = &by->contacts[k];
            if (!is_asked(by, cells, i, k, kind) || (few && !left[i]))
                continue;
            if (!has_place(by, cells, i, k, seen_from(&at, c, s, of->end), bound_of(cells, i, of), &near))
                left[i] = 0;
        }
        if (!few && near > most)
            return 0;
    }
    return 1;
}

/* The same, smallest bounds first, AT_ONCE by AT_ONCE; once more than `most` pieces were near by, no further poses
   are ruled out: as `nearest_places` has it. Whether there was memory. */
static int rule_out_some(const evidence *by, const pose_cells *cells, Py_ssize_t kind, int64_t count, int64_t most,
                         char *left)
{
    question *asked = malloc((size_t)count * sizeof(question));
    if (!asked)
        return 0;
    int64_t near = 0, parts = count / AT_ONCE + 1, next = 0, end = 0;
    for (Py_ssize_t i = 0; i < cells->count; i++)
        for (Py_ssize_t k = kind; k < by->count; k++)
            if (is_asked(by, cells, i, k, kind)) {
                question one = {bound_of(cells, i, &by->contacts[k]), next, i, k};
                asked[next++] = one;
            }
    qsort(asked, (size_t)count, sizeof(question), by_bound);
    next = 0;
    for (int64_t part = 0; part < parts && near <= most; part++) {
        end += count / parts + (part < count % parts);
        for (; next < end; next++) {
            Py_ssize_t i = asked[next].pose, k = asked[next].contact;
            pose at = {cells->states[i], cells->theta[i], cells->positions[i]};
            vector point = seen_from(&at, cos(-at.theta), sin(-at.theta), by->contacts[k].end);
            if (!has_place(by, cells, i, k, point, asked[next].bound, &near))
                left[i] = 0;
        }
    }
    free(asked);
    return 1;
}

/* Rule out poses by all contacts of the same kind of finger as contact `kind`; whether there was memory. */
static int rule_out_by(const evidence *by, const pose_cells *cells, Py_ssize_t kind, int64_t most, char *left)
{
    int64_t count = 0;
    for (Py_ssize_t i = 0; i < cells->count; i++)
        for (Py_ssize_t k = kind; k < by->count; k++)
            count += is_asked(by, cells, i, k, kind);
    if (most < 0 || count < AT_ONCE)
        return rule_out(by, cells, kind, 1, most, left);
    char *before = malloc((size_t)cells->count);
    if (!before)
        return 0;
    memcpy(before, left, (size_t)cells->count);
    int fine = 1;
    if (!rule_out(by, cells, kind, 0, most, left)) {
        memcpy(left, before, (size_t)cells->count);
        fine = rule_out_some(by, cells, kind, count, most, left);
    }
    free(before);
    return fine;
}

int rule_out_all(const evidence *by, const pose_cells *cells, int64_t most, char *left)
{
    memset(left, 1, (size_t)cells->count);
    for (Py_ssize_t kind = 0; kind < by->count; kind++) {
        Py_ssize_t earlier = 0;
        while (by->on[earlier] != by->on[kind])
            earlier++;
        if (earlier == kind && !rule_out_by(by, cells, kind, most, left)) {
            PyErr_NoMemory();
            return 0;
        }
    }
    return 1;
}

/* may_fit(evidence, states, θ, positions, turns, shifts, n, skipped or None, most or −1): which poses may. */
PyObject *may_fit(PyObject *self, PyObject *arguments)
{
    PyObject *evidence_in, *in[5], *skipped_in;
    Py_ssize_t n;
    long long most;
    buffers all = {.count = 0};
    evidence by;
    pose_cells cells = {.skipped = NULL};
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!OOOOOnOL", &PyTuple_Type, &evidence_in, &in[0], &in[1], &in[2], &in[3], &in[4],
                          &n, &skipped_in, &most))
        return NULL;
    int fine = take_evidence(&all, evidence_in, &by);
    Py_ssize_t m = by.count;
    cells.count = n;
    fine = fine && (cells.states = borrow(&all, in[0], n * 8)) && (cells.theta = borrow(&all, in[1], n * 8)) &&
           (cells.positions = borrow(&all, in[2], n * 16)) && (cells.turn = borrow(&all, in[3], n * 8)) &&
           (cells.shift = borrow(&all, in[4], n * 8)) &&
           (skipped_in == Py_None || (cells.skipped = borrow(&all, skipped_in, n * m))) &&
           states_exist(&by, cells.states, n);
    PyObject *out = fine ? array_of(n, 1) : NULL;
    if (out && !rule_out_all(&by, &cells, most, AS(char, out)))
        Py_CLEAR(out);
    end_evidence(&by);
    release(&all);
    return out;
}

/* Groups of cells: connected components of boxes in (x, y, θ), as `palpate.recognizer.connected_components` has them. */

#include "calls.h"
#include "groups.h"

#define TOUCHING_RAD 1e-9

static int meet(const box *one, const box *two)
{
    if (one->x0 > two->x1 || two->x0 > one->x1 || one->y0 > two->y1 || two->y0 > one->y1)
        return 0;
    double apart = one->middle - two->middle;
    apart = fabs(apart - one->turn * rint(apart / one->turn));
    return apart <= one->half + two->half + TOUCHING_RAD;
}

static int64_t root_of(int64_t *parent, int64_t k)
{
    while (parent[k] != k)
        k = parent[k] = parent[parent[k]];
    return k;
}

/* The lesser of two roots is the root of both. */
static void join(int64_t *parent, int64_t one, int64_t two)
{
    one = root_of(parent, one);
    two = root_of(parent, two);
    if (one < two)
        parent[two] = one;
    else
        parent[one] = two;
}

/* Components by their roots, numbered in the order of their first boxes; how many. */
static int64_t numbered(int64_t *parent, Py_ssize_t count, int64_t *label)
{
    int64_t found = 0;
    for (Py_ssize_t k = 0; k < count; k++) {
        int64_t root = root_of(parent, k);
        label[k] = root == k ? found++ : label[root];
    }
    return found;
}

/* Boxes in the order of their states: where they lie, and which ones they are. */
typedef struct {
    double *x0, *y0, *x1, *y1;
    int64_t *order, *parent, *first;
} sorted;

static void sort_by_state(const box *boxes, Py_ssize_t count, Py_ssize_t states, sorted *to)
{
    for (Py_ssize_t k = 0; k < count; k++)
        to->first[boxes[k].state + 1]++;
    for (Py_ssize_t state = 0; state < states; state++)
        to->first[state + 1] += to->first[state];
    for (Py_ssize_t k = 0; k < count; k++) {
        const int64_t at = to->first[boxes[k].state]++;
        to->x0[at] = boxes[k].x0;
        to->y0[at] = boxes[k].y0;
        to->x1[at] = boxes[k].x1;
        to->y1[at] = boxes[k].y1;
        to->order[at] = k;
        to->parent[k] = k;
    }
}

#define AT_ONCE 256

/* Join a box with those of the places [from, at), so many at once, that it meets. */
static void join_with(const box *boxes, const sorted *all, int64_t from, int64_t at)
{
    unsigned char near[AT_ONCE];
    int32_t found[AT_ONCE];
    const int size = (int)(at - from < AT_ONCE ? at - from : AT_ONCE);
    const double *restrict x0 = all->x0 + from, *restrict y0 = all->y0 + from;
    const double *restrict x1 = all->x1 + from, *restrict y1 = all->y1 + from;
    const double left = all->x0[at], right = all->x1[at], low = all->y0[at], high = all->y1[at];
    for (int j = 0; j < size; j++)
        near[j] = (x0[j] <= right) & (left <= x1[j]) & (y0[j] <= high) & (low <= y1[j]);
    const int count = indices_of(near, size, found);
    for (int j = 0; j < count; j++) {
        const int64_t one = all->order[from + found[j]], two = all->order[at];
        if (meet(&boxes[one], &boxes[two]))
            join(all->parent, one, two);
    }
}

int64_t components_of_few(const box *boxes, Py_ssize_t count, Py_ssize_t states, int64_t *label)
{
    const size_t n = (size_t)count + 1;
    double *sides = malloc(4 * n * sizeof(double));
    int64_t *room = calloc(2 * n + (size_t)states + 2, sizeof(int64_t)), found = -1;
    if (sides && room) {
        sorted all = {sides, sides + n, sides + 2 * n, sides + 3 * n, room, room + n, room + 2 * n};
        sort_by_state(boxes, count, states, &all);
        for (int64_t at = 0, begin = 0; at < count; at++) {
            if (at && boxes[all.order[at]].state != boxes[all.order[at - 1]].state)
                begin = at;
            for (int64_t from = begin; from < at; from += AT_ONCE)
                join_with(boxes, &all, from, at);
        }
        found = numbered(all.parent, count, label);
    }
    free(sides);
    free(room);
    return found;
}

/* groups(states, middles, half widths, turns, lo (k × 2), hi (k × 2), k, order (m), m, ones (n), begins (n), ends (n),
   n): component of each box, numbered in the order of their first boxes. Box `one` is compared with those at the
   places [begin, end) of the order. */
PyObject *groups(PyObject *self, PyObject *arguments)
{
    PyObject *state_in, *middle_in, *half_in, *turn_in, *lo_in, *hi_in, *order_in, *one_in, *begin_in, *end_in;
    PyObject *out = NULL;
    Py_ssize_t count, places, rows;
    buffers all = {.count = 0};
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOOOOnOnOOOn", &state_in, &middle_in, &half_in, &turn_in, &lo_in, &hi_in, &count,
                          &order_in, &places, &one_in, &begin_in, &end_in, &rows))
        return NULL;
    const Py_ssize_t row = count * (Py_ssize_t)sizeof(double), asked = rows * (Py_ssize_t)sizeof(int64_t);
    const int64_t *state = NULL, *order = NULL, *ones = NULL, *begin = NULL, *end = NULL;
    const double *middle = NULL, *half = NULL, *turn = NULL, *lo = NULL, *hi = NULL;
    int fine = (state = borrow(&all, state_in, row)) && (middle = borrow(&all, middle_in, row)) &&
               (half = borrow(&all, half_in, row)) && (turn = borrow(&all, turn_in, row)) &&
               (lo = borrow(&all, lo_in, 2 * row)) && (hi = borrow(&all, hi_in, 2 * row)) &&
               (order = borrow(&all, order_in, places * (Py_ssize_t)sizeof(int64_t))) &&
               (ones = borrow(&all, one_in, asked)) && (begin = borrow(&all, begin_in, asked)) &&
               (end = borrow(&all, end_in, asked));
    box *boxes = malloc((size_t)(count + 1) * sizeof(box));
    int64_t *parent = malloc((size_t)(count + 1) * sizeof(int64_t));
    if (fine && !(boxes && parent))
        PyErr_NoMemory();
    fine = fine && boxes && parent;
    for (Py_ssize_t k = 0; fine && k < count; k++) {
        box one = {lo[2 * k], lo[2 * k + 1], hi[2 * k], hi[2 * k + 1], middle[k], half[k], turn[k], state[k]};
        boxes[k] = one;
        parent[k] = k;
    }
    for (Py_ssize_t k = 0; fine && k < rows; k++) {
        const int64_t one = ones[k], last = end[k] < places ? end[k] : places;
        if (one < 0 || one >= count)
            continue;
        for (int64_t place = begin[k] < 0 ? 0 : begin[k]; place < last; place++) {
            const int64_t two = order[place];
            if (two >= 0 && two < count && boxes[one].state == boxes[two].state && meet(&boxes[one], &boxes[two]))
                join(parent, one, two);
        }
    }
    out = fine ? PyByteArray_FromStringAndSize(NULL, row) : NULL;
    if (out)
        numbered(parent, count, (int64_t *)PyByteArray_AsString(out));
    release(&all);
    free(boxes);
    free(parent);
    return out;
}

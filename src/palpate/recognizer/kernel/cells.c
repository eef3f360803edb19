/* Cells: for an interval of orientations, the convex polygon of positions that every contact's half-planes, at
   their largest over the interval, leave. The same as `palpate.recognizer.numpy_cells.cut_cells` by whole arrays. */

#include "calls.h"
#include "cells.h"

#define ANYWHERE_MM 1e5 /* limit of a half-plane that constrains nothing */

typedef struct {
    double lo, hi, cos_lo, sin_lo, cos_hi, sin_hi;
} span;

/* Maximum of a cos θ + b sin θ; over half a turn and more the amplitude stands for it. */
static double sinusoid_maximum(double a, double b, const span *at)
{
    if ((b * at->cos_lo > a * at->sin_lo && b * at->cos_hi < a * at->sin_hi) || at->hi - at->lo >= PI)
        return sqrt(a * a + b * b);
    return larger(a * at->cos_lo + b * at->sin_lo, a * at->cos_hi + b * at->sin_hi);
}

/* The four half-planes of a contact on an edge: outer side, inner side, far end, near end. */
static void half_planes(const edge_set *edges, int64_t edge, const tip *contact, const span *at, half_plane found[4])
{
    static const double axes[4][2] = {{0, 1}, {0, -1}, {-1, 0}, {1, 0}};
    for (int k = 0; k < 4; k++) {
        if (edge < 0) {
            half_plane any = {axes[k][0], axes[k][1], ANYWHERE_MM};
            found[k] = any;
            continue;
        }
        const double *u = (k < 2 ? edges->normal : edges->direction) + 2 * edge;
        double sign = k % 2 ? 1.0 : -1.0, gx = sign * u[0], gy = sign * u[1];
        double a = gx * contact->x + gy * contact->y, b = gx * contact->y - gy * contact->x;
        half_plane one = {gx, gy, edges->side_limits[4 * edge + k] + contact->bound + sinusoid_maximum(a, b, at)};
        found[k] = one;
    }
}

/* The rectangle of four half-planes that come in opposite pairs. */
static int rectangle(const half_plane side[4], point corner[4])
{
    const double across[2] = {-side[0].limit, side[1].limit}, length[2] = {-side[2].limit, side[3].limit};
    static const int order[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    for (int k = 0; k < 4; k++) {
        double a = across[order[k][0]], b = length[order[k][1]];
        corner[k].x = a * side[1].gx + b * side[3].gx;
        corner[k].y = a * side[1].gy + b * side[3].gy;
    }
    return 4;
}

int clip(const point *polygon, int size, const half_plane *side, point *left)
{
    int count = 0;
    for (int k = 0; k < size; k++) {
        const point *one = &polygon[k], *two = &polygon[k + 1 < size ? k + 1 : 0];
        double height = one->x * side->gx + one->y * side->gy - side->limit;
        double next = two->x * side->gx + two->y * side->gy - side->limit;
        if (height <= 0)
            left[count++] = *one;
        if ((height <= 0) != (next <= 0)) {
            double share = height / (height - next);
            left[count].x = one->x + share * (two->x - one->x);
            left[count++].y = one->y + share * (two->y - one->y);
        }
    }
    return count;
}

static int sticks_out(const point *polygon, int size, const half_plane *side)
{
    for (int k = 0; k < size; k++)
        if (polygon[k].x * side->gx + polygon[k].y * side->gy - side->limit > 0)
            return 1;
    return 0;
}

int cut(const pairings *all, const int64_t *edge, double lo, double hi, point *room, const point **polygon)
{
    const span at = {lo, hi, cos(lo), sin(lo), cos(hi), sin(hi)};
    half_plane side[4];
    point *now = room, *next = room + ROOM_FOR(all->contacts) / 2;
    half_planes(all->sets[0], edge[0], &all->tips[0], &at, side);
    int size = rectangle(side, now);
    for (Py_ssize_t k = 1; k < all->contacts && size; k++) {
        half_planes(all->sets[k], edge[k], &all->tips[k], &at, side);
        for (int j = 0; j < 4 && size; j++)
            if (sticks_out(now, size, &side[j])) {
                size = clip(now, size, &side[j], next);
                point *before = now;
                now = next;
                next = before;
            }
    }
    *polygon = now;
    return size;
}

int take_pairings(buffers *all, PyObject *in, pairings *taken)
{
    PyObject *sets, *tips, *edges, *states;
    memset(taken, 0, sizeof(pairings));
    if (!PyArg_ParseTuple(in, "O!O!OOn", &PyTuple_Type, &sets, &PyTuple_Type, &tips, &edges, &states, &taken->nodes))
        return 0;
    const Py_ssize_t contacts = taken->contacts = PyTuple_Size(sets), row = taken->nodes * 8;
    if (contacts < 1 || PyTuple_Size(tips) != contacts) {
        PyErr_SetString(PyExc_ValueError, "a set of edges is needed for every contact");
        return 0;
    }
    taken->sets = malloc((size_t)contacts * sizeof(edge_set *));
    taken->tips = malloc((size_t)contacts * sizeof(tip));
    if (!taken->sets || !taken->tips) {
        PyErr_NoMemory();
        return 0;
    }
    if (!take_sets(sets, taken->sets) || !take_tips(tips, taken->tips) ||
        !(taken->edges = borrow(all, edges, contacts * row)))
        return 0;
    return states == Py_None || (taken->states = borrow(all, states, row)) != NULL;
}

void end_pairings(pairings *taken)
{
    free(taken->sets);
    free(taken->tips);
}

int nodes_exist(const pairings *all, const int64_t *node, Py_ssize_t count)
{
    for (Py_ssize_t k = 0; k < count; k++)
        if (node[k] < 0 || node[k] >= all->nodes) {
            PyErr_SetString(PyExc_IndexError, "there is no such interpretation");
            return 0;
        }
    return 1;
}

PyObject *padded(const list *cells, const list *points, int64_t most)
{
    PyObject *found = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)(cells->size * (size_t)most * sizeof(point)));
    if (!found)
        return NULL;
    point *to = (point *)PyByteArray_AsString(found);
    for (size_t k = 0; k < cells->size; k++) {
        const cell *one = (const cell *)cells->data + k;
        const point *from = (const point *)points->data + one->first;
        for (int64_t j = 0; j < most; j++)
            *to++ = from[j < one->size ? j : 0];
    }
    return found;
}

int add_cell(list *cells, list *points, int64_t row, const point *polygon, int size)
{
    cell *one = list_add(cells);
    if (one) {
        cell found = {row, (int64_t)points->size, size};
        *one = found;
    }
    int fine = one != NULL;
    for (int j = 0; fine && j < size; j++) {
        point *to = list_add(points);
        if (to)
            *to = polygon[j];
        fine = to != NULL;
    }
    if (!fine)
        PyErr_NoMemory();
    return fine;
}

/* What Python gets: vertices of the largest polygon, rows, and polygons; releases all that was used. */
static PyObject *cells_found(buffers *all, list *cells, list *points, int64_t most, int fine)
{
    PyObject *rows = NULL, *polygons = fine ? padded(cells, points, most) : NULL;
    if (polygons && (rows = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)(cells->size * sizeof(int64_t)))))
        for (size_t k = 0; k < cells->size; k++)
            ((int64_t *)PyByteArray_AsString(rows))[k] = ((const cell *)cells->data)[k].row;
    release(all);
    free_list(cells);
    free_list(points);
    if (!rows) {
        Py_XDECREF(polygons);
        return NULL;
    }
    return Py_BuildValue("LNN", (long long)most, rows, polygons);
}

/* cut_cells(pairings, interpretation of each interval, lo, hi, number of intervals): vertices of the largest polygon, rows of intervals that are not
   empty, and their polygons. */
PyObject *cut_cells(PyObject *self, PyObject *arguments)
{
    PyObject *pairings_in, *node_in, *lo_in, *hi_in;
    Py_ssize_t count;
    buffers all = {.count = 0};
    pairings from;
    list cells = new_list(sizeof(cell)), points = new_list(sizeof(point));
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!OOOn", &PyTuple_Type, &pairings_in, &node_in, &lo_in, &hi_in, &count))
        return NULL;
    const Py_ssize_t row = count * (Py_ssize_t)sizeof(double);
    const int64_t *node = NULL;
    const double *lo = NULL, *hi = NULL;
    int fine = take_pairings(&all, pairings_in, &from) && (node = borrow(&all, node_in, row)) &&
               (lo = borrow(&all, lo_in, row)) && (hi = borrow(&all, hi_in, row)) && nodes_exist(&from, node, count);
    point *room = malloc((size_t)ROOM_FOR(from.contacts) * sizeof(point));
    if (fine && !room)
        PyErr_NoMemory();
    fine = fine && room;
    int64_t most = 4;
    for (Py_ssize_t k = 0; fine && k < count; k++) {
        const point *polygon;
        int size = cut(&from, from.edges + from.contacts * node[k], lo[k], hi[k], room, &polygon);
        if (!size)
            continue;
        fine = add_cell(&cells, &points, k, polygon, size);
        most = size > most ? size : most;
    }
    free(room);
    end_pairings(&from);
    return cells_found(&all, &cells, &points, most, fine);
}

/* Cells: polygons of positions, and what they are cut from. */

#ifndef PALPATE_CELLS_H
#define PALPATE_CELLS_H

#include "edges.h"

typedef struct {
    double x, y;
} point;

/* g·s ≤ limit, at the largest limit over the interval. */
typedef struct {
    double gx, gy, limit;
} half_plane;

/* Interpretations: edges of contacts (nodes × contacts), and their states (nodes), or NULL. */
typedef struct {
    Py_ssize_t contacts, nodes;
    const edge_set **sets;
    tip *tips;
    const int64_t *edges, *states;
} pairings;

/* Fill in from a tuple (edge sets of m contacts, (x, y, bound) of each, edges (n × m), states or None, n); whether
   that went well. To be ended in any case. */
int take_pairings(buffers *all, PyObject *tuple, pairings *taken);
void end_pairings(pairings *taken);

/* Whether there are such interpretations; an exception if not. */
int nodes_exist(const pairings *all, const int64_t *node, Py_ssize_t count);

/* Points of room for a cell of so many contacts. */
#define ROOM_FOR(contacts) (8 * (contacts) + 8)

/* The polygon of an interval of orientations, somewhere in the room; its size, 0 if nothing is left. */
int cut(const pairings *all, const int64_t *edge, double lo, double hi, point *room, const point **polygon);

/* Clip a convex polygon by a half-plane; number of vertices left. */
int clip(const point *polygon, int size, const half_plane *side, point *left);

/* Of a list: which interval it is of, and where its polygon is among all points. */
typedef struct {
    int64_t row, first, size;
} cell;

/* Add the polygon of a row; 0 with an exception set if memory is out. */
int add_cell(list *cells, list *points, int64_t row, const point *polygon, int size);

/* Polygons side by side, padded with their first vertex to the most vertices; as a bytearray. */
PyObject *padded(const list *cells, const list *points, int64_t most);

#endif

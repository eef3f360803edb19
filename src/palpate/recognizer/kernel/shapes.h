/* Shapes of polygons: what cells are compared and grouped by. */

#ifndef PALPATE_SHAPES_H
#define PALPATE_SHAPES_H

#include "cells.h"

/* The middle of a polygon's bounding box, the largest distance from there to a vertex, and the area. */
typedef struct {
    point centre;
    double radius, area;
} shape;

/* `term`: room for a number of each vertex. */
shape shape_of(const point *polygon, Py_ssize_t vertices, double *term);

/* How far R(θ)(s − origin) gets along +x, +y, −x and −y for s in the polygon and θ in [lo, hi]. */
void furthest_of(const point *polygon, Py_ssize_t vertices, point origin, double lo, double hi, double most[4]);

#endif

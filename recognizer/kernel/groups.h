/* Groups: connected components of boxes in (x, y, θ). */

#ifndef PALPATE_GROUPS_H
#define PALPATE_GROUPS_H

#include "kernel.h"

/* `grouping.Boxes`, one of them. */
typedef struct {
    double x0, y0, x1, y1, middle, half, turn;
    int64_t state;
} box;

/* Component of each of a few boxes, numbered in the order of their first ones; how many. `parent`: room. */
int64_t components_of_few(const box *boxes, Py_ssize_t count, int64_t *parent, int64_t *label);

#endif

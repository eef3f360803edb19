/* Groups: connected components of boxes in (x, y, θ). */

#ifndef PALPATE_GROUPS_H
#define PALPATE_GROUPS_H

#include "kernel.h"

/* `connected_components.Boxes`, one of them. */
typedef struct {
    double x0, y0, x1, y1, middle, half, turn;
    int64_t state;
} box;

/* Component of each box, numbered in the order of their first ones; how many, or −1 if memory is out. Each is compared
   with all others of its state, of which there should be few. */
int64_t components_of_few(const box *boxes, Py_ssize_t count, Py_ssize_t states, int64_t *label);

#endif

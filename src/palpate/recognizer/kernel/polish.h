/* Witness polishing, pose by pose. */

#ifndef PALPATE_POLISH_H
#define PALPATE_POLISH_H

#include "verify.h"

/* Cells of regions, those of region i from `first`[i] on; `null` (nodes × touched): spurious contacts, or NULL. */
typedef struct {
    Py_ssize_t count, vertices, regions, nodes, touched;
    const int64_t *node, *first;
    const double *lo, *hi;
    const vector *polygon; /* count × vertices */
    const char *null;
} region_cells;

/* An equation of the least squares: −towards · shift + turning · turn = right. */
typedef struct {
    double of[3], right;
} equation;

/* Move a pose, a candidate in `cell`, until it holds; whether it does. `rows`: room for one of each contact. */
int polish_pose(evidence *by, const region_cells *cells, int64_t region, int64_t cell, const char *skipped,
                equation *rows, pose *at);

#endif

/* Free paths: whether what a finger did not meet rules a cell out. */

#ifndef PALPATE_SWEEP_H
#define PALPATE_SWEEP_H

#include "edges.h"

/* A straight path of a tip's centre: its start from the anchor, its heading in W, the bound on both. */
typedef struct {
    double x, y, u, v, bound, travel;
} approach;

typedef struct {
    double enter, leave;
    int crossing;
    int64_t edge;
} capsule;

/* Paths, and the outlines that may be in their way; `room` and `near`: for as many as a state has edges, and one. */
typedef struct {
    Py_ssize_t count;
    const edge_set **sets;
    const approach *path;
    capsule *room;
    int64_t *near;
} paths;

/* Fill in from outlines of m paths, and the paths (m × 6); whether that went well. To be ended in any case. */
int take_paths(buffers *all, PyObject *sets, PyObject *rows, paths *taken);
void end_paths(paths *taken);

/* Whether no path that is not `skipped` (m, or NULL) rules a cell out: its latest stop is not before its end. */
int paths_are_free(const paths *of, int64_t state, double lo, double hi, const double *polygon, Py_ssize_t vertices,
                   const char *skipped);

#endif

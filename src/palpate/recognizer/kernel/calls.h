/* What Python may call, one line a function. */

#ifndef PALPATE_CALLS_H
#define PALPATE_CALLS_H

#include "kernel.h"

PyObject *prepared_edges(PyObject *self, PyObject *arrays);
PyObject *second_level(PyObject *self, PyObject *arguments);
PyObject *third_level(PyObject *self, PyObject *arguments);
PyObject *extend(PyObject *self, PyObject *arguments);
PyObject *narrow(PyObject *self, PyObject *arguments);
PyObject *cut_cells(PyObject *self, PyObject *arguments);
PyObject *sift_intervals(PyObject *self, PyObject *arguments);
PyObject *sift_parts(PyObject *self, PyObject *arguments);
PyObject *refine(PyObject *self, PyObject *arguments);
PyObject *regions(PyObject *self, PyObject *arguments);
PyObject *furthest(PyObject *self, PyObject *arguments);
PyObject *groups(PyObject *self, PyObject *arguments);
PyObject *free_paths(PyObject *self, PyObject *arguments);
PyObject *enclose_stops(PyObject *self, PyObject *arguments);
PyObject *prepared_boundary(PyObject *self, PyObject *arrays);
PyObject *verify(PyObject *self, PyObject *arguments);
PyObject *may_fit(PyObject *self, PyObject *arguments);
PyObject *polish(PyObject *self, PyObject *arguments);

#define KERNEL_CALLS \
    {"prepared_edges", prepared_edges, METH_O, NULL}, \
    {"second_level", second_level, METH_VARARGS, NULL}, \
    {"third_level", third_level, METH_VARARGS, NULL}, \
    {"extend", extend, METH_VARARGS, NULL}, \
    {"narrow", narrow, METH_VARARGS, NULL}, \
    {"cut_cells", cut_cells, METH_VARARGS, NULL}, \
    {"sift_intervals", sift_intervals, METH_VARARGS, NULL}, \
    {"sift_parts", sift_parts, METH_VARARGS, NULL}, \
    {"refine", refine, METH_VARARGS, NULL}, \
    {"regions", regions, METH_VARARGS, NULL}, \
    {"furthest", furthest, METH_VARARGS, NULL}, \
    {"groups", groups, METH_VARARGS, NULL}, \
    {"free_paths", free_paths, METH_VARARGS, NULL}, \
    {"enclose_stops", enclose_stops, METH_VARARGS, NULL}, \
    {"prepared_boundary", prepared_boundary, METH_O, NULL}, \
    {"verify", verify, METH_VARARGS, NULL}, \
    {"may_fit", may_fit, METH_VARARGS, NULL}, \
    {"polish", polish, METH_VARARGS, NULL},

#endif

/* True boundaries in capsules: arrays are checked once, when they are prepared. */

#include "boundary.h"
#include "calls.h"

#define BOUNDARY "palpate.boundary"

/* A boundary, and the arrays that it points into. */
typedef struct {
    buffers arrays;
    boundary found;
} prepared;

static void end_prepared(PyObject *capsule)
{
    prepared *held = PyCapsule_GetPointer(capsule, BOUNDARY);
    if (held)
        release(&held->arrays);
    free(held);
}

/* Whether rows and blocks of all states follow each other, and are as many as there are. */
static int in_order(const int64_t *row, const int64_t *block, Py_ssize_t states, Py_ssize_t rows, Py_ssize_t blocks)
{
    if (row[0] != 0 || block[0] != 0 || row[states] != rows || block[states] != blocks)
        return 0;
    for (Py_ssize_t k = 0; k < states; k++)
        if (row[k + 1] < row[k] || block[k + 1] - block[k] != (row[k + 1] - row[k] + BLOCK_ROWS - 1) / BLOCK_ROWS)
            return 0;
    return 1;
}

static int fill(prepared *held, PyObject *arrays)
{
    enum { RADIUS, CLEARANCE, PIECES, SIDES, PIECE_CIRCLES, FIRSTS, PIECE_BLOCKS = FIRSTS + 4, SIDE_BLOCKS, COUNT };
    static const Py_ssize_t width[COUNT] = {8, 8, sizeof(piece), sizeof(side), sizeof(circle), 8, 8, 8, 8,
                                            sizeof(circle), sizeof(circle)};
    const void *data[COUNT];
    Py_ssize_t rows[COUNT];
    int fits = 1;
    for (Py_ssize_t k = 0; k < COUNT; k++) {
        Py_ssize_t bytes;
        if (!(data[k] = borrow_item(&held->arrays, arrays, k, &bytes)))
            return 0;
        rows[k] = bytes / width[k];
        fits &= bytes % width[k] == 0;
    }
    boundary found = {
        .states = rows[CLEARANCE],
        .radius = data[RADIUS],
        .clearance = data[CLEARANCE],
        .pieces = data[PIECES],
        .sides = data[SIDES],
        .piece_circles = data[PIECE_CIRCLES],
        .first_piece = data[FIRSTS],
        .first_side = data[FIRSTS + 1],
        .first_piece_block = data[FIRSTS + 2],
        .first_side_block = data[FIRSTS + 3],
        .piece_blocks = data[PIECE_BLOCKS],
        .side_blocks = data[SIDE_BLOCKS],
    };
    fits &= rows[RADIUS] == found.states && rows[PIECES] == rows[PIECE_CIRCLES];
    for (int k = FIRSTS; k < FIRSTS + 4; k++)
        fits &= rows[k] == found.states + 1;
    fits = fits &&
           in_order(found.first_piece, found.first_piece_block, found.states, rows[PIECES], rows[PIECE_BLOCKS]) &&
           in_order(found.first_side, found.first_side_block, found.states, rows[SIDES], rows[SIDE_BLOCKS]);
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "arrays of a boundary do not fit together");
        return 0;
    }
    for (Py_ssize_t k = 0; k < found.states; k++)
        if (found.first_side[k + 1] - found.first_side[k] > found.most_sides)
            found.most_sides = found.first_side[k + 1] - found.first_side[k];
    held->found = found;
    return 1;
}

/* prepared_boundary(arrays of a true boundary): the boundary as all other calls take it. */
PyObject *prepared_boundary(PyObject *self, PyObject *arrays)
{
    (void)self;
    prepared *held = calloc(1, sizeof(prepared));
    if (!held)
        return PyErr_NoMemory();
    PyObject *capsule = fill(held, arrays) ? PyCapsule_New(held, BOUNDARY, end_prepared) : NULL;
    if (!capsule) {
        release(&held->arrays);
        free(held);
    }
    return capsule;
}

const boundary *boundary_of(PyObject *capsule)
{
    prepared *held = PyCapsule_GetPointer(capsule, BOUNDARY);
    return held ? &held->found : NULL;
}

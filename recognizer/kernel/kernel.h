/* Compiled kernel of the recogniser: what its parts share. See docs/adr/0038-a-compiled-kernel.md.

   Arrays come in as objects with the buffer protocol: C-contiguous, of the types that the Python side states
   (float64, int64, bool). Lengths are mm, angles rad. Nothing here keeps a reference beyond a call. */

#ifndef PALPATE_KERNEL_H
#define PALPATE_KERNEL_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846
#define TURN (2 * PI)
#define MOST_BUFFERS 32

/* Buffers that are held during a call, released together. */
typedef struct {
    Py_buffer held[MOST_BUFFERS];
    int count;
} buffers;

/* The data of `object`, of at least `bytes`; NULL with an exception set if it is no such buffer. */
const void *borrow(buffers *all, PyObject *object, Py_ssize_t bytes);

/* The data of member `index` of a tuple, and, unless `bytes` is NULL, how many there are. */
const void *borrow_item(buffers *all, PyObject *tuple, Py_ssize_t index, Py_ssize_t *bytes);

void release(buffers *all);

/* An array that grows: `size` items of `width` bytes. */
typedef struct {
    char *data;
    size_t size, room, width;
} list;

list new_list(size_t width);
void *list_add(list *items); /* room for one more; NULL if memory is out */
PyObject *list_bytes(list *items); /* its content as a bytearray; the list is freed */
void free_list(list *items);

/* x modulo a turn, in [0, 2π), as numpy's % has it. */
static inline double modulo_turn(double x)
{
    if (x >= 0 && x < TURN)
        return x;
    if (x < 0 && x > -TURN)
        return x + TURN;
    double r = fmod(x, TURN);
    if (r != 0 && r < 0)
        r += TURN;
    return r;
}

static inline double wrapped(double x) { return x - TURN * rint(x / TURN); }

static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double clipped(double x, double lo, double hi) { return smaller(larger(x, lo), hi); }

#endif

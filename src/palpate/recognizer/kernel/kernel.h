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

/* To so many decimals, 1e9 for nine: as numpy's round. */
static inline double rounded(double x, double decimals) { return rint(x * decimals) / decimals; }

/* To nine digits: `palpate.recognizer.tables.round_to_nine_digits`. */
static inline double to_nine_digits(double x)
{
    int power;
    const double share = frexp(x, &power);
    return ldexp(rounded(share, 1e9), power);
}

static inline double wrapped(double x) { return x - TURN * rint(x / TURN); }

static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double clipped(double x, double lo, double hi) { return smaller(larger(x, lo), hi); }

/* Cosine and sine to 1e-12, for angles of a few turns: for what is tested with more room than that. */
static inline void near_cosine_sine(double angle, double *cosine, double *sine)
{
    const double quarters = rint(angle * (2 / PI)), x = angle - quarters * (PI / 2), q = x * x;
    const int turned = (int)quarters & 3;
    double s = 1.0 / 6227020800, c = 1.0 / 479001600;
    s = 1.0 / 362880 + q * (-1.0 / 39916800 + q * s);
    s = x * (1 + q * (-1.0 / 6 + q * (1.0 / 120 + q * (-1.0 / 5040 + q * s))));
    c = 1.0 / 40320 + q * (-1.0 / 3628800 + q * c);
    c = 1 + q * (-1.0 / 2 + q * (1.0 / 24 + q * (-1.0 / 720 + q * c)));
    const double one = turned & 1 ? s : c, two = turned & 1 ? c : s;
    *cosine = turned == 1 || turned == 2 ? -one : one;
    *sine = turned & 2 ? -two : two;
}

/* Which of `size` flags are set, in order; how many. Mostly few are. */
static inline int indices_of(const unsigned char *flags, int size, int32_t *found)
{
    int count = 0, k = 0;
    for (; k + 8 <= size; k += 8) {
        uint64_t eight;
        memcpy(&eight, flags + k, sizeof eight);
        for (int j = k; eight && j < k + 8; j++) {
            found[count] = j;
            count += flags[j];
        }
    }
    for (; k < size; k++) {
        found[count] = k;
        count += flags[k];
    }
    return count;
}

#endif

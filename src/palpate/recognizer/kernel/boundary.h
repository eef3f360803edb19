/* True boundaries, as `compiled_steps._prepared_boundary` lists them; the place on one that is
   nearest to a point, and lines that keep clear of the section. */

#ifndef PALPATE_BOUNDARY_H
#define PALPATE_BOUNDARY_H

#include "kernel.h"

#define ALLOWANCE_MM 1e-6 /* `proximity.ALLOWANCE_MM` */
#define ALLOWANCE_RAD 1e-9 /* `proximity.ALLOWANCE_RAD` */
#define BLOCK_ROWS 16 /* `boundary_pieces.BLOCK_ROWS` */
#define NEXT_TO_NOTHING 1e-300

typedef struct {
    double x, y;
} vector;

static inline double length_of(vector a) { return sqrt(a.x * a.x + a.y * a.y); }
static inline double cross(vector a, vector b) { return a.x * b.y - a.y * b.x; }

/* A segment from `start` along `along`, and normals from `normal` in [0, 2π) on by `turn`: `first` to `last`. */
typedef struct {
    vector start, along;
    double length, normal, turn, off, radius;
    vector first, last;
} piece;

typedef struct {
    vector start, end;
} side;

typedef struct {
    vector middle;
    double radius;
} circle;

/* Rows of all states one after the other. Circles go round the places of each piece, and round blocks of
   BLOCK_ROWS pieces or sides; the last block of a state may have fewer. */
typedef struct {
    Py_ssize_t states;
    const double *radius, *clearance; /* of each state */
    const int64_t *first_piece, *first_side, *first_piece_block, *first_side_block; /* states + 1 */
    const piece *pieces;
    const side *sides;
    const circle *piece_circles, *piece_blocks, *side_blocks;
    Py_ssize_t most_sides; /* of a state */
} boundary;

/* The boundary in a capsule of `prepared_boundary`; NULL with an exception set if it is something else. */
const boundary *boundary_of(PyObject *capsule);

/* What a contact says of the tip's centre, in the object's frame: `point`, off by at most `bound`, with a normal
   in [lo, lo + width]; places are looked for `beyond` beyond the bound. A negative width allows no normal. */
typedef struct {
    vector point;
    double lo, width, bound, beyond;
} claim;

/* `proximity.Places` of one point. */
typedef struct {
    double distance;
    vector offset, normal;
    char fits, limited;
} place;

extern const place nowhere;

/* Find the nearest place; how many pieces have one near by. Unless it is `judged`, what may cover places is not
   looked at, and whether it is `limited` is not said. */
int64_t nearest_place(const boundary *all, int64_t state, const claim *of, int judged, place *found);

/* Whether a point is no nearer to the section than `least`; negative: no deeper in it. */
int is_clear(const boundary *all, int64_t state, vector point, double least);

/* Room for one line's sides. */
typedef struct {
    double enter, leave;
    int64_t order;
    int crossing;
} passed_side;

/* Whether the straight path of a tip's centre is clear of the object. `room`: for `most_sides`. */
int line_is_free(const boundary *all, int64_t state, vector begin, vector end, passed_side *room);

#endif

/* Edge sets, as `palpate.recognizer.compiled_steps.edge_arrays` lists them, and what contacts say of an edge. */

#ifndef PALPATE_EDGES_H
#define PALPATE_EDGES_H

#include "kernel.h"

typedef struct {
    Py_ssize_t edges, states;
    const int64_t *first;           /* states + 1 */
    const char *representative;     /* edges */
    const double *start, *end;      /* edges × 2 */
    const double *direction, *normal;
    const double *length, *normal_rad, *span;
    const double *middle_x, *middle_y; /* of the rectangle in which the tip's centre may lie */
    const double *half_across, *half_along, *half_diagonal;
    const double *side_limits; /* edges × 4 */
    const double *slack_mm;
    const double *centre_x, *centre_y; /* of the edge itself */
    const double *state_reach, *state_slack; /* states */
    double most_span;
    int64_t most_edges; /* of a state */
    /* Edges of each state in the order in which they lie round its centroid, and circles about BLOCK_EDGES of these:
       blocks of a state are those from `first_block` on, the last of them may have fewer. */
    struct round_edge *around;
    struct edge_block *blocks;
    int64_t *first_block; /* states + 1 */
} edge_set;

#define BLOCK_EDGES 16

/* An edge's midpoint and half length, and which one it is. */
struct round_edge {
    double x, y, half, angle;
    int64_t edge;
};

struct edge_block {
    double x, y, reach;
};

/* The edge set that `prepared_edges` made; NULL with an exception set if it is something else. */
const edge_set *edges_of(PyObject *prepared);

/* The same for a tuple of these, one a contact; whether all are. */
int take_sets(PyObject *tuple, const edge_set **sets);

/* Edges of a state whose normals are within [lo, lo + width]: up to two runs [from, to). */
typedef struct {
    int64_t from[2], to[2];
    int count;
} runs;

/* `guess`: the answer to a question like this one, or NULL: where to begin to look. */
runs by_normal(const edge_set *edges, int64_t state, double lo, double width, const runs *guess);

typedef struct {
    double lo, hi;
} interval;

/* Hull of the part of `one` inside `other` modulo a turn; lo > hi where there is none. */
static inline interval intersect(interval one, interval other)
{
    double width = one.hi - one.lo, other_width = other.hi - other.lo;
    double begin = modulo_turn(other.lo - one.lo);
    double tail = begin - TURN + other_width;
    double first = tail >= 0 ? 0.0 : begin <= width ? begin : INFINITY;
    double last = begin <= width ? smaller(width, begin + other_width) : smaller(width, tail);
    interval both = {one.lo + first, one.lo + last};
    return both;
}

/* Orientations that turn an edge's normal into a range (memo §2.2.2). */
static inline interval orientation_range(const edge_set *edges, int64_t edge, double normals_lo, double normals_hi)
{
    double lo = normals_lo - edges->normal_rad[edge] - edges->span[edge];
    interval range = {lo, lo + smaller(normals_hi - normals_lo + 2 * edges->span[edge], TURN)};
    return range;
}

/* A contact as the tests of the tree take it: place of the tip's centre from the anchor, and its bound. */
typedef struct {
    double x, y, bound;
} tip;

/* A tuple of (x, y, bound). */
int take_tips(PyObject *tuple, tip *tips);

/* Where contact b is from contact a. */
typedef struct {
    double length, bearing;
} chord;

chord chord_of(const tip *a, const tip *b);

/* Hulls of the orientations at which two, or three, contacts fit their edges. */
interval two_contacts(const edge_set *first, int64_t edge_a, const edge_set *second, int64_t edge_b, const tip *a,
                      const tip *b, const chord *from_a, interval at);
interval three_contacts(const edge_set *const sets[3], const int64_t edge[3], const tip *const tips[3], interval at);

#endif

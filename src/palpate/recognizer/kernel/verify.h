/* Evidence: contacts and misses, as `compiled_steps.evidence_arrays` lists them, and what poses have to do with
   them. */

#ifndef PALPATE_VERIFY_H
#define PALPATE_VERIFY_H

#include "boundary.h"

/* A contact or miss: the path of the tip's centre from the anchor, how far it may be off at its end and before it,
   and outward normals in [lo, lo + width]; a negative width allows none. */
typedef struct {
    double touched;
    vector start, end;
    double bound, path_bound, lo, width;
} contact;

typedef struct {
    Py_ssize_t count;
    const contact *contacts;
    const boundary **on; /* of each contact's finger */
    passed_side *room;
    place *places; /* of one pose: of each contact */
    char *fits;
} evidence;

/* A configuration: R(θ)(s + position) is a point of the table, seen from the anchor. */
typedef struct {
    int64_t state;
    double theta;
    vector position;
} pose;

/* Fill in evidence from a tuple (boundaries, rows); whether that went well. To be ended in any case. */
int take_evidence(buffers *all, PyObject *tuple, evidence *taken);
void end_evidence(evidence *taken);

/* Whether there are such states; an exception if not. */
int states_exist(const evidence *by, const int64_t *state, Py_ssize_t count);

/* Judge a pose by all contacts that are not `skipped` (NULL: none is), into `places` and `fits`; whether it holds.
   Unless it is `thorough`, the rest is left out where a contact has no place near by. */
int judge(evidence *by, const pose *at, const char *skipped, int thorough);

/* Cells of poses, turned by at most `turn` and shifted by at most `shift`. */
typedef struct {
    const int64_t *states;
    const double *theta;
    const vector *positions;
    const double *turn, *shift;
    const char *skipped;
    Py_ssize_t count;
} pose_cells;

/* Which cells may hold a pose that satisfies all contacts, as `verification.may_fit` says; `most` or −1 as there.
   Whether there was memory, with an exception if not. */
int rule_out_all(const evidence *by, const pose_cells *cells, int64_t most, char *left);

/* Where a point of the table, seen from the anchor, is in the object's frame. */
static inline vector seen_from(const pose *at, double cosine, double sine, vector point)
{
    vector turned = {cosine * point.x - sine * point.y, sine * point.x + cosine * point.y};
    vector result = {turned.x - at->position.x, turned.y - at->position.y};
    return result;
}

#endif

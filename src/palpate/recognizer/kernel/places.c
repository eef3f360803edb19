/* Nearest places on a true boundary: the same as `proximity.nearest_places`, point by point.

   Pieces that cannot have a place near by are passed over by circles round them, where numpy has a tree. Normals
   are unit vectors here, not angles: whether one is in a range is told by cross products. */

#include "boundary.h"

#define AT_END_RAD 1e-6
#define STEP_MM 1e-9
#define AS_NEAR 1e-9
#define AS_NEAR_MM2 1e-18

const place nowhere = {INFINITY, {0, 0}, {0, 0}, 0, 0};

/* A range of normals, counter-clockwise from `begin` to `end` by `turn`. */
typedef struct {
    vector begin, end;
    double turn;
} arc;

/* A place: from the point to it, the normal there, and how far that is, squared. */
typedef struct {
    vector offset, normal;
    double square;
} nearest;

static inline int beyond(const circle *around, vector point, double reach)
{
    double x = point.x - around->middle.x, y = point.y - around->middle.y, most = around->radius + reach;
    return x * x + y * y > most * most;
}

/* Whether a direction is in a range. */
static inline int within(const arc *range, vector direction)
{
    double first = cross(range->begin, direction), last = cross(direction, range->end);
    if (range->turn >= TURN)
        return 1;
    return range->turn <= PI ? first >= 0 && last >= 0 : first >= 0 || last >= 0;
}

static inline nearest at_normal(const piece *on, vector from_start, double radius, vector normal)
{
    vector left = {from_start.x - radius * normal.x, from_start.y - radius * normal.y};
    double foot = clipped(left.x * on->along.x + left.y * on->along.y, 0.0, on->length);
    nearest found = {{on->along.x * foot - left.x, on->along.y * foot - left.y}, normal, 0.0};
    found.square = found.offset.x * found.offset.x + found.offset.y * found.offset.y;
    return found;
}

static inline vector unit(vector a)
{
    double length = length_of(a);
    vector ahead = {1.0, 0.0};
    if (length > 0) {
        ahead.x = a.x / length;
        ahead.y = a.y / length;
    }
    return ahead;
}

/* From a point to the nearest centre of a tip on a piece with normals in a range; of normals that are as good the
   first one tried: `proximity._offsets`. */
static nearest offset_to(const piece *on, const arc *range, vector point, double radius)
{
    vector from_start = {point.x - on->start.x, point.y - on->start.y};
    nearest tried[6] = {at_normal(on, from_start, radius, range->begin)};
    if (!(range->turn > 0))
        return tried[0];
    int count = 2;
    tried[1] = at_normal(on, from_start, radius, range->end);
    if (on->length > 0) {
        vector out = {on->along.y, -on->along.x};
        double cosine = clipped(cross(from_start, on->along) / larger(radius, NEXT_TO_NOTHING), -1.0, 1.0);
        double sine = sqrt((1.0 - cosine) * (1.0 + cosine));
        for (int hand = -1; hand <= 1; hand += 2) {
            vector lean = {cosine * out.x + hand * sine * on->along.x, cosine * out.y + hand * sine * on->along.y};
            if (within(range, lean))
                tried[count++] = at_normal(on, from_start, radius, lean);
        }
    }
    vector straight = unit(from_start);
    if (within(range, straight))
        tried[count++] = at_normal(on, from_start, radius, straight);
    if (on->length > 0) {
        vector from_end = {from_start.x - on->along.x * on->length, from_start.y - on->along.y * on->length};
        straight = unit(from_end);
        if (within(range, straight))
            tried[count++] = at_normal(on, from_start, radius, straight);
    }
    double least = tried[0].square;
    for (int k = 1; k < count; k++)
        least = smaller(least, tried[k].square);
    int first = 0;
    while (tried[first].square > least * (1 + AS_NEAR) + AS_NEAR_MM2)
        first++;
    return tried[first];
}

static vector towards(vector begin, vector end, double most)
{
    vector leg = {end.x - begin.x, end.y - begin.y};
    double share = smaller(1.0, most / larger(length_of(leg), NEXT_TO_NOTHING));
    vector at = {begin.x + leg.x * share, begin.y + leg.y * share};
    return at;
}

static int apart(vector a, vector b, double most)
{
    vector leg = {a.x - b.x, a.y - b.y};
    return length_of(leg) > most;
}

/* `proximity._is_uncovered`: whether a tip's centre near a point, and `off` of the place, is clear. */
static int uncovered(const boundary *all, int64_t state, vector point, const nearest *to, double off, double bound)
{
    bound += ALLOWANCE_MM;
    vector at = {point.x + to->offset.x, point.y + to->offset.y};
    vector out = {at.x + off * to->normal.x, at.y + off * to->normal.y};
    vector beside = {point.x + bound * to->normal.x, point.y + bound * to->normal.y};
    for (int k = 0; k < 4; k++) {
        vector centre = k == 0 ? towards(point, at, bound)
                        : k == 1 ? towards(at, point, off)
                        : k == 2 ? towards(point, out, bound)
                                 : towards(at, beside, off);
        if (!apart(centre, point, bound + 1e-9) && !apart(centre, at, off + 1e-9) &&
            is_clear(all, state, centre, all->clearance[state] - ALLOWANCE_MM))
            return 1;
    }
    return 0;
}

/* A search for the place that is nearest to one point, in steps of STEP_MM. Of two that are as near, that of the
   lower piece counts; normals that begin where the contact's do, [1], come after all that begin where the piece's
   do, [0]. */
typedef struct {
    const boundary *all;
    const claim *of;
    int64_t state, near;
    int judged, fits;
    vector first, last; /* the contact's normals at either end, if `has_ends` */
    int has_ends;
    double away[2], gap[2], steps[2];
    nearest best[2];
} search;

static vector turned(double angle)
{
    vector ahead = {cos(angle), sin(angle)};
    return ahead;
}

static void look_at(search *job, const piece *on, const arc *range, int after)
{
    const claim *of = job->of;
    nearest found = offset_to(on, range, of->point, on->radius);
    double away = sqrt(found.square), gap = larger(away - on->off, 0.0);
    if (!(gap <= of->bound + of->beyond))
        return;
    job->near++;
    if (!job->fits && gap <= of->bound + ALLOWANCE_MM)
        job->fits = !(job->judged && on->off > 0 && job->all->clearance[job->state] > 0) ||
                    uncovered(job->all, job->state, of->point, &found, on->off, of->bound);
    double steps = rint(gap / STEP_MM);
    if (steps < job->steps[after]) {
        job->steps[after] = steps;
        job->gap[after] = gap;
        job->away[after] = away;
        job->best[after] = found;
    }
}

/* What pieces and the contact's normals, from `base` in [0, 2π) on by `width`, have in common:
   `proximity._common_normals`. */
static void look_at_piece(search *job, const piece *on, double base, double width)
{
    double after_lo = on->normal - base;
    if (after_lo < 0)
        after_lo += TURN;
    double after_piece = after_lo > 0 ? TURN - after_lo : 0.0;
    if (after_lo > width && after_piece > on->turn)
        return;
    if (!job->has_ends) {
        job->first = turned(base);
        job->last = turned(base + width);
        job->has_ends = 1;
    }
    if (after_lo <= width) {
        int whole = on->turn <= width - after_lo;
        arc range = {on->first, whole ? on->last : job->last, whole ? on->turn : width - after_lo};
        look_at(job, on, &range, 0);
    }
    if (after_piece <= on->turn) {
        int whole = width <= on->turn - after_piece;
        arc range = {job->first, whole ? job->last : on->last, whole ? width : on->turn - after_piece};
        look_at(job, on, &range, 1);
    }
}

int64_t nearest_place(const boundary *all, int64_t state, const claim *of, int judged, place *found)
{
    *found = nowhere;
    if (!(of->width >= 0))
        return 0;
    search job = {.all = all, .of = of, .state = state, .judged = judged, .steps = {INFINITY, INFINITY}};
    double width = of->width + 2 * ALLOWANCE_RAD, base = modulo_turn(of->lo - ALLOWANCE_RAD);
    double reach = of->bound + of->beyond;
    int64_t begin = all->first_piece[state], end = all->first_piece[state + 1];
    const circle *block = all->piece_blocks + all->first_piece_block[state];
    for (; begin < end; begin += BLOCK_ROWS, block++) {
        if (beyond(block, of->point, reach))
            continue;
        for (int64_t k = begin; k < end && k < begin + BLOCK_ROWS; k++)
            if (!beyond(&all->piece_circles[k], of->point, reach))
                look_at_piece(&job, &all->pieces[k], base, width);
    }
    found->fits = (char)job.fits;
    int which = job.steps[1] < job.steps[0];
    if (isinf(job.steps[which]))
        return job.near;
    const nearest *best = &job.best[which];
    double share = job.gap[which] / larger(job.away[which], NEXT_TO_NOTHING);
    found->distance = job.gap[which];
    found->offset.x = best->offset.x * share;
    found->offset.y = best->offset.y * share;
    found->normal = best->normal;
    if (!judged)
        return job.near;
    double angle = atan2(best->normal.y, best->normal.x) - of->lo + AT_END_RAD;
    found->limited = modulo_turn(angle) <= 2 * AT_END_RAD || modulo_turn(angle - of->width) <= 2 * AT_END_RAD;
    return job.near;
}

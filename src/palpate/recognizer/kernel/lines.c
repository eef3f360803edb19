/* Free lines: whether the centre of a tip, going straight, keeps clear of a section. The same as
   `proximity.lines_are_free` and `proximity.clearances`, line by line. */

#include "boundary.h"

/* A side as seen along a line: ahead x, to the left y. */
typedef struct {
    double x0, y0, x1, y1;
} seen_side;

/* A line from `begin` on, with a unit heading. */
typedef struct {
    vector begin, heading;
} line;

static inline vector seen(const line *from, vector point)
{
    double a = point.x - from->begin.x, b = point.y - from->begin.y;
    vector at = {from->heading.x * a + from->heading.y * b, from->heading.x * b - from->heading.y * a};
    return at;
}

static inline seen_side side_seen(const line *from, const side *whole)
{
    vector start = seen(from, whole->start), end = seen(from, whole->end);
    seen_side result = {start.x, start.y, end.x, end.y};
    return result;
}

static inline int is_crossed(const seen_side *s) { return (s->y0 > 0) != (s->y1 > 0); }

static inline double crossed_at(const seen_side *s) { return s->x0 - s->y0 * (s->x1 - s->x0) / (s->y1 - s->y0); }

/* From the point x of the line to a side. */
static inline double distance(const seen_side *s, double x)
{
    double u = s->x1 - s->x0, v = s->y1 - s->y0;
    double share = clipped(((x - s->x0) * u - s->y0 * v) / larger(u * u + v * v, NEXT_TO_NOTHING), 0.0, 1.0);
    vector leg = {s->x0 + share * u - x, s->y0 + share * v};
    return length_of(leg);
}

/* Whether a side is crossed by the line before it begins: an odd number of them, and it begins inside. */
static inline int is_behind(const seen_side *s)
{
    return is_crossed(s) && smaller(s->x0, s->x1) < 0 && crossed_at(s) < 0;
}

int is_clear(const boundary *all, int64_t state, vector point, double least)
{
    const line from = {point, {1.0, 0.0}};
    double reach = fabs(least);
    int inside = 0, touched = 0;
    int64_t begin = all->first_side[state], end = all->first_side[state + 1];
    const circle *block = all->side_blocks + all->first_side_block[state];
    for (; begin < end; begin += BLOCK_ROWS, block++) {
        vector middle = seen(&from, block->middle);
        double most = block->radius + reach;
        int near = middle.x * middle.x + middle.y * middle.y <= most * most;
        if (!near && (fabs(middle.y) > block->radius || middle.x > block->radius))
            continue;
        for (int64_t k = begin; k < end && k < begin + BLOCK_ROWS; k++) {
            seen_side one = side_seen(&from, &all->sides[k]);
            inside ^= is_behind(&one);
            if (near && !touched) {
                double away = distance(&one, 0.0);
                touched = least > 0 ? away < least : away <= reach;
            }
        }
    }
    /* Outside, `touched` is too near, unless it may be in it; inside, it is not too deep, if it may be. */
    return inside ? least <= 0 && touched : least <= 0 || !touched;
}

/* Whether a line begins outside and comes nowhere nearer to a side than `clear`, which is positive. */
static int keeps_away(const boundary *all, int64_t state, const line *from, double travel, double clear)
{
    int inside = 0;
    int64_t begin = all->first_side[state], end = all->first_side[state + 1];
    const circle *block = all->side_blocks + all->first_side_block[state];
    for (; begin < end; begin += BLOCK_ROWS, block++) {
        vector middle = seen(from, block->middle);
        double most = block->radius + clear;
        if (fabs(middle.y) > most || middle.x > travel + most ||
            (middle.x < -most && fabs(middle.y) > block->radius))
            continue;
        for (int64_t k = begin; k < end && k < begin + BLOCK_ROWS; k++) {
            seen_side one = side_seen(from, &all->sides[k]);
            inside ^= is_behind(&one);
            if (!(smaller(one.y0, one.y1) < clear && larger(one.y0, one.y1) > -clear &&
                  smaller(one.x0, one.x1) < travel + clear && larger(one.x0, one.x1) > -clear))
                continue;
            if (is_crossed(&one)) {
                double at = crossed_at(&one);
                if (at >= 0 && at <= travel)
                    return 0;
            }
            vector start = {one.x0 - clipped(one.x0, 0.0, travel), one.y0};
            vector stop = {one.x1 - clipped(one.x1, 0.0, travel), one.y1};
            if (length_of(start) < clear || length_of(stop) < clear || distance(&one, 0.0) < clear ||
                distance(&one, travel) < clear)
                return 0;
        }
    }
    return !inside;
}

/* Where a line comes within `wide` of a side, and where it leaves; enter > leave: nowhere. `proximity._near_stretches`. */
static passed_side pass(const seen_side *s, double wide)
{
    passed_side near = {INFINITY, -INFINITY, 0, is_crossed(s)};
    const double x[2] = {s->x0, s->x1}, y[2] = {s->y0, s->y1};
    for (int k = 0; k < 2; k++) {
        double square = wide * wide - y[k] * y[k];
        if (square >= 0) {
            near.enter = smaller(near.enter, x[k] - sqrt(square));
            near.leave = larger(near.leave, x[k] + sqrt(square));
        }
    }
    double u = s->x1 - s->x0, v = s->y1 - s->y0, length = larger(sqrt(u * u + v * v), NEXT_TO_NOTHING);
    for (int hand = -1; hand <= 1; hand += 2) {
        double along = s->x0 - hand * wide * v / length, aside = s->y0 + hand * wide * u / length;
        if ((aside > 0) != (aside + v > 0)) {
            double at = along - aside * u / v;
            near.enter = smaller(near.enter, at);
            near.leave = larger(near.leave, at);
        }
    }
    if (near.crossing) {
        double at = crossed_at(s);
        near.enter = smaller(near.enter, at);
        near.leave = larger(near.leave, at);
    }
    return near;
}

static int by_enter(const void *a, const void *b)
{
    const passed_side *one = a, *two = b;
    if (one->enter != two->enter)
        return one->enter < two->enter ? -1 : 1;
    return one->order < two->order ? -1 : 1;
}

/* Whether a line is nowhere inside and further than `depth` from every side: `proximity._stays_shallow`. */
static int stays_shallow(const boundary *all, int64_t state, const line *from, double travel, double depth,
                         passed_side *room)
{
    int64_t begin = all->first_side[state], end = all->first_side[state + 1], count = 0;
    const circle *block = all->side_blocks + all->first_side_block[state];
    for (; begin < end; begin += BLOCK_ROWS, block++) {
        if (fabs(seen(from, block->middle).y) > block->radius + depth)
            continue;
        for (int64_t k = begin; k < end && k < begin + BLOCK_ROWS; k++) {
            seen_side one = side_seen(from, &all->sides[k]);
            if (!(smaller(one.y0, one.y1) <= depth && larger(one.y0, one.y1) >= -depth))
                continue;
            passed_side near = pass(&one, depth);
            near.order = k;
            if (near.enter <= near.leave)
                room[count++] = near;
        }
    }
    if (count > 1)
        qsort(room, (size_t)count, sizeof(passed_side), by_enter);
    double left = -INFINITY;
    int inside = 0;
    for (int64_t k = 0; k < count; k++) {
        left = larger(left, room[k].leave);
        inside ^= room[k].crossing;
        double following = k + 1 < count ? room[k + 1].enter : INFINITY;
        if (inside && larger(left, 0.0) < smaller(following, travel))
            return 0;
    }
    return 1;
}

int line_is_free(const boundary *all, int64_t state, vector begin, vector end, passed_side *room)
{
    vector leg = {end.x - begin.x, end.y - begin.y};
    double travel = length_of(leg), clear = all->clearance[state] - ALLOWANCE_MM;
    line from = {begin, {1.0, 0.0}};
    if (travel > 0) {
        from.heading.x = leg.x / larger(travel, NEXT_TO_NOTHING);
        from.heading.y = leg.y / larger(travel, NEXT_TO_NOTHING);
    }
    if (clear > 0)
        return keeps_away(all, state, &from, travel, clear);
    return stays_shallow(all, state, &from, travel, -clear, room);
}

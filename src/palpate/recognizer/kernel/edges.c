/* Edges: look-up by normal, and the closed-form tests of two and three contacts (docs/recogniser.md). The same
   as `model_test.py` does with whole arrays. */

#include "edges.h"
#include "calls.h"

#define ROUNDING_MM 1e-9
#define ROUNDING_RAD 1e-12

#define EDGES "palpate.edges"

/* An edge set, and the arrays that it points into. */
typedef struct {
    buffers arrays;
    edge_set edges;
} prepared;

static void discard(prepared *held)
{
    if (held) {
        release(&held->arrays);
        free(held->edges.around);
        free(held->edges.blocks);
        free(held->edges.first_block);
    }
    free(held);
}

static void end_prepared(PyObject *capsule)
{
    discard(PyCapsule_GetPointer(capsule, EDGES));
}

static int by_angle(const void *a, const void *b)
{
    const struct round_edge *one = a, *two = b;
    if (one->angle != two->angle)
        return one->angle < two->angle ? -1 : 1;
    return (one->edge > two->edge) - (one->edge < two->edge);
}

/* The circle about the box of so many edges' midpoints that holds all of the edges. */
static struct edge_block block_of(const struct round_edge *edges, int64_t count)
{
    double least[2] = {INFINITY, INFINITY}, most[2] = {-INFINITY, -INFINITY};
    for (int64_t k = 0; k < count; k++) {
        least[0] = smaller(least[0], edges[k].x);
        least[1] = smaller(least[1], edges[k].y);
        most[0] = larger(most[0], edges[k].x);
        most[1] = larger(most[1], edges[k].y);
    }
    struct edge_block found = {(least[0] + most[0]) / 2, (least[1] + most[1]) / 2, 0};
    for (int64_t k = 0; k < count; k++)
        found.reach = larger(found.reach, hypot(edges[k].x - found.x, edges[k].y - found.y) + edges[k].half);
    found.reach += 1e-9;
    return found;
}

/* Arrange each state's edges round about, in blocks; whether there was memory. */
static int arrange(edge_set *all)
{
    int64_t blocks = 0;
    all->around = malloc((size_t)(all->edges + 1) * sizeof(struct round_edge));
    all->blocks = malloc((size_t)(all->edges / BLOCK_EDGES + all->states + 1) * sizeof(struct edge_block));
    all->first_block = malloc((size_t)(all->states + 1) * sizeof(int64_t));
    if (!all->around || !all->blocks || !all->first_block) {
        PyErr_NoMemory();
        return 0;
    }
    for (Py_ssize_t k = 0; k < all->edges; k++) {
        struct round_edge one = {all->centre_x[k], all->centre_y[k], all->length[k] / 2,
                                 atan2(all->centre_y[k], all->centre_x[k]), k};
        all->around[k] = one;
    }
    for (Py_ssize_t state = 0; state < all->states; state++) {
        const int64_t begin = all->first[state], end = all->first[state + 1];
        all->first_block[state] = blocks;
        if (end > begin)
            qsort(all->around + begin, (size_t)(end - begin), sizeof(struct round_edge), by_angle);
        for (int64_t from = begin; from < end; from += BLOCK_EDGES)
            all->blocks[blocks++] = block_of(all->around + from, end - from < BLOCK_EDGES ? end - from : BLOCK_EDGES);
    }
    all->first_block[all->states] = blocks;
    return 1;
}

static int fill(prepared *held, PyObject *arrays)
{
    const void *data[21];
    Py_ssize_t bytes[21];
    for (Py_ssize_t k = 0; k < 21; k++)
        if (!(data[k] = borrow_item(&held->arrays, arrays, k, &bytes[k])))
            return 0;
    edge_set found = {
        .states = bytes[0] / (Py_ssize_t)sizeof(int64_t) - 1,
        .edges = bytes[1],
        .first = data[0],
        .representative = data[1],
        .start = data[2],
        .end = data[3],
        .direction = data[4],
        .normal = data[5],
        .length = data[6],
        .normal_rad = data[7],
        .span = data[8],
        .middle_x = data[9],
        .middle_y = data[10],
        .half_across = data[11],
        .half_along = data[12],
        .half_diagonal = data[13],
        .side_limits = data[14],
        .slack_mm = data[15],
        .centre_x = data[16],
        .centre_y = data[17],
        .state_reach = data[18],
        .state_slack = data[19],
        .most_span = *(const double *)data[20],
    };
    static const int width[21] = {0, 1, 16, 16, 16, 16, 8, 8, 8, 8, 8, 8, 8, 8, 32, 8, 8, 8, 0, 0, 0};
    int fits = found.states >= 0 && bytes[18] == found.states * 8 && bytes[19] == bytes[18] && bytes[20] == 8;
    for (int k = 1; k < 18; k++)
        fits &= bytes[k] == found.edges * width[k];
    for (Py_ssize_t k = 0; fits && k < found.states; k++) {
        const int64_t count = found.first[k + 1] - found.first[k];
        fits = count >= 0 && found.first[k] >= 0;
        found.most_edges = count > found.most_edges ? count : found.most_edges;
    }
    if (!fits || found.first[found.states] != found.edges) {
        PyErr_SetString(PyExc_ValueError, "arrays of edges do not fit together");
        return 0;
    }
    held->edges = found;
    return arrange(&held->edges);
}

/* prepared_edges(arrays of an edge set): the set as all other calls take it. */
PyObject *prepared_edges(PyObject *self, PyObject *arrays)
{
    (void)self;
    prepared *held = calloc(1, sizeof(prepared));
    if (!held)
        return PyErr_NoMemory();
    PyObject *capsule = fill(held, arrays) ? PyCapsule_New(held, EDGES, end_prepared) : NULL;
    if (!capsule)
        discard(held);
    return capsule;
}

const edge_set *edges_of(PyObject *capsule)
{
    prepared *held = PyCapsule_GetPointer(capsule, EDGES);
    return held ? &held->edges : NULL;
}

int take_sets(PyObject *tuple, const edge_set **sets)
{
    for (Py_ssize_t k = 0; k < PyTuple_Size(tuple); k++)
        if (!(sets[k] = edges_of(PyTuple_GetItem(tuple, k))))
            return 0;
    return 1;
}

int take_tips(PyObject *tuple, tip *tips)
{
    for (Py_ssize_t k = 0; k < PyTuple_Size(tuple); k++)
        if (!PyArg_ParseTuple(PyTuple_GetItem(tuple, k), "ddd", &tips[k].x, &tips[k].y, &tips[k].bound))
            return 0;
    return 1;
}

static int64_t lower_bound(const double *values, int64_t from, int64_t to, double value)
{
    while (from < to) {
        int64_t middle = (from + to) / 2;
        if (values[middle] < value)
            from = middle + 1;
        else
            to = middle;
    }
    return from;
}

#define STEPS 8

/* The same, begun at a guess: mostly a few steps from there. */
static int64_t lower_bound_near(const double *values, int64_t from, int64_t to, double value, int64_t guess)
{
    int64_t at = guess;
    if (guess < from || guess > to)
        return lower_bound(values, from, to, value);
    while (at < to && at < guess + STEPS && values[at] < value)
        at++;
    if (at == guess + STEPS)
        return lower_bound(values, at, to, value);
    if (at > guess)
        return at;
    while (at > from && at > guess - STEPS && values[at - 1] >= value)
        at--;
    return at == guess - STEPS ? lower_bound(values, from, at, value) : at;
}

static int64_t upper_bound_near(const double *values, int64_t from, int64_t to, double value, int64_t guess)
{
    int64_t at = lower_bound_near(values, from, to, value, guess);
    while (at < to && values[at] <= value)
        at++;
    return at;
}

runs by_normal(const edge_set *edges, int64_t state, double lo, double width, const runs *guess)
{
    static const runs none = {{-1, -1}, {-1, -1}, 0};
    int64_t begin = edges->first[state], end = edges->first[state + 1];
    runs found = {{begin, begin}, {end, begin}, 1};
    if (!guess)
        guess = &none;
    if (width >= TURN)
        return found;
    double from = modulo_turn(lo) - 1e-12, to = from + width + 2e-12;
    found.from[0] = lower_bound_near(edges->normal_rad, begin, end, from, guess->from[0]);
    found.to[0] = upper_bound_near(edges->normal_rad, found.from[0], end, to, guess->to[0]);
    double around = to - TURN;
    if (around >= 0) {
        found.count = 2;
        found.to[1] = upper_bound_near(edges->normal_rad, begin, end, around, guess->to[1]);
        if (found.to[1] > found.from[0])
            found.to[1] = found.from[0];
    }
    return found;
}

/* How far up from `angle` the first angle with nearest ≤ |angle| ≤ furthest (modulo a turn) is. */
static double advance_to_allowed(double angle, double nearest, double furthest)
{
    double begin = wrapped(angle), at = larger(begin, -furthest);
    if (at > -nearest && at < nearest)
        at = nearest;
    if (at > furthest)
        at = TURN - furthest;
    return at - begin;
}

/* By how much least ≤ height·cos(θ − crest) ≤ most moves the ends of an interval inwards. */
static void clip_to_sinusoid(interval at, double crest, double least, double most, double height, double *first,
                             double *last)
{
    double scale = larger(height, 1e-9);
    least /= scale;
    most /= scale;
    if (least <= -1.0 && most >= 1.0)
        return;
    if (most < -1.0 || least > 1.0) {
        *first = *last = INFINITY;
        return;
    }
    double nearest = (most >= 1.0 ? 0.0 : acos(most)) - ROUNDING_RAD;
    double furthest = (least <= -1.0 ? PI : acos(least)) + ROUNDING_RAD;
    *first = larger(*first, advance_to_allowed(at.lo - crest, nearest, furthest));
    *last = larger(*last, advance_to_allowed(crest - at.hi, nearest, furthest));
}

/* A sinusoid a cos θ + b sin θ at the ends of an interval of less than half a turn: values, slopes, and the height. */
typedef struct {
    double lo, hi, slope_lo, slope_hi, height;
} sinusoid;

enum verdict { EXCLUDED, UNDECIDED, ALLOWED };

/* Whether it is in [least, most] nowhere on the interval, or at both ends, by more than a billionth of its height: then
   the hull is known without arc cosines. A limit that neither end comes near moves neither: it is made infinite. */
static enum verdict range_verdict(const sinusoid *of, double *least, double *most)
{
    double scale = larger(of->height, 1e-9), margin = 1e-9 * scale;
    double upper = larger(of->lo, of->hi), lower = smaller(of->lo, of->hi);
    int crest = of->slope_lo >= -margin && of->slope_hi <= margin;
    int trough = of->slope_lo <= margin && of->slope_hi >= -margin;
    if ((crest ? scale : upper) < *least - margin || (trough ? -scale : lower) > *most + margin)
        return EXCLUDED;
    if (lower > *least + margin)
        *least = -INFINITY;
    if (upper < *most - margin)
        *most = INFINITY;
    return *least == -INFINITY && *most == INFINITY ? ALLOWED : UNDECIDED;
}

static const interval nothing = {INFINITY, -INFINITY};

chord chord_of(const tip *a, const tip *b)
{
    double x = b->x - a->x, y = b->y - a->y;
    chord found = {sqrt(x * x + y * y), atan2(y, x)};
    return found;
}

interval two_contacts(const edge_set *first, int64_t edge_a, const edge_set *second, int64_t edge_b, const tip *a,
                      const tip *b, const chord *from_a, interval at)
{
    if (edge_a < 0 || edge_b < 0)
        return at;
    const double *na = first->normal + 2 * edge_a, *nb = second->normal + 2 * edge_b;
    double gap_x = second->middle_x[edge_b] - first->middle_x[edge_a];
    double gap_y = second->middle_y[edge_b] - first->middle_y[edge_a];
    double across_a = first->half_across[edge_a] + a->bound, along_a = first->half_along[edge_a] + a->bound;
    double across_b = second->half_across[edge_b] + b->bound, along_b = second->half_along[edge_b] + b->bound;
    double cosine = fabs(na[0] * nb[0] + na[1] * nb[1]), sine = fabs(na[0] * nb[1] - na[1] * nb[0]);
    double half[4] = {
        across_a + cosine * across_b + sine * along_b,
        along_a + sine * across_b + cosine * along_b,
        across_b + cosine * across_a + sine * along_a,
        along_b + sine * across_a + cosine * along_a,
    };
    double middle[4] = {
        na[0] * gap_x + na[1] * gap_y,
        na[0] * gap_y - na[1] * gap_x,
        nb[0] * gap_x + nb[1] * gap_y,
        nb[0] * gap_y - nb[1] * gap_x,
    };
    /* Seen from the chord between the contacts, at the ends of the interval. */
    const double lo = at.lo - from_a->bearing, hi = at.hi - from_a->bearing, height = from_a->length;
    double c[2], s[2];
    near_cosine_sine(lo, &c[0], &s[0]);
    near_cosine_sine(hi, &c[1], &s[1]);
    for (int k = 0; k < 2; k++) {
        c[k] *= height;
        s[k] *= height;
    }
    const int narrow = at.hi - at.lo < 3.0;
    double inner = 0.0, outer = 0.0, least[4], most[4];
    int undecided = 0; /* a bit for each */
    for (int k = 0; k < 4; k++) {
        least[k] = middle[k] - half[k] - ROUNDING_MM;
        most[k] = middle[k] + half[k] + ROUNDING_MM;
        const double *n = k < 2 ? na : nb;
        const sinusoid normal = {c[0] * n[0] - s[0] * n[1], c[1] * n[0] - s[1] * n[1], -s[0] * n[0] - c[0] * n[1],
                                 -s[1] * n[0] - c[1] * n[1], height};
        const sinusoid along = {normal.slope_lo, normal.slope_hi, -normal.lo, -normal.hi, height};
        enum verdict found = narrow ? range_verdict(k % 2 ? &along : &normal, &least[k], &most[k]) : UNDECIDED;
        if (found == EXCLUDED)
            return nothing;
        undecided |= (found == UNDECIDED) << k;
    }
    for (int k = 0; k < 4; k++)
        if (undecided >> k & 1) {
            double turned = from_a->bearing - (k < 2 ? first->normal_rad[edge_a] : second->normal_rad[edge_b]);
            clip_to_sinusoid(at, k % 2 ? turned - PI / 2 : turned, least[k], most[k], height, &inner, &outer);
        }
    interval left = {at.lo + inner, at.hi - outer};
    return left;
}

/* One direction u of a contact's edge: −lower ≤ u·s − (cosine cos θ + sine sin θ) ≤ upper. */
typedef struct {
    double ux, uy, cosine, sine, lower, upper;
} axis;

static axis axis_of(const edge_set *edges, int64_t edge, const tip *contact, int which)
{
    const double *u = (which ? edges->direction : edges->normal) + 2 * edge;
    const double *limit = edges->side_limits + 4 * edge + 2 * which;
    axis found = {
        u[0],
        u[1],
        u[0] * contact->x + u[1] * contact->y,
        u[0] * contact->y - u[1] * contact->x,
        limit[0] + contact->bound,
        limit[1] + contact->bound,
    };
    return found;
}

interval three_contacts(const edge_set *const sets[3], const int64_t edge[3], const tip *const tips[3], interval at)
{
    axis axes[3][2];
    for (int k = 0; k < 3; k++) {
        if (edge[k] < 0)
            return at;
        for (int which = 0; which < 2; which++)
            axes[k][which] = axis_of(sets[k], edge[k], tips[k], which);
    }
    double cos_lo, sin_lo, cos_hi, sin_hi;
    near_cosine_sine(at.lo, &cos_lo, &sin_lo);
    near_cosine_sine(at.hi, &cos_hi, &sin_hi);
    const int narrow = at.hi - at.lo < 3.0;
    double inner = 0.0, outer = 0.0;
    for (int choice = 0; choice < 8 && inner < INFINITY; choice++) {
        const axis *side[3] = {&axes[0][choice >> 2], &axes[1][choice >> 1 & 1], &axes[2][choice & 1]};
        double a = 0.0, b = 0.0, least = 0.0, most = 0.0;
        for (int k = 0; k < 3; k++) {
            const axis *two = side[(k + 1) % 3], *three = side[(k + 2) % 3];
            double weight = two->ux * three->uy - two->uy * three->ux;
            double up = larger(weight, 0.0), down = larger(-weight, 0.0);
            a += weight * side[k]->cosine;
            b += weight * side[k]->sine;
            least -= up * side[k]->upper + down * side[k]->lower;
            most += up * side[k]->lower + down * side[k]->upper;
        }
        least -= ROUNDING_MM;
        most += ROUNDING_MM;
        const double height = sqrt(a * a + b * b);
        const sinusoid of = {a * cos_lo + b * sin_lo, a * cos_hi + b * sin_hi, b * cos_lo - a * sin_lo,
                             b * cos_hi - a * sin_hi, height};
        enum verdict found = narrow ? range_verdict(&of, &least, &most) : UNDECIDED;
        if (found == EXCLUDED)
            return nothing;
        if (found == UNDECIDED)
            clip_to_sinusoid(at, atan2(b, a), least, most, height, &inner, &outer);
    }
    interval left = {at.lo + inner, at.hi - outer};
    return left;
}

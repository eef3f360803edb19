/* Sifting: cells of intervals, or of parts of cells, that the free paths leave, and a candidate for a witness in
   each: the same as `palpate.recognizer.numpy_witnesses` finds with whole arrays, and as `numpy_cells` cuts and divides. */

#include "calls.h"
#include "shapes.h"
#include "sweep.h"

#define CORNER_SHARE 0.9 /* `numpy_witnesses._CORNER_SHARE` */
#define COINCIDING_MM 1e-9 /* `numpy_witnesses._COINCIDING_MM` */

/* What is found: cells one after the other. */
typedef struct {
    list cells, points, found;
    int64_t most;
} sifted;

/* A cell's orientations; a position in the middle one, where that `holds`. */
typedef struct {
    double lo, hi;
    point spot;
    int64_t holds;
} candidate;

/* Contacts that are spurious in interpretations, (nodes × evidence), or NULL. */
static const char *skipped_of(const char *null, const paths *of, int64_t node)
{
    return null ? null + node * of->count : NULL;
}

static sifted new_sifted(int64_t vertices)
{
    sifted all = {new_list(sizeof(cell)), new_list(sizeof(point)), new_list(sizeof(candidate)), vertices};
    return all;
}

static int add(sifted *all, int64_t row, const point *polygon, int size, const candidate *of)
{
    if (!add_cell(&all->cells, &all->points, row, polygon, size))
        return 0;
    candidate *one = list_add(&all->found);
    if (!one) {
        PyErr_NoMemory();
        return 0;
    }
    *one = *of;
    all->most = size > all->most ? size : all->most;
    return 1;
}

static point leg_of(point from, point to)
{
    point found = {to.x - from.x, to.y - from.y};
    return found;
}

static inline int before_of(int k, int size) { return k ? k - 1 : size - 1; }
static inline int after_of(int k, int size) { return k + 1 < size ? k + 1 : 0; }

/* Whether a vertex is where the one before it is. */
static int coincides(const point *polygon, int size, int k)
{
    const point leg = leg_of(polygon[before_of(k, size)], polygon[k]);
    return larger(fabs(leg.x), fabs(leg.y)) <= COINCIDING_MM;
}

/* Whether a vertex that coincides with none before it is not on a straight side. */
static int is_corner(const point *polygon, int size, int k)
{
    int before = before_of(k, size), after = after_of(k, size);
    while (before != k && coincides(polygon, size, before))
        before = before_of(before, size);
    while (after != k && coincides(polygon, size, after))
        after = after_of(after, size);
    const point came = leg_of(polygon[before], polygon[k]), goes = leg_of(polygon[k], polygon[after]);
    const point whole = {came.x + goes.x, came.y + goes.y};
    return fabs(came.x * goes.y - came.y * goes.x) > COINCIDING_MM * sqrt(whole.x * whole.x + whole.y * whole.y) ||
           came.x * goes.x + came.y * goes.y <= 0;
}

/* Mean of a polygon's corners: `numpy_witnesses.corner_means`. */
static point corner_mean(const point *polygon, int size)
{
    point sum = {0, 0};
    int count = 0;
    for (int k = 0; k < size; k++)
        if (!coincides(polygon, size, k) && is_corner(polygon, size, k)) {
            sum.x += polygon[k].x;
            sum.y += polygon[k].y;
            count++;
        }
    if (!count)
        return polygon[0];
    sum.x /= count;
    sum.y /= count;
    return sum;
}

static int is_open(const paths *of, int64_t state, double theta, point spot, const char *skipped)
{
    return paths_are_free(of, state, theta, theta, &spot.x, 1, skipped);
}

/* Look for a place of a section in the middle orientation that the free paths leave: the middle of its corners, and
   with `corners` places towards them. */
static void try_section(const paths *of, int64_t state, const point *section, int size, int corners,
                        const char *skipped, candidate *at)
{
    const double theta = (at->lo + at->hi) / 2;
    const point mean = corner_mean(section, size);
    at->spot = mean;
    at->holds = is_open(of, state, theta, mean, skipped);
    for (int k = 0; corners && k < size && !at->holds; k++) {
        point towards = {mean.x + CORNER_SHARE * (section[k].x - mean.x), mean.y + CORNER_SHARE * (section[k].y - mean.y)};
        if (is_open(of, state, theta, towards, skipped)) {
            at->spot = towards;
            at->holds = 1;
        }
    }
}

/* What Python gets: rows, lo, hi, polygons, vertices, spots and whether they hold; all is freed. */
static PyObject *sifted_arrays(buffers *all, sifted *from, int fine)
{
    const Py_ssize_t count = (Py_ssize_t)from->cells.size;
    static const Py_ssize_t width[5] = {8, 8, 8, 16, 1};
    PyObject *out[5] = {NULL}, *polygons = fine ? padded(&from->cells, &from->points, from->most) : NULL;
    fine = polygons != NULL;
    for (int k = 0; k < 5 && fine; k++)
        fine = (out[k] = PyByteArray_FromStringAndSize(NULL, count * width[k])) != NULL;
    for (Py_ssize_t k = 0; fine && k < count; k++) {
        const candidate *one = (const candidate *)from->found.data + k;
        ((int64_t *)PyByteArray_AsString(out[0]))[k] = ((const cell *)from->cells.data)[k].row;
        ((double *)PyByteArray_AsString(out[1]))[k] = one->lo;
        ((double *)PyByteArray_AsString(out[2]))[k] = one->hi;
        ((point *)PyByteArray_AsString(out[3]))[k] = one->spot;
        PyByteArray_AsString(out[4])[k] = (char)one->holds;
    }
    release(all);
    free_list(&from->cells);
    free_list(&from->points);
    free_list(&from->found);
    if (fine)
        return Py_BuildValue("NNNNLNN", out[0], out[1], out[2], polygons, (long long)from->most, out[3], out[4]);
    Py_XDECREF(polygons);
    for (int k = 0; k < 5; k++)
        Py_XDECREF(out[k]);
    return NULL;
}

/* Whether the paths' outlines know the states of all interpretations. */
static int states_fit(const pairings *from, const paths *of)
{
    for (Py_ssize_t k = 0; k < of->count; k++)
        for (Py_ssize_t node = 0; node < from->nodes; node++)
            if (from->states[node] < 0 || from->states[node] >= of->sets[k]->states) {
                PyErr_SetString(PyExc_IndexError, "there is no such state");
                return 0;
            }
    return 1;
}

/* sift_intervals(pairings, outlines of m paths, paths (m × 6), null (nodes × m) or None, interpretation of each
   interval, lo, hi, which are tried or None, number of intervals, corners): cells that the free paths leave: rows of
   their intervals, lo, hi, polygons, their vertices, spots, whether these hold. */
PyObject *sift_intervals(PyObject *self, PyObject *arguments)
{
    PyObject *pairings_in, *sets_in, *paths_in, *null_in, *node_in, *lo_in, *hi_in, *tried_in;
    Py_ssize_t count;
    int corners;
    buffers all = {.count = 0};
    pairings from;
    paths of = {.count = 0};
    sifted found = new_sifted(4);
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!O!OOOOOOnp", &PyTuple_Type, &pairings_in, &PyTuple_Type, &sets_in, &paths_in,
                          &null_in, &node_in, &lo_in, &hi_in, &tried_in, &count, &corners))
        return NULL;
    const int64_t *node = NULL;
    const double *lo = NULL, *hi = NULL;
    const char *null = NULL, *tried = NULL;
    int fine = take_pairings(&all, pairings_in, &from) && take_paths(&all, sets_in, paths_in, &of) &&
               (null_in == Py_None || (null = borrow(&all, null_in, from.nodes * of.count))) &&
               (node = borrow(&all, node_in, count * 8)) && (lo = borrow(&all, lo_in, count * 8)) &&
               (hi = borrow(&all, hi_in, count * 8)) &&
               (tried_in == Py_None || (tried = borrow(&all, tried_in, count))) && nodes_exist(&from, node, count) &&
               states_fit(&from, &of);
    point *room = malloc(2 * (size_t)ROOM_FOR(from.contacts) * sizeof(point));
    if (fine && !room)
        PyErr_NoMemory();
    fine = fine && room;
    for (Py_ssize_t k = 0; fine && k < count; k++) {
        const point *polygon, *section;
        const int64_t *edge = from.edges + from.contacts * node[k], state = from.states[node[k]];
        const char *skipped = skipped_of(null, &of, node[k]);
        int size = cut(&from, edge, lo[k], hi[k], room, &polygon);
        if (!size || !paths_are_free(&of, state, lo[k], hi[k], &polygon->x, size, skipped))
            continue;
        candidate one = {lo[k], hi[k], {0, 0}, 0};
        if (!tried || tried[k]) {
            const double middle = (lo[k] + hi[k]) / 2;
            int inner = cut(&from, edge, middle, middle, room + ROOM_FOR(from.contacts), &section);
            if (inner)
                try_section(&of, state, section, inner, corners, skipped, &one);
        }
        fine = add(&found, k, polygon, size, &one);
    }
    free(room);
    end_pairings(&from);
    end_paths(&of);
    return sifted_arrays(&all, &found, fine);
}

/* Cells, one after the other. */
typedef struct {
    const double *lo, *hi;
    const point *polygon;
    Py_ssize_t count, vertices;
} cell_rows;

#define FURTHEST_SHARE 0.999999999 /* `numpy_cells._FURTHEST_SHARE` */

/* How a cell is divided: by its orientations, or along `ahead` from `least` on in steps. */
typedef struct {
    int turned;
    point ahead;
    double least, step;
} division;

static division division_of(const cell_rows *cells, Py_ssize_t k, double lever, int parts, double *term)
{
    const point *polygon = cells->polygon + k * cells->vertices;
    const shape whole = shape_of(polygon, cells->vertices, term);
    division found = {0, {0, 0}, INFINITY, 0};
    double most = 0, height = -INFINITY;
    for (Py_ssize_t j = 0; j < cells->vertices; j++)
        most = larger(most, hypot(polygon[j].x - whole.centre.x, polygon[j].y - whole.centre.y));
    for (Py_ssize_t j = 0; j < cells->vertices; j++) {
        found.ahead.x = polygon[j].x - whole.centre.x;
        found.ahead.y = polygon[j].y - whole.centre.y;
        if (hypot(found.ahead.x, found.ahead.y) >= FURTHEST_SHARE * most)
            break;
    }
    found.turned = most <= (cells->hi[k] - cells->lo[k]) / 2 * lever;
    found.ahead.x /= larger(most, 1e-300);
    found.ahead.y /= larger(most, 1e-300);
    for (Py_ssize_t j = 0; j < cells->vertices; j++) {
        const double along = polygon[j].x * found.ahead.x + polygon[j].y * found.ahead.y;
        found.least = smaller(found.least, along);
        height = larger(height, along);
    }
    found.step = (height - found.least) / parts;
    return found;
}

/* Part `part` of a polygon, in `now` or in the `room` after it; its size. */
static int part_of(const division *by, int part, int parts, const point *polygon, int size, point *room, int most,
                   const point **found)
{
    const half_plane above = {by->ahead.x, by->ahead.y, by->least + (part + 1) * by->step};
    const half_plane below = {-by->ahead.x, -by->ahead.y, -(by->least + part * by->step)};
    *found = polygon;
    if (!by->turned && part + 1 < parts) {
        size = clip(*found, size, &above, room);
        *found = room;
    }
    if (!by->turned && part > 0 && size) {
        size = clip(*found, size, &below, room + most);
        *found = room + most;
    }
    return size;
}

/* Vertices of a polygon without the padding at its end. */
static int unpadded(const point *polygon, Py_ssize_t vertices)
{
    while (vertices > 1 && polygon[vertices - 1].x == polygon[0].x && polygon[vertices - 1].y == polygon[0].y)
        vertices--;
    return (int)vertices;
}

/* sift_parts(lo, hi, polygons (k × v), k, v, lever, parts, None, or (outlines of m paths, paths (m × 6), null (nodes × m)
   or None, nodes, states, interpretations)): cells in parts along whichever is longest, those that the free paths
   leave; what is returned is as of `sift_intervals`. */
PyObject *sift_parts(PyObject *self, PyObject *arguments)
{
    PyObject *lo_in, *hi_in, *polygon_in, *by_in, *sets_in, *paths_in, *null_in, *state_in, *node_in;
    Py_ssize_t nodes = 0;
    double lever;
    int parts;
    buffers all = {.count = 0};
    paths of = {.count = 0};
    cell_rows cells;
    sifted found = new_sifted(1);
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOnndiO", &lo_in, &hi_in, &polygon_in, &cells.count, &cells.vertices, &lever,
                          &parts, &by_in))
        return NULL;
    const Py_ssize_t row = cells.count * 8, most = 2 * cells.vertices + 2;
    const int64_t *state = NULL, *node = NULL;
    const char *null = NULL;
    int fine = (cells.lo = borrow(&all, lo_in, row)) && (cells.hi = borrow(&all, hi_in, row)) &&
               (cells.polygon = borrow(&all, polygon_in, 2 * row * cells.vertices));
    if (fine && by_in != Py_None)
        fine = PyArg_ParseTuple(by_in, "O!OOnOO", &PyTuple_Type, &sets_in, &paths_in, &null_in, &nodes, &state_in,
                                &node_in) &&
               take_paths(&all, sets_in, paths_in, &of) && (state = borrow(&all, state_in, row)) &&
               (node = borrow(&all, node_in, row)) &&
               (null_in == Py_None || (null = borrow(&all, null_in, nodes * of.count)));
    for (Py_ssize_t k = 0; fine && state && k < cells.count; k++) {
        fine = node[k] >= 0 && node[k] < nodes;
        for (Py_ssize_t j = 0; fine && j < of.count; j++)
            fine = state[k] >= 0 && state[k] < of.sets[j]->states;
        if (!fine)
            PyErr_SetString(PyExc_IndexError, "there is no such interpretation or state");
    }
    point *room = malloc(2 * (size_t)most * sizeof(point));
    double *term = malloc((size_t)(cells.vertices + 1) * sizeof(double));
    if (fine && !(room && term))
        PyErr_NoMemory();
    fine = fine && room && term;
    for (Py_ssize_t k = 0; fine && k < cells.count; k++) {
        const division by = division_of(&cells, k, lever, parts, term);
        const point *polygon = cells.polygon + k * cells.vertices, *part;
        const int size = unpadded(polygon, cells.vertices);
        const double width = (cells.hi[k] - cells.lo[k]) / parts;
        for (int nth = 0; fine && nth < parts; nth++) {
            const int left = part_of(&by, nth, parts, polygon, size, room, (int)most, &part);
            candidate one = {cells.lo[k], cells.hi[k], {0, 0}, 0};
            if (by.turned) {
                one.lo = cells.lo[k] + nth * width;
                one.hi = nth < parts - 1 ? one.lo + width : cells.hi[k];
            }
            const char *skipped = state ? skipped_of(null, &of, node[k]) : NULL;
            if (!left || (state && !paths_are_free(&of, state[k], one.lo, one.hi, &part->x, left, skipped)))
                continue;
            if (state)
                try_section(&of, state[k], part, left, 0, skipped, &one);
            fine = add(&found, k, part, left, &one);
        }
    }
    free(room);
    free(term);
    end_paths(&of);
    return sifted_arrays(&all, &found, fine);
}

/* Narrow an interval to what the model test leaves for an interpretation's contacts, taken in twos, and with `triples`
   in threes; whether anything is left. */
static int narrowed(const pairings *from, const int64_t *edge, const chord *chords, int triples, interval *at)
{
    const Py_ssize_t m = from->contacts;
    for (Py_ssize_t a = 0; a < m; a++)
        for (Py_ssize_t b = a + 1; b < m; b++) {
            *at = two_contacts(from->sets[a], edge[a], from->sets[b], edge[b], &from->tips[a], &from->tips[b],
                               &chords[a * m + b], *at);
            if (!(at->lo <= at->hi))
                return 0;
        }
    for (Py_ssize_t a = 0; triples && a < m; a++)
        for (Py_ssize_t b = a + 1; b < m; b++)
            for (Py_ssize_t c = b + 1; c < m; c++) {
                const edge_set *const sets[3] = {from->sets[a], from->sets[b], from->sets[c]};
                const int64_t edges[3] = {edge[a], edge[b], edge[c]};
                const tip *const tips[3] = {&from->tips[a], &from->tips[b], &from->tips[c]};
                *at = three_contacts(sets, edges, tips, *at);
                if (!(at->lo <= at->hi))
                    return 0;
            }
    return 1;
}

/* refine(pairings, interpretation of each cell, lo, hi, how many parts each, number of cells, triples): intervals of
   parts that the model test leaves: cells that they are of, lo, hi. */
PyObject *refine(PyObject *self, PyObject *arguments)
{
    PyObject *pairings_in, *node_in, *lo_in, *hi_in, *parts_in, *out[3] = {NULL};
    Py_ssize_t count;
    int triples;
    buffers all = {.count = 0};
    pairings from;
    list rows = new_list(8), los = new_list(8), his = new_list(8);
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!OOOOnp", &PyTuple_Type, &pairings_in, &node_in, &lo_in, &hi_in, &parts_in,
                          &count, &triples))
        return NULL;
    const int64_t *node = NULL, *parts = NULL;
    const double *lo = NULL, *hi = NULL;
    int fine = take_pairings(&all, pairings_in, &from) && (node = borrow(&all, node_in, count * 8)) &&
               (lo = borrow(&all, lo_in, count * 8)) && (hi = borrow(&all, hi_in, count * 8)) &&
               (parts = borrow(&all, parts_in, count * 8)) && nodes_exist(&from, node, count);
    const Py_ssize_t m = from.contacts;
    chord *chords = malloc((size_t)(m * m + 1) * sizeof(chord));
    if (fine && !chords)
        PyErr_NoMemory();
    fine = fine && chords;
    for (Py_ssize_t k = 0; fine && k < m * m; k++)
        chords[k] = chord_of(&from.tips[k / m], &from.tips[k % m]);
    for (Py_ssize_t k = 0; fine && k < count; k++) {
        const double width = (hi[k] - lo[k]) / (double)parts[k];
        for (int64_t part = 0; part < parts[k] && fine; part++) {
            interval at = {lo[k] + (double)part * width, hi[k]};
            if (part < parts[k] - 1)
                at.hi = at.lo + width;
            if (!narrowed(&from, from.edges + m * node[k], chords, triples, &at))
                continue;
            int64_t *row = list_add(&rows);
            double *one = list_add(&los), *two = list_add(&his);
            if (!(fine = row && one && two)) {
                PyErr_NoMemory();
                break;
            }
            *row = k;
            *one = at.lo;
            *two = at.hi;
        }
    }
    free(chords);
    end_pairings(&from);
    release(&all);
    list *lists[3] = {&rows, &los, &his};
    for (int k = 0; k < 3; k++)
        if (fine)
            fine = (out[k] = list_bytes(lists[k])) != NULL;
        else
            free_list(lists[k]);
    if (fine)
        return Py_BuildValue("NNN", out[0], out[1], out[2]);
    for (int k = 0; k < 3; k++)
        Py_XDECREF(out[k]);
    return NULL;
}

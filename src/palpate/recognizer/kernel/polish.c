/* Witness polishing: the same as `numpy_witnesses.polish`, pose by pose. */

#include "calls.h"
#include "polish.h"

/* Settings of `numpy_witnesses.polish`. */
#define STEPS 6
#define RELAXATION 0.6
#define GAIN 0.9
#define LEVER_MM 40.0
#define LARGEST_STEP_MM 1.0
#define DAMPING 1e-4
#define INNER 0.9
#define LEAST_WEIGHT 0.05
#define EXACT_MM 1e-3
#define IN_CELL_MM2 1e-9
#define IN_CELL_RAD 1e-12

/* The damped solution of `count` equations in their first `unknowns`, 2 or 3: normal equations, solved with
   row exchanges. `numpy_witnesses._least_squares`. */
static void solve(const equation *rows, Py_ssize_t count, int unknowns, double *solution)
{
    double square[3][4] = {{0}}, damping = 0;
    for (Py_ssize_t k = 0; k < count; k++)
        for (int i = 0; i < unknowns; i++) {
            for (int j = 0; j < unknowns; j++)
                square[i][j] += rows[k].of[i] * rows[k].of[j];
            square[i][3] += rows[k].of[i] * rows[k].right;
        }
    for (int i = 0; i < unknowns; i++)
        damping += square[i][i];
    for (int i = 0; i < unknowns; i++)
        square[i][i] += DAMPING * damping + 1e-12;
    for (int i = 0; i < unknowns; i++) {
        int pivot = i;
        for (int j = i + 1; j < unknowns; j++)
            if (fabs(square[j][i]) > fabs(square[pivot][i]))
                pivot = j;
        for (int k = 0; k < 4 && pivot != i; k++) {
            double kept = square[i][k];
            square[i][k] = square[pivot][k];
            square[pivot][k] = kept;
        }
        for (int j = i + 1; j < unknowns; j++) {
            double share = square[j][i] / square[i][i];
            for (int k = i; k < 4; k++)
                square[j][k] -= share * square[i][k];
        }
    }
    for (int i = unknowns - 1; i >= 0; i--) {
        solution[i] = square[i][3];
        for (int j = i + 1; j < unknowns; j++)
            solution[i] -= square[i][j] * solution[j];
        solution[i] /= square[i][i];
    }
}

/* How a pose is turned, within [lo, hi], and shifted towards the places of its contacts: `numpy_witnesses._step`.
   `rows`: room for an equation of each contact. */
static void step(const evidence *by, const pose *at, double lo, double hi, equation *rows, double *turn, vector *shift)
{
    double c = cos(-at->theta), s = sin(-at->theta), found[3];
    Py_ssize_t count = 0;
    for (Py_ssize_t k = 0; k < by->count; k++) {
        const place *to = &by->places[k];
        double away = to->distance, bound = larger(by->contacts[k].bound, EXACT_MM);
        if (isinf(away))
            continue;
        vector towards = to->normal;
        if (away > 1e-9) {
            towards.x = to->offset.x / away;
            towards.y = to->offset.y / away;
        }
        double weight = larger(away / bound, LEAST_WEIGHT) / bound;
        vector lever = seen_from(at, c, s, by->contacts[k].end);
        /* At the end of the contact's range it is the point that is touched that the surface has to reach. */
        double foot = to->limited ? by->on[k]->radius[at->state] : 0.0;
        lever.x += at->position.x - foot * to->normal.x;
        lever.y += at->position.y - foot * to->normal.y;
        double turning = cross(towards, lever) / LEVER_MM;
        equation row = {{-towards.x * weight, -towards.y * weight, turning * weight}, away * weight};
        rows[count++] = row;
    }
    solve(rows, count, 3, found);
    *turn = clipped(at->theta + found[2] / LEVER_MM, lo, hi) - at->theta;
    if (fabs(*turn * LEVER_MM - found[2]) > 1e-12) {
        for (Py_ssize_t k = 0; k < count; k++)
            rows[k].right -= rows[k].of[2] * (*turn * LEVER_MM);
        solve(rows, count, 2, found);
    }
    double size = sqrt(found[0] * found[0] + found[1] * found[1]);
    double share = smaller(1.0, LARGEST_STEP_MM / larger(size, NEXT_TO_NOTHING));
    shift->x = found[0] * share;
    shift->y = found[1] * share;
}

/* Whether a pose is in a cell of its region whose interpretation has the null contacts of `node`. */
static int in_region(const region_cells *cells, int64_t region, int64_t node, const pose *at)
{
    for (int64_t cell = cells->first[region]; cell < cells->first[region + 1]; cell++) {
        if (!(at->theta >= cells->lo[cell] - IN_CELL_RAD && at->theta <= cells->hi[cell] + IN_CELL_RAD))
            continue;
        if (cells->null && memcmp(cells->null + cells->node[cell] * cells->touched,
                                  cells->null + node * cells->touched, (size_t)cells->touched))
            continue;
        const vector *polygon = cells->polygon + cell * cells->vertices;
        int within = 1;
        for (Py_ssize_t k = 0; k < cells->vertices && within; k++) {
            vector from = polygon[k], to = polygon[k + 1 < cells->vertices ? k + 1 : 0];
            vector leg = {to.x - from.x, to.y - from.y};
            vector away = {at->position.x - from.x, at->position.y - from.y};
            within = cross(leg, away) >= -IN_CELL_MM2;
        }
        if (within)
            return 1;
    }
    return 0;
}

int polish_pose(evidence *by, const region_cells *cells, int64_t region, int64_t cell, const char *skipped,
                equation *rows, pose *at)
{
    double middle = (cells->lo[cell] + cells->hi[cell]) / 2, inner = INNER * ((cells->hi[cell] - cells->lo[cell]) / 2);
    double worst = INFINITY;
    for (int nth = 0;; nth++) {
        int good = judge(by, at, skipped, 0);
        if (good && (nth == 0 || in_region(cells, region, cells->node[cell], at)))
            return 1;
        /* Where the contact that is worst off gains little, nothing is to be hoped for. */
        double excess = by->count ? -INFINITY : 0.0;
        for (Py_ssize_t k = 0; k < by->count; k++)
            excess = larger(excess, by->fits[k] ? 0.0 : by->places[k].distance - by->contacts[k].bound);
        if (nth == STEPS || !(excess > 0 && excess < GAIN * worst))
            return 0;
        worst = excess;
        double turn;
        vector shift;
        step(by, at, middle - inner, middle + inner, rows, &turn, &shift);
        double share = nth == 0 ? 1.0 : RELAXATION;
        at->theta += share * turn;
        at->position.x += share * shift.x;
        at->position.y += share * shift.y;
    }
}

static int take_cells(buffers *all, PyObject *in, region_cells *cells)
{
    PyObject *node, *lo, *hi, *polygon, *first, *null;
    if (!PyArg_ParseTuple(in, "OOOOOOnnnnn", &node, &lo, &hi, &polygon, &first, &null, &cells->count, &cells->vertices,
                          &cells->regions, &cells->nodes, &cells->touched))
        return 0;
    Py_ssize_t row = cells->count * 8;
    cells->null = NULL;
    if (!(cells->node = borrow(all, node, row)) || !(cells->lo = borrow(all, lo, row)) ||
        !(cells->hi = borrow(all, hi, row)) || !(cells->polygon = borrow(all, polygon, 2 * row * cells->vertices)) ||
        !(cells->first = borrow(all, first, (cells->regions + 1) * 8)) ||
        (null != Py_None && !(cells->null = borrow(all, null, cells->nodes * cells->touched))))
        return 0;
    int fits = cells->first[0] >= 0 && cells->first[cells->regions] <= cells->count;
    for (Py_ssize_t k = 0; k < cells->regions; k++)
        fits &= cells->first[k] <= cells->first[k + 1];
    for (Py_ssize_t k = 0; k < cells->count; k++)
        fits &= cells->node[k] >= 0 && cells->node[k] < cells->nodes;
    if (!fits)
        PyErr_SetString(PyExc_ValueError, "cells and regions do not fit together");
    return fits;
}

/* polish(evidence, (cells' nodes, lo, hi, polygons, first, null or None, how many cells, vertices, regions, nodes and
   null columns), regions, cells, states, θ, positions, n, skipped or None): θ and positions of candidates as they
   are polished, and which hold. */
PyObject *polish(PyObject *self, PyObject *arguments)
{
    PyObject *evidence_in, *cells_in, *in[5], *skipped_in;
    Py_ssize_t n;
    buffers all = {.count = 0};
    evidence by;
    region_cells cells;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "O!O!OOOOOnO", &PyTuple_Type, &evidence_in, &PyTuple_Type, &cells_in, &in[0],
                          &in[1], &in[2], &in[3], &in[4], &n, &skipped_in))
        return NULL;
    int fine = take_evidence(&all, evidence_in, &by) && take_cells(&all, cells_in, &cells);
    const int64_t *region = NULL, *cell = NULL, *states = NULL;
    const double *theta = NULL;
    const vector *positions = NULL;
    const char *skipped = NULL;
    fine = fine && (region = borrow(&all, in[0], n * 8)) && (cell = borrow(&all, in[1], n * 8)) &&
           (states = borrow(&all, in[2], n * 8)) && (theta = borrow(&all, in[3], n * 8)) &&
           (positions = borrow(&all, in[4], n * 16)) &&
           (skipped_in == Py_None || (skipped = borrow(&all, skipped_in, n * by.count))) &&
           states_exist(&by, states, n);
    for (Py_ssize_t i = 0; i < n && fine; i++)
        if (region[i] < 0 || region[i] >= cells.regions || cell[i] < 0 || cell[i] >= cells.count) {
            PyErr_SetString(PyExc_IndexError, "there is no such cell");
            fine = 0;
        }
    PyObject *theta_out = NULL, *positions_out = NULL, *holds_out = NULL;
    equation *rows = NULL;
    if (fine) {
        theta_out = PyByteArray_FromStringAndSize((const char *)theta, n * 8);
        positions_out = PyByteArray_FromStringAndSize((const char *)positions, n * 16);
        holds_out = PyByteArray_FromStringAndSize(NULL, n);
        rows = malloc((size_t)(by.count + 1) * sizeof(equation));
        if (!rows)
            PyErr_NoMemory();
        fine = theta_out && positions_out && holds_out && rows;
    }
    for (Py_ssize_t i = 0; i < n && fine; i++) {
        pose at = {states[i], theta[i], positions[i]};
        const char *without = skipped ? skipped + i * by.count : NULL;
        int holds = polish_pose(&by, &cells, region[i], cell[i], without, rows, &at);
        ((double *)PyByteArray_AsString(theta_out))[i] = at.theta;
        ((vector *)PyByteArray_AsString(positions_out))[i] = at.position;
        PyByteArray_AsString(holds_out)[i] = (char)holds;
    }
    free(rows);
    end_evidence(&by);
    release(&all);
    if (fine)
        return Py_BuildValue("NNN", theta_out, positions_out, holds_out);
    Py_XDECREF(theta_out);
    Py_XDECREF(positions_out);
    Py_XDECREF(holds_out);
    return NULL;
}

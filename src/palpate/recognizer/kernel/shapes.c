/* Shapes of cells: convex polygons (k × v points, padded by repeating the first) and the boxes around them.

   Sums are taken in numpy's order, so that which of two equal cells is the larger does not depend on who added. */

#include "calls.h"
#include "shapes.h"

/* Sum as numpy adds up a row of fewer than 128. */
static double row_sum(const double *item, int64_t count)
{
    double sum = 0;
    int64_t k = 0;
    if (count >= 8) {
        double part[8];
        for (int j = 0; j < 8; j++)
            part[j] = item[j];
        for (k = 8; k + 8 <= count; k += 8)
            for (int j = 0; j < 8; j++)
                part[j] += item[k + j];
        sum = ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]));
    }
    for (; k < count; k++)
        sum += item[k];
    return sum;
}

shape shape_of(const point *p, Py_ssize_t vertices, double *term)
{
    point least = p[0], most = p[0];
    for (Py_ssize_t j = 0; j < vertices; j++) {
        const point *next = p + (j + 1 < vertices ? j + 1 : 0);
        least.x = smaller(least.x, p[j].x);
        least.y = smaller(least.y, p[j].y);
        most.x = larger(most.x, p[j].x);
        most.y = larger(most.y, p[j].y);
        term[j] = p[j].x * next->y - p[j].y * next->x;
    }
    shape found = {{(least.x + most.x) / 2, (least.y + most.y) / 2}, 0.0, fabs(row_sum(term, vertices)) / 2};
    double away = 0;
    for (Py_ssize_t j = 0; j < vertices; j++) {
        const double x = p[j].x - found.centre.x, y = p[j].y - found.centre.y;
        away = larger(away, x * x + y * y);
    }
    found.radius = sqrt(away);
    return found;
}

void furthest_of(const point *polygon, Py_ssize_t vertices, point origin, double lo, double hi, double most[4])
{
    const double c0 = cos(lo), s0 = sin(lo), c1 = cos(hi), s1 = sin(hi);
    const int wide = hi - lo >= PI;
    for (int axis = 0; axis < 4; axis++)
        most[axis] = -INFINITY;
    for (Py_ssize_t j = 0; j < vertices; j++) {
        const double x = polygon[j].x - origin.x, y = polygon[j].y - origin.y;
        const double a[4] = {x, y, -x, -y}, b[4] = {-y, x, y, -x};
        for (int axis = 0; axis < 4; axis++) {
            int crest = wide || (b[axis] * c0 > a[axis] * s0 && b[axis] * c1 < a[axis] * s1);
            double far = crest ? sqrt(x * x + y * y) : larger(a[axis] * c0 + b[axis] * s0, a[axis] * c1 + b[axis] * s1);
            most[axis] = larger(most[axis], far);
        }
    }
}

static double *filled(Py_ssize_t count, PyObject **bytes)
{
    *bytes = PyByteArray_FromStringAndSize(NULL, count * (Py_ssize_t)sizeof(double));
    return *bytes ? (double *)PyByteArray_AsString(*bytes) : NULL;
}

/* furthest(polygons, k, v, origins (k × 2), lo, hi): how far R(θ)(s − origin) gets along +x, +y, −x and −y (k × 4)
   for s in the polygon and θ in [lo, hi]; over half a turn and more the distance from the origin stands for it. */
PyObject *furthest(PyObject *self, PyObject *arguments)
{
    PyObject *polygon_in, *origin_in, *lo_in, *hi_in, *out = NULL;
    Py_ssize_t count, vertices;
    buffers all = {.count = 0};
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OnnOOO", &polygon_in, &count, &vertices, &origin_in, &lo_in, &hi_in))
        return NULL;
    const Py_ssize_t row = count * (Py_ssize_t)sizeof(double);
    const point *polygon = borrow(&all, polygon_in, vertices * count * (Py_ssize_t)sizeof(point)), *origin = NULL;
    const double *lo = NULL, *hi = NULL;
    int fine = polygon && (origin = borrow(&all, origin_in, 2 * row)) && (lo = borrow(&all, lo_in, row)) &&
               (hi = borrow(&all, hi_in, row));
    double *found = fine ? filled(4 * count, &out) : NULL;
    for (Py_ssize_t k = 0; found && k < count; k++)
        furthest_of(polygon + k * vertices, vertices, origin[k], lo[k], hi[k], found + 4 * k);
    release(&all);
    return out;
}

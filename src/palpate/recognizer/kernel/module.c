/* The module: buffers and lists that all parts use, and what Python may call. */

#include "kernel.h"
#include "calls.h"

const void *borrow(buffers *all, PyObject *object, Py_ssize_t bytes)
{
    if (all->count == MOST_BUFFERS) {
        PyErr_SetString(PyExc_SystemError, "too many arrays for one call");
        return NULL;
    }
    Py_buffer *view = &all->held[all->count];
    if (PyObject_GetBuffer(object, view, PyBUF_SIMPLE) < 0)
        return NULL;
    all->count++;
    if (view->len < bytes) {
        PyErr_Format(PyExc_ValueError, "an array has %zd bytes, fewer than %zd", view->len, bytes);
        return NULL;
    }
    static const double nothing = 0;
    return view->buf ? view->buf : &nothing;
}

const void *borrow_item(buffers *all, PyObject *tuple, Py_ssize_t index, Py_ssize_t *bytes)
{
    PyObject *item = PyTuple_Check(tuple) ? PyTuple_GetItem(tuple, index) : NULL;
    if (!item) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_TypeError, "a tuple of arrays is needed");
        return NULL;
    }
    const void *data = borrow(all, item, 0);
    if (data && bytes)
        *bytes = all->held[all->count - 1].len;
    return data;
}

void release(buffers *all)
{
    while (all->count)
        PyBuffer_Release(&all->held[--all->count]);
}

list new_list(size_t width)
{
    list items = {NULL, 0, 0, width};
    return items;
}

void *list_add(list *items)
{
    if (items->size == items->room) {
        size_t room = items->room ? 2 * items->room : 64;
        char *data = realloc(items->data, room * items->width);
        if (!data)
            return NULL;
        items->data = data;
        items->room = room;
    }
    return items->data + items->width * items->size++;
}

PyObject *list_bytes(list *items)
{
    PyObject *result = PyByteArray_FromStringAndSize(items->data ? items->data : "",
                                                     (Py_ssize_t)(items->size * items->width));
    free_list(items);
    return result;
}

void free_list(list *items)
{
    free(items->data);
    items->data = NULL;
    items->size = items->room = 0;
}

static PyMethodDef methods[] = {
    KERNEL_CALLS
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_kernel", "Compiled kernel of the recogniser.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModule_Create(&module); }

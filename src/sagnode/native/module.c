/* The module: checking and letting go of arrays, and the table of functions. */
#include "kernels.h"

int take(arrays *all, PyObject *object, const char *name, char kind, int axes, int contiguous, int written, array *out)
{
    if (all->count == MOST_ARRAYS) {
        PyErr_SetString(PyExc_SystemError, "too many arrays in one call");
        return -1;
    }
    Py_buffer *buffer = &all->buffers[all->count];
    int flags = PyBUF_STRIDES | PyBUF_FORMAT | (written ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, buffer, flags) < 0)
        return -1;
    all->count++;
    char own = buffer->format[0];
    /* long is 64 bits wide here, and so is long long */
    own = own == 'q' ? 'l' : own;
    if (buffer->format[1] != 0 || (kind != '*' && own != kind) || buffer->ndim != axes || axes > MOST_AXES) {
        PyErr_Format(PyExc_TypeError, "%s: wanted kind '%c' with %d axes, got '%s' with %d", name, kind, axes,
                     buffer->format, buffer->ndim);
        return -1;
    }
    out->at = buffer->buf;
    out->kind = own;
    out->axes = axes;
    Py_ssize_t step = buffer->itemsize;
    for (int k = axes - 1; k >= 0; k--) {
        out->shape[k] = buffer->shape[k];
        out->step[k] = buffer->strides[k];
        if (contiguous && buffer->shape[k] > 1 && buffer->strides[k] != step) {
            PyErr_Format(PyExc_TypeError, "%s: not contiguous", name);
            return -1;
        }
        step *= buffer->shape[k];
    }
    return 0;
}

void release(arrays *all)
{
    while (all->count > 0)
        PyBuffer_Release(&all->buffers[--all->count]);
}

int require(int condition, const char *what)
{
    if (condition)
        return 0;
    PyErr_SetString(PyExc_ValueError, what);
    return -1;
}

static PyMethodDef functions[] = {
    {"places", (PyCFunction)(void (*)(void))places, METH_FASTCALL, NULL},
    {"response", (PyCFunction)(void (*)(void))response, METH_FASTCALL, NULL},
    {"response_sums", (PyCFunction)(void (*)(void))response_sums, METH_FASTCALL, NULL},
    {"curve_pixels", (PyCFunction)(void (*)(void))curve_pixels, METH_FASTCALL, NULL},
    {"curve_visible", (PyCFunction)(void (*)(void))curve_visible, METH_FASTCALL, NULL},
    {"curve_track", (PyCFunction)(void (*)(void))curve_track, METH_FASTCALL, NULL},
    {"localise", (PyCFunction)(void (*)(void))localise, METH_FASTCALL, NULL},
    {"near_polyline", (PyCFunction)(void (*)(void))near_polyline, METH_FASTCALL, NULL},
    {"folds_back", (PyCFunction)(void (*)(void))folds_back, METH_FASTCALL, NULL},
    {"stand_out", (PyCFunction)(void (*)(void))stand_out, METH_FASTCALL, NULL},
    {"curve_points", (PyCFunction)(void (*)(void))curve_points, METH_FASTCALL, NULL},
    {"project", (PyCFunction)(void (*)(void))project, METH_FASTCALL, NULL},
    {"sight", (PyCFunction)(void (*)(void))sight, METH_FASTCALL, NULL},
    {"curve_terms", (PyCFunction)(void (*)(void))curve_terms, METH_FASTCALL, NULL},
    {"solve_camera", (PyCFunction)(void (*)(void))solve_camera, METH_FASTCALL, NULL},
    {"solve", (PyCFunction)(void (*)(void))solve, METH_FASTCALL, NULL},
    {"shared_products", (PyCFunction)(void (*)(void))shared_products, METH_FASTCALL, NULL},
    {"solve_each", (PyCFunction)(void (*)(void))solve_each, METH_FASTCALL, NULL},
    {"sum_explanations", (PyCFunction)(void (*)(void))sum_explanations, METH_FASTCALL, NULL},
    {"quantities", (PyCFunction)(void (*)(void))quantities, METH_FASTCALL, NULL},
    {"clearance_place_u", (PyCFunction)(void (*)(void))clearance_place_u, METH_FASTCALL, NULL},
    {NULL, NULL, 0, NULL},
};

/* Bump with every change of a function's arguments or meaning: see INTERFACE in __init__.py. */
#define INTERFACE 16

static int fill(PyObject *module) { return PyModule_AddIntConstant(module, "INTERFACE", INTERFACE); }

static PyModuleDef_Slot slots[] = {{Py_mod_exec, fill}, {0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernels", "Inner loops in C; see sagnode.native.", 0, functions, slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModuleDef_Init(&definition); }

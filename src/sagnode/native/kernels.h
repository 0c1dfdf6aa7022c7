/* What the kernels share: arrays as they come from Python, checked, and the picture they read. */
#ifndef SAGNODE_KERNELS_H
#define SAGNODE_KERNELS_H

#ifndef Py_LIMITED_API
#define Py_LIMITED_API 0x030B0000
#endif
#include <Python.h>
#include <stdint.h>

/* Compilers that can make one function for several x86 processors do so; the one that fits is chosen when loading. */
#if defined(__x86_64__) && defined(__GNUC__) && defined(__linux__) && !defined(__clang__)
#define FOR_EACH_PROCESSOR __attribute__((target_clones("avx2", "default")))
#else
#define FOR_EACH_PROCESSOR
#endif

#define MOST_ARRAYS 24
#define MOST_AXES 4

/* One array: its elements' kind, its axes, and the step of each in bytes (0 where it is broadcast). */
typedef struct {
    char *at;
    char kind; /* 'B' uint8, 'h' int16, 'i' int32, 'l' int64, 'f' single, 'd' double, '?' bool */
    int axes;
    Py_ssize_t shape[MOST_AXES];
    Py_ssize_t step[MOST_AXES];
} array;

/* The arrays of one call; they are let go together. */
typedef struct {
    int count;
    Py_buffer buffers[MOST_ARRAYS];
} arrays;

/* Take one array of a kind ('*' for any) and number of axes; 0 on success, else -1 with a Python error set.
   With contiguous set, its elements must follow each other without gaps; with written set, it must be writable. */
int take(arrays *all, PyObject *object, const char *name, char kind, int axes, int contiguous, int written, array *out);
/* Let all go. */
void release(arrays *all);
/* -1 with a Python error set where a condition on the shapes does not hold. */
int require(int condition, const char *what);

/* One element of an array of double precision. */
static inline double number(const array *of, Py_ssize_t i) { return *(const double *)(of->at + i * of->step[0]); }
static inline double number2(const array *of, Py_ssize_t i, Py_ssize_t j)
{
    return *(const double *)(of->at + i * of->step[0] + j * of->step[1]);
}

/* The functions of the module; their arguments are in _kernels.pyi. */
PyObject *response(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *places(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *response_sums(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *curve_pixels(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *curve_visible(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *curve_track(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *localise(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *near_polyline(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *folds_back(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *stand_out(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *curve_points(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *project(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *sight(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *curve_terms(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *solve_camera(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *solve(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *shared_products(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *solve_each(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *sum_explanations(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *quantities(PyObject *module, PyObject *const *words, Py_ssize_t count);
PyObject *clearance_place_u(PyObject *module, PyObject *const *words, Py_ssize_t count);

#endif

/* What offsets across a curve say of the unknowns: see sagnode.estimate.offsets. */
#ifndef SAGNODE_TERMS_H
#define SAGNODE_TERMS_H
#include "steps.h"

/* Camera and conductor as they are surveyed. */
typedef struct {
    camera at;
    double near[3], far[3];
    int free; /* how many of the unknowns are unknown: without terms of the load or with them */
} survey;

typedef struct {
    Py_ssize_t count;
    const double *t, *arc, *normal, *measured, *sigma, *shading;
    int lights; /* columns of shading */
} offsets;

/* The first arguments of curve_terms and solve: lens, rotation, position, near, far, theta, t, normal, measured. */
enum { ASKED = 9 };

/* Read them; where `written` is set, theta is to be. -1 with a Python error set. */
int take_offsets(arrays *all, PyObject *const *words, int written, survey *of, array *theta, offsets *seen);
/* How many are unknown, from an argument: all, or all but the terms of the load. */
int take_free(PyObject *object, int *out);
/* Residuals of the offsets and, if wanted, the curve's derivatives there (count, SIZE). */
void terms(const survey *of, const double *theta, const offsets *seen, double *residual, double *jacobian);

#endif

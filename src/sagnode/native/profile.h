/* Reading a picture along short straight lines. */
#ifndef SAGNODE_PROFILE_H
#define SAGNODE_PROFILE_H
#include "kernels.h"

/* A picture of bytes or of single precision; row is the step from line to line in pixels. */
typedef struct {
    const void *at;
    int single, row, width, height;
} scene;

/* Take a picture; 0 on success, else -1 with a Python error set. */
int take_scene(arrays *all, PyObject *object, scene *out);
/* Add the bilinear grey values at (u, v), (u + du, v + dv), ... to sums (count,). Any place may be anything. */
void add_samples(const scene *image, double u, double v, double du, double dv, int count, float *sums);

#endif

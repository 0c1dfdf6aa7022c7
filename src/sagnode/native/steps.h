/* What the estimates of the camera and of a conductor share: the unknowns, derivatives by them, and one step. */
#ifndef SAGNODE_STEPS_H
#define SAGNODE_STEPS_H

#include "geometry.h"

/* The unknowns, as sagnode.survey has them. */
enum { CAMERA = 10, NEAR = 10, FAR = 13, SAG = 16, SWING = 17, LOAD = 18, TERMS = 10, SIZE = LOAD + TERMS };

/* How a pixel moves with its place: in the camera's frame, and what of the lens that takes. */
typedef struct {
    double own[3], by_own[2][3];
    double x, y, xd, yd;
} movement;

/* The surveyed camera at theta (SIZE,). */
void camera_at(const camera *surveyed, const double *theta, camera *out);
movement moves(const camera *at, const double place[3]);
/* Derivatives of a pixel's coordinate along a direction: by its place (3,), and by the camera's unknowns (CAMERA,). */
void slopes(const camera *at, const movement *m, const double along[2], double by_place[3], double *by_camera);
/* Solution of a normal equation whose unknowns, at most SIZE, have very different sizes, and the inverse of its matrix;
   both are symmetric, in full, `width` wide. NaN where it has none. */
void solve_scaled(const double *matrix, const double *vector, int width, double *step, double *inverse);
/* Greatest part of a step in standard uncertainties. */
double length_of(const double *step, const double *covariance, int width);

static inline double least(double value, double bound) { return value < bound ? bound : value; }

#endif

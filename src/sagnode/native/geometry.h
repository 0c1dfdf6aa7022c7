/* A camera and a conductor, point by point: what sagnode.geometry.camera and sagnode.geometry.conductor do to arrays. */
#ifndef SAGNODE_GEOMETRY_H
#define SAGNODE_GEOMETRY_H

#include "kernels.h"
#include <math.h>

/* Numbers by which sagnode.geometry.camera.Intrinsics tells a lens, in the order of its `packed`. */
enum { FISHEYE, DISTORTED, WIDTH, HEIGHT, FX, FY, CX, CY, REACH, K1, LENS = K1 + 8 };

typedef struct {
    int fisheye, distorted;
    double width, height, fx, fy, cx, cy, reach2;
    double k[8];
    double rotation[9], position[3];
} camera;

/* A conductor that hangs: near + t chord + depth(t) down. */
typedef struct {
    double near[3], chord[3], down[3];
    double sag, half_angle, constant, start, rise_end;
    array load;
} conductor;

/* Normalised coordinates after the lens; OpenCV's models. */
static inline void distorted(const camera *lens, double x, double y, double *xd, double *yd)
{
    const double *k = lens->k;
    double r2 = x * x + y * y;
    if (lens->fisheye) {
        double r = sqrt(r2), theta = atan(r), t2 = theta * theta;
        double theta_d = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
        double scale = r > 1e-12 ? theta_d / r : 1.0;
        *xd = x * scale;
        *yd = y * scale;
        return;
    }
    double radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    if (k[5] != 0.0 || k[6] != 0.0 || k[7] != 0.0)
        radial = radial / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])));
    *xd = x * radial;
    *yd = y * radial;
    if (k[2] != 0.0 || k[3] != 0.0) {
        double xy = x * y;
        *xd += 2 * k[2] * xy + k[3] * (r2 + 2 * x * x);
        *yd += k[2] * (r2 + 2 * y * y) + 2 * k[3] * xy;
    }
}

/* A place of the site in the camera's frame. */
static inline void seen_from(const camera *at, const double place[3], double out[3])
{
    double x = place[0] - at->position[0], y = place[1] - at->position[1], z = place[2] - at->position[2];
    const double *r = at->rotation;
    for (int k = 0; k < 3; k++)
        out[k] = r[3 * k] * x + r[3 * k + 1] * y + r[3 * k + 2] * z;
}

/* Pixel of a place of the site, NaN where the camera cannot see it; returns its depth. */
static inline double pictured(const camera *at, const double place[3], double pixel[2])
{
    double own[3];
    seen_from(at, place, own);
    double x = own[0] / own[2], y = own[1] / own[2];
    if (!(own[2] > 1e-9) || (at->distorted && !(x * x + y * y <= at->reach2))) {
        pixel[0] = pixel[1] = NAN;
        return own[2];
    }
    if (at->distorted)
        distorted(at, x, y, &x, &y);
    pixel[0] = at->fx * x + at->cx;
    pixel[1] = at->fy * y + at->cy;
    return own[2];
}

/* The next Legendre polynomial after two others, P(n) = ((2n-1) x P(n-1) - (n-1) P(n-2)) / n. */
static inline double legendre(int n, double x, double one_below, double two_below)
{
    return ((2 * n - 1) * x * one_below - (n - 1) * two_below) / n;
}

/* What the first terms of an uneven load add to the depth over the sag, one after the other: P(k-2) to P(k+2). */
typedef struct {
    double x, p[5];
} shapes;

static inline shapes first_shape(double t)
{
    double x = 2 * t - 1;
    shapes of = {x, {0.0, 1.0, x, 0.0, 0.0}};
    of.p[3] = legendre(2, x, of.p[2], of.p[1]);
    of.p[4] = legendre(3, x, of.p[3], of.p[2]);
    return of;
}

/* The k-th of them, k = 1, 2, ... in turn. */
static inline double next_shape(shapes *of, int k)
{
    /* the second integral of P(1) has no term below it: what makes it vanish at both ends is x itself */
    double below = k > 1 ? of->p[0] / ((2.0 * k - 1) * (2 * k + 1)) : of->x / 3;
    double middle = of->p[2] / ((2.0 * k - 1) * (2 * k + 3)), above = of->p[4] / ((2.0 * k + 1) * (2 * k + 3));
    double value = -2 * above + 4 * middle - 2 * below;
    for (int n = 0; n < 4; n++)
        of->p[n] = of->p[n + 1];
    of->p[4] = legendre(k + 3, of->x, of->p[3], of->p[2]);
    return value;
}

/* What an uneven load adds to the depth, over the sag. */
static inline double uneven(const array *load, double t)
{
    double sum = 0.0;
    if (load->shape[0] == 0)
        return sum;
    shapes each = first_shape(t);
    for (int k = 1; k <= load->shape[0]; k++)
        sum += number(load, k - 1) * next_shape(&each, k);
    return sum;
}

/* Depth below the chord along apparent gravity without what an uneven load adds. */
static inline double even_depth(const conductor *of, double t)
{
    double grown = exp(of->half_angle * t), shrunk = 1 / grown;
    double here = 0.5 * (of->start * grown - shrunk / of->start) * (grown - shrunk);
    return of->constant * (t * of->rise_end - here);
}

static inline double depth_below(const conductor *of, double t)
{
    return even_depth(of, t) + of->sag * uneven(&of->load, t);
}

static inline void place_at(const conductor *of, double t, double place[3])
{
    double depth = depth_below(of, t);
    for (int k = 0; k < 3; k++)
        place[k] = of->near[k] + t * of->chord[k] + depth * of->down[k];
}

/* Straight down turned by a swing about a chord. */
void gravity(const double chord[3], double swing, double down[3]);
/* A conductor between two places; its load is left alone. */
void hang(conductor *of, const double near[3], const double far[3], double sag, double swing);
/* Read a camera from three arguments (lens, rotation, position). */
int take_camera(arrays *all, PyObject *const *words, camera *out);
/* Read a conductor from five arguments (near, far, sag, swing, load). */
int take_conductor(arrays *all, PyObject *const *words, conductor *out);
/* A number from an argument. */
int take_number(PyObject *object, double *out);

#endif

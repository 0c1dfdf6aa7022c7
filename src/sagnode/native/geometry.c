/* A camera and a conductor as they come from Python: see sagnode.geometry.camera and sagnode.geometry.conductor. */
#include "geometry.h"
#include "numbers.h"
#include <string.h>

enum { NEWTON_STEPS = 6 };
static const double SETTLED = 1e-6;

/* Half-angle of the catenary with this sag at mid-chord: Newton's method in its logarithm, from the parabola's. */
static double catenary_half_angle(double span, double rise, double sag)
{
    double slope2 = (rise / span) * (rise / span);
    double target = (sag < 1e-9 * span ? 1e-9 * span : sag) / span;
    double parabolic = 4 * target / sqrt(1 + slope2);
    double correction = 1 + parabolic * parabolic * (1.0 / 12 - slope2 / (6 * (1 + slope2)));
    double q = parabolic / (correction < 0.5 ? 0.5 : correction);
    for (int k = 0; k < NEWTON_STEPS; k++) {
        double own = sinh(q), half = sinh(0.5 * q), excess = 2 * half * half;
        double steep2 = slope2 * (q / own) * (q / own);
        double value = 0.5 * excess / q * sqrt(1 + steep2);
        double slope = q * own / excess - 1 + steep2 / (1 + steep2) * (1 - q * (1 + excess) / own);
        double step = clipped(log(target / value) / slope, -1.0, 1.0);
        q *= exp(step);
        if (!(fabs(step) > SETTLED))
            break;
    }
    return q;
}

void gravity(const double chord[3], double swing, double down[3])
{
    double length = sqrt(chord[0] * chord[0] + chord[1] * chord[1] + chord[2] * chord[2]);
    double x = chord[0] / length, y = chord[1] / length, z = chord[2] / length;
    double cosine = cos(swing), sine = sin(swing), along = (cosine - 1) * z;
    down[0] = along * x + sine * y;
    down[1] = along * y - sine * x;
    down[2] = along * z - cosine;
}

void hang(conductor *of, const double near[3], const double far[3], double sag, double swing)
{
    for (int k = 0; k < 3; k++) {
        of->near[k] = near[k];
        of->chord[k] = far[k] - near[k];
    }
    gravity(of->chord, swing, of->down);
    double span = hypot(of->chord[0], of->chord[1]), rise = of->chord[2];
    double q = catenary_half_angle(span, rise, sag), m = asinh(rise * q / (span * sinh(q)));
    of->sag = sag;
    of->half_angle = q;
    of->constant = span / (2 * q);
    of->start = exp(m - q);
    of->rise_end = 2 * sinh(m) * sinh(q);
}

int take_number(PyObject *object, double *out)
{
    *out = PyFloat_AsDouble(object);
    return *out == -1.0 && PyErr_Occurred() ? -1 : 0;
}

static int take_place(arrays *all, PyObject *object, const char *name, double out[3])
{
    array of;
    if (take(all, object, name, 'd', 1, 0, 0, &of) < 0 || require(of.shape[0] == 3, "a place has three coordinates") < 0)
        return -1;
    for (int k = 0; k < 3; k++)
        out[k] = number(&of, k);
    return 0;
}

int take_camera(arrays *all, PyObject *const *words, camera *out)
{
    array lens, rotation;
    if (take(all, words[0], "lens", 'd', 1, 1, 0, &lens) < 0 ||
        take(all, words[1], "rotation", 'd', 2, 0, 0, &rotation) < 0 ||
        take_place(all, words[2], "position", out->position) < 0 ||
        require(lens.shape[0] == LENS && rotation.shape[0] == 3 && rotation.shape[1] == 3,
                "lens or rotation of a wrong size") < 0)
        return -1;
    const double *own = (const double *)lens.at;
    out->fisheye = own[FISHEYE] != 0.0;
    out->distorted = own[DISTORTED] != 0.0;
    out->width = own[WIDTH];
    out->height = own[HEIGHT];
    out->fx = own[FX];
    out->fy = own[FY];
    out->cx = own[CX];
    out->cy = own[CY];
    out->reach2 = own[REACH] * own[REACH];
    memcpy(out->k, own + K1, sizeof out->k);
    for (int k = 0; k < 9; k++)
        out->rotation[k] = number2(&rotation, k / 3, k % 3);
    return 0;
}

int take_conductor(arrays *all, PyObject *const *words, conductor *out)
{
    double near[3], far[3], sag, swing;
    if (take_place(all, words[0], "near", near) < 0 || take_place(all, words[1], "far", far) < 0 ||
        take_number(words[2], &sag) < 0 || take_number(words[3], &swing) < 0 ||
        take(all, words[4], "load", 'd', 1, 0, 0, &out->load) < 0 ||
        require(out->load.shape[0] <= 1000, "too many terms of a load") < 0)
        return -1;
    hang(out, near, far, sag, swing);
    return 0;
}

/* What offsets across a curve say of the unknowns, their residuals and derivatives: see sagnode.estimate.offsets, which
   says what it means and does the same in NumPy. */
#include "terms.h"
#include "numbers.h"
#include <string.h>

static void conductor_at(const survey *of, const double *theta, conductor *out)
{
    double near[3], far[3];
    for (int k = 0; k < 3; k++) {
        near[k] = of->near[k] + theta[NEAR + k];
        far[k] = of->far[k] + theta[FAR + k];
    }
    memset(&out->load, 0, sizeof out->load);
    out->load.at = (char *)(theta + LOAD);
    out->load.shape[0] = of->free > LOAD ? TERMS : 0;
    out->load.step[0] = sizeof *theta;
    hang(out, near, far, theta[SAG], theta[SWING]);
}

/* How a conductor's direction of gravity turns with its chord, and where its points go when it swings. */
static void turning(const conductor *of, double swing, double turn[9], double aside[3])
{
    const double *c = of->chord;
    double length = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]), unit[3], raw[9], project[9];
    double cosine = cos(swing) - 1, sine = sin(swing), along = 0.0;
    for (int k = 0; k < 3; k++)
        unit[k] = c[k] / length;
    for (int k = 0; k < 9; k++) {
        int i = k / 3, j = k % 3;
        double same = i == j ? 1.0 : 0.0, down = j == 2 ? -1.0 : 0.0;
        raw[k] = cosine * (unit[2] * same - unit[i] * down);
        project[k] = (same - unit[i] * unit[j]) / length;
    }
    raw[1] += sine;
    raw[3] -= sine;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            turn[3 * i + j] =
                raw[3 * i] * project[j] + raw[3 * i + 1] * project[3 + j] + raw[3 * i + 2] * project[6 + j];
    gravity(c, swing + 0.5 * PI, aside);
    for (int k = 0; k < 3; k++)
        along += aside[k] * unit[k];
    for (int k = 0; k < 3; k++)
        aside[k] -= along * unit[k];
}

static double across(const offsets *seen, Py_ssize_t k, const double pixel[2])
{
    const double *measured = seen->measured + 2 * k, *normal = seen->normal + 2 * k;
    return (measured[0] - pixel[0]) * normal[0] + (measured[1] - pixel[1]) * normal[1];
}

void terms(const survey *of, const double *theta, const offsets *seen, double *residual, double *jacobian)
{
    camera at;
    conductor wire;
    double turn[9], aside[3];
    camera_at(&of->at, theta, &at);
    conductor_at(of, theta, &wire);
    turning(&wire, theta[SWING], turn, aside);
    for (Py_ssize_t n = 0; n < seen->count; n++) {
        double t = seen->t[n], place[3], pixel[2], by_place[3], turned[3], down = 0.0, swung = 0.0;
        double even = even_depth(&wire, t), depth = even + wire.sag * uneven(&wire.load, t);
        for (int k = 0; k < 3; k++)
            place[k] = wire.near[k] + t * wire.chord[k] + depth * wire.down[k];
        pictured(&at, place, pixel);
        residual[n] = across(seen, n, pixel);
        if (jacobian == NULL)
            continue;
        double *row = jacobian + n * SIZE, departure = even - wire.sag * 4 * t * (1 - t);
        movement m = moves(&at, place);
        slopes(&at, &m, seen->normal + 2 * n, by_place, row);
        for (int k = 0; k < 3; k++) {
            turned[k] = depth * (by_place[0] * turn[k] + by_place[1] * turn[3 + k] + by_place[2] * turn[6 + k]);
            row[NEAR + k] = (1 - t) * by_place[k] - turned[k];
            row[FAR + k] = t * by_place[k] + turned[k];
            down += by_place[k] * wire.down[k];
            swung += by_place[k] * aside[k];
        }
        row[SAG] = (depth + 2 * departure) / wire.sag * down;
        row[SWING] = depth * swung;
        shapes each = first_shape(t);
        for (int k = 0; k < TERMS; k++)
            row[LOAD + k] = wire.sag * down * next_shape(&each, k + 1);
    }
}

int take_offsets(arrays *all, PyObject *const *words, int written, survey *of, array *theta, offsets *seen)
{
    array near, far, t, normal, measured;
    if (take_camera(all, words, &of->at) < 0 || take(all, words[3], "near", 'd', 1, 0, 0, &near) < 0 ||
        take(all, words[4], "far", 'd', 1, 0, 0, &far) < 0 ||
        take(all, words[5], "theta", 'd', 1, 1, written, theta) < 0 || take(all, words[6], "t", 'd', 1, 1, 0, &t) < 0 ||
        take(all, words[7], "normal", 'd', 2, 1, 0, &normal) < 0 ||
        take(all, words[8], "measured", 'd', 2, 1, 0, &measured) < 0 ||
        require(near.shape[0] == 3 && far.shape[0] == 3 && theta->shape[0] == SIZE,
                "near, far or theta of a wrong size") < 0 ||
        require(normal.shape[0] == t.shape[0] && normal.shape[1] == 2 && measured.shape[0] == t.shape[0] &&
                    measured.shape[1] == 2,
                "normal and measured do not fit t") < 0)
        return -1;
    for (int k = 0; k < 3; k++) {
        of->near[k] = number(&near, k);
        of->far[k] = number(&far, k);
    }
    *seen = (offsets){.count = t.shape[0], .t = (const double *)t.at, .normal = (const double *)normal.at,
                      .measured = (const double *)measured.at};
    return 0;
}

int take_free(PyObject *object, int *out)
{
    long free = PyLong_AsLong(object);
    if (free == -1 && PyErr_Occurred())
        return -1;
    *out = (int)free;
    return require(free == SIZE || free == LOAD, "free must be 18 or 28");
}

PyObject *curve_terms(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    survey of;
    offsets seen;
    array theta, residual, jacobian;
    (void)module;
    if (require(count == ASKED + 3, "curve_terms takes twelve arguments") < 0)
        return NULL;
    if (take_offsets(&all, words, 0, &of, &theta, &seen) < 0 || take_free(words[ASKED], &of.free) < 0 ||
        take(&all, words[ASKED + 1], "residual", 'd', 1, 1, 1, &residual) < 0 ||
        take(&all, words[ASKED + 2], "jacobian", 'd', 2, 1, 1, &jacobian) < 0 ||
        require(residual.shape[0] == seen.count && jacobian.shape[0] == seen.count && jacobian.shape[1] == SIZE,
                "residual and jacobian do not fit t") < 0) {
        release(&all);
        return NULL;
    }
    terms(&of, (const double *)theta.at, &seen, (double *)residual.at, (double *)jacobian.at);
    release(&all);
    Py_RETURN_NONE;
}

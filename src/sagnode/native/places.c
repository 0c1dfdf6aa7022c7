/* Where the samples of many curves of one conductor are in the picture: see sagnode.match.library.places_of and
   sagnode.match.family, which do the same in NumPy. Single precision: a picture needs no more. */
#include "kernels.h"
#include <math.h>

enum { CHUNK = 64 };

#define NEAREST_M 1e-3f
#define OUTSIDE_PX -1e4f
#define LEAST_SQUARE 1e-9f

/* Of sagnode.match.bundle and sagnode.match.library. */
#define SIDE_OFFSET_PX 2.5f
#define CLEAR_PX 1.5f
#define SHORTER_SIDE 0.3f
#define LEAST_STEP_PX 0.5f

/* What of Intrinsics.packed is needed here. */
typedef struct {
    float fx, fy, cx, cy, reach;
    int model;
    float k[8];
} lens;

static int lens_from(const array *of, lens *out)
{
    const double *from = (const double *)of->at;
    if (require(of->shape[0] == 17, "lens: seventeen numbers are wanted") < 0)
        return -1;
    int model = from[1] == 0.0 ? 0 : from[0] != 0.0 ? 2 : 1;
    *out = (lens){(float)from[4], (float)from[5], (float)from[6], (float)from[7], (float)from[8], model, {0}};
    for (int i = 0; i < 8; i++)
        out->k[i] = (float)from[9 + i];
    return 0;
}

static inline void through(const lens *by, float *x, float *y)
{
    const float *k = by->k;
    float r2 = *x * *x + *y * *y;
    if (by->model == 2) {
        float r = sqrtf(r2), theta = atanf(r), t2 = theta * theta;
        float bent = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
        float scale = r > 1e-12f ? bent / r : 1.0f;
        *x *= scale;
        *y *= scale;
        return;
    }
    float radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])));
    float xy = *x * *y;
    float bent_x = *x * radial + 2 * k[2] * xy + k[3] * (r2 + 2 * *x * *x);
    float bent_y = *y * radial + k[2] * (r2 + 2 * *y * *y) + 2 * k[3] * xy;
    *x = bent_x;
    *y = bent_y;
}

/* One sample of a chunk of curves: pixels and depth. */
FOR_EACH_PROCESSOR
static void project_sample(const lens *by, const float *chord, float slope, float bend, const float *turn,
                           const float *sag, const float *cosine, const float *sine, int count, float *u, float *v,
                           float *depth)
{
    for (int k = 0; k < count; k++) {
        float profile = sag[k] * (slope + bend * (sag[k] * sag[k]));
        float x = chord[0] + profile * (turn[0] + turn[3] * cosine[k] + turn[6] * sine[k]);
        float y = chord[1] + profile * (turn[1] + turn[4] * cosine[k] + turn[7] * sine[k]);
        float z = chord[2] + profile * (turn[2] + turn[5] * cosine[k] + turn[8] * sine[k]);
        int ahead = z > NEAREST_M;
        z = ahead ? z : 1.0f;
        u[k] = x / z;
        v[k] = y / z;
        depth[k] = ahead ? z : -1.0f;
    }
    if (by->model != 0)
        for (int k = 0; k < count; k++) {
            int within = u[k] * u[k] + v[k] * v[k] <= by->reach * by->reach;
            depth[k] = within ? depth[k] : -fabsf(depth[k]);
        }
    if (by->model == 2)
        for (int k = 0; k < count; k++)
            through(by, u + k, v + k);
    if (by->model == 1)
        for (int k = 0; k < count; k++)
            through(by, u + k, v + k);
    for (int k = 0; k < count; k++) {
        u[k] = depth[k] > 0 ? by->fx * u[k] + by->cx : OUTSIDE_PX;
        v[k] = depth[k] > 0 ? by->fy * v[k] + by->cy : OUTSIDE_PX;
        depth[k] = fabsf(depth[k]);
    }
}

/* Unit normals of a chunk from the pixels of a neighbour on either side. */
FOR_EACH_PROCESSOR
static void turn_aside(const float *u0, const float *u1, const float *v0, const float *v1, int count, float *nu,
                       float *nv)
{
    for (int k = 0; k < count; k++) {
        float du = u1[k] - u0[k], dv = v1[k] - v0[k];
        float square = du * du + dv * dv;
        float shorten = 1.0f / sqrtf(square > LEAST_SQUARE ? square : LEAST_SQUARE);
        nu[k] = -dv * shorten;
        nv[k] = du * shorten;
    }
}

/* Distance of a thin line's sides in the place of the depths of a chunk, by the projected width of one wire at one metre;
   a whole number of steps where the places of a band share them. */
FOR_EACH_PROCESSOR
static void beside(float width, float step, int count, float *side)
{
    for (int k = 0; k < count; k++) {
        float outside = 0.5f * (width / side[k]) + CLEAR_PX;
        side[k] = outside > SIDE_OFFSET_PX ? outside : SIDE_OFFSET_PX;
    }
    if (step >= LEAST_STEP_PX)
        for (int k = 0; k < count; k++) {
            float steps = ceilf(side[k] / step - SHORTER_SIDE);
            side[k] = step * (steps > 1.0f ? steps : 1.0f);
        }
}

PyObject *places(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    array chord, slope, bend, turn, glass, sag, cosine, sine, step, out[5];
    lens by;
    static const char *const names[] = {"u", "v", "nu", "nv", "side"};
    (void)module;
    if (require(count == 16, "places takes sixteen arguments") < 0)
        return NULL;
    Py_ssize_t first = PyLong_AsSsize_t(words[8]);
    float width = (float)PyFloat_AsDouble(words[9]);
    if (PyErr_Occurred())
        return NULL;
    int failed = take(&all, words[0], "chord", 'f', 2, 1, 0, &chord) < 0 ||
                 take(&all, words[1], "slope", 'f', 1, 1, 0, &slope) < 0 ||
                 take(&all, words[2], "bend", 'f', 1, 1, 0, &bend) < 0 ||
                 take(&all, words[3], "turn", 'f', 2, 1, 0, &turn) < 0 ||
                 take(&all, words[4], "lens", 'd', 1, 1, 0, &glass) < 0 ||
                 take(&all, words[5], "sag", 'f', 1, 1, 0, &sag) < 0 ||
                 take(&all, words[6], "cosine", 'f', 1, 1, 0, &cosine) < 0 ||
                 take(&all, words[7], "sine", 'f', 1, 1, 0, &sine) < 0 ||
                 take(&all, words[10], "step", 'f', 1, 1, 0, &step) < 0;
    for (int k = 0; k < 5 && !failed; k++)
        failed = take(&all, words[11 + k], names[k], 'f', 2, 1, 1, &out[k]) < 0;
    if (!failed) {
        Py_ssize_t samples = slope.shape[0], curves = sag.shape[0], rows = out[0].shape[0];
        int fits = bend.shape[0] == samples && chord.shape[0] == samples && chord.shape[1] == 3 && turn.shape[0] == 3 &&
                   turn.shape[1] == 3 && cosine.shape[0] == curves && sine.shape[0] == curves && rows > 0 &&
                   first >= 0 && first <= samples - rows && samples > 1 && step.shape[0] == rows;
        for (int k = 0; k < 5; k++)
            fits = fits && out[k].shape[0] == rows && out[k].shape[1] == curves;
        failed = require(fits, "places: shapes do not fit each other") < 0 || lens_from(&glass, &by) < 0;
    }
    if (failed) {
        release(&all);
        return NULL;
    }
    Py_ssize_t samples = slope.shape[0], curves = sag.shape[0], rows = out[0].shape[0];
    /* a neighbour on either side gives the ends their tangents; those that no other stretch asks for are not kept */
    float scratch[3 * CHUNK], edge[4 * CHUNK], *out_u = (float *)out[0].at, *out_v = (float *)out[1].at;
    for (Py_ssize_t start = 0; start < curves; start += CHUNK) {
        int some = (int)(curves - start < CHUNK ? curves - start : CHUNK);
        for (Py_ssize_t i = first > 0 ? -1 : 0; i < rows + (first + rows < samples); i++) {
            Py_ssize_t at = i * curves + start, own = first + i;
            int kept = i >= 0 && i < rows;
            float *u = kept ? out_u + at : edge + (i < 0 ? 0 : 2 * CHUNK), *v = kept ? out_v + at : u + CHUNK;
            project_sample(&by, (const float *)chord.at + 3 * own, ((const float *)slope.at)[own],
                           ((const float *)bend.at)[own], (const float *)turn.at, (const float *)sag.at + start,
                           (const float *)cosine.at + start, (const float *)sine.at + start, some, u, v,
                           kept ? (float *)out[4].at + at : scratch);
        }
        for (Py_ssize_t i = 0; i < rows; i++) {
            Py_ssize_t to = i * curves + start;
            const float *u0 = i > 0 ? out_u + to - curves : first > 0 ? edge : out_u + to;
            const float *v0 = i > 0 ? out_v + to - curves : first > 0 ? edge + CHUNK : out_v + to;
            int last = i == rows - 1, beyond = first + rows < samples;
            const float *u1 = !last ? out_u + to + curves : beyond ? edge + 2 * CHUNK : out_u + to;
            const float *v1 = !last ? out_v + to + curves : beyond ? edge + 3 * CHUNK : out_v + to;
            if (width > 0)
                beside(width, ((const float *)step.at)[i], some, (float *)out[4].at + to);
            turn_aside(u0, u1, v0, v1, some, (float *)out[2].at + to, (float *)out[3].at + to);
        }
    }
    release(&all);
    Py_RETURN_NONE;
}

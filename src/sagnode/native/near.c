/* Where other wires, or another stretch of the same one, run beside a curve: see sagnode.match.masks, which says what it
   means and does the same in NumPy. */
#include "kernels.h"
#include <math.h>

enum { GROUP = 32 };
#define ALONG_PX 12.0
#define APART_PX 6.0

typedef struct {
    double u, v;
} point;

/* Some neighbouring points of a polyline, and the box about them. */
typedef struct {
    double left, right, top, bottom;
    int count;
    double u[GROUP], v[GROUP];
} group;

static inline double at(const array *of, Py_ssize_t i, Py_ssize_t j)
{
    return *(const double *)(of->at + i * of->step[0] + j * of->step[1]);
}

static inline double one(const array *of, Py_ssize_t i) { return *(const double *)(of->at + i * of->step[0]); }

/* The finite points of a polyline, every few pixels, in groups; -1 with a Python error set. */
static Py_ssize_t grouped(const array *polyline, group **out)
{
    Py_ssize_t count = polyline->shape[0], finite = 0, kept = 0;
    point *points = PyMem_Malloc((size_t)(count + 1) * sizeof *points);
    if (points == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    double widest = 0.0;
    for (Py_ssize_t k = 0; k < count; k++) {
        point here = {at(polyline, k, 0), at(polyline, k, 1)};
        if (!isfinite(here.u) || !isfinite(here.v))
            continue;
        if (finite > 0) {
            double du = here.u - points[finite - 1].u, dv = here.v - points[finite - 1].v, step = du * du + dv * dv;
            widest = step > widest ? step : widest;
        }
        points[finite++] = here;
    }
    /* a point every few pixels is enough, since some are looked along */
    double spacing = sqrt(widest);
    int every = (int)(APART_PX / (spacing > 1e-3 ? spacing : 1e-3));
    every = every > 1 ? every : 1;
    Py_ssize_t groups = (finite + (Py_ssize_t)every * GROUP - 1) / ((Py_ssize_t)every * GROUP);
    *out = PyMem_Malloc((size_t)(groups + 1) * sizeof **out);
    if (*out == NULL) {
        PyMem_Free(points);
        PyErr_NoMemory();
        return -1;
    }
    for (Py_ssize_t k = 0; k < finite; k += every, kept++) {
        group *own = *out + kept / GROUP;
        double u = points[k].u, v = points[k].v;
        if (kept % GROUP == 0)
            *own = (group){u, u, v, v, 0, {0}, {0}};
        own->left = u < own->left ? u : own->left;
        own->right = u > own->right ? u : own->right;
        own->top = v < own->top ? v : own->top;
        own->bottom = v > own->bottom ? v : own->bottom;
        own->u[own->count] = u;
        own->v[own->count++] = v;
    }
    PyMem_Free(points);
    return groups;
}

/* Whether any point of a group lies within reach across a curve, and some pixels along it. */
static int meets(const group *some, double u, double v, double nu, double nv, double reach)
{
    /* no point of a box that is farther off than both together */
    double far = reach + ALONG_PX;
    if (u < some->left - far || u > some->right + far || v < some->top - far || v > some->bottom + far)
        return 0;
    int any = 0;
    for (int k = 0; k < some->count; k++) {
        double du = some->u[k] - u, dv = some->v[k] - v;
        any |= (fabs(du * nu + dv * nv) < reach) & (fabs(du * nv - dv * nu) < ALONG_PX);
    }
    return any;
}

PyObject *near_polyline(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    array pixels, normal, reach, other, masked;
    group *groups = NULL;
    (void)module;
    if (require(count == 5, "near_polyline takes five arguments") < 0)
        return NULL;
    if (take(&all, words[0], "pixels", 'd', 2, 0, 0, &pixels) < 0 ||
        take(&all, words[1], "normal", 'd', 2, 0, 0, &normal) < 0 ||
        take(&all, words[2], "reach", 'd', 1, 0, 0, &reach) < 0 ||
        take(&all, words[3], "other", 'd', 2, 0, 0, &other) < 0 ||
        take(&all, words[4], "masked", '?', 1, 1, 1, &masked) < 0 ||
        require(pixels.shape[1] == 2 && normal.shape[1] == 2 && other.shape[1] == 2 &&
                    normal.shape[0] == pixels.shape[0] && reach.shape[0] == pixels.shape[0] &&
                    masked.shape[0] == pixels.shape[0],
                "pixels, normal, reach and masked differ in length") < 0) {
        release(&all);
        return NULL;
    }
    Py_ssize_t some = grouped(&other, &groups);
    for (Py_ssize_t i = 0; some > 0 && i < pixels.shape[0]; i++) {
        uint8_t *found = (uint8_t *)masked.at + i;
        double u = at(&pixels, i, 0), v = at(&pixels, i, 1), nu = at(&normal, i, 0), nv = at(&normal, i, 1);
        for (Py_ssize_t k = 0; k < some && !*found; k++)
            *found = (uint8_t)meets(groups + k, u, v, nu, nv, one(&reach, i));
    }
    PyMem_Free(groups);
    release(&all);
    if (some < 0)
        return NULL;
    Py_RETURN_NONE;
}

PyObject *folds_back(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    array pixels, normal, arc, index, reach, masked;
    (void)module;
    if (require(count == 7, "folds_back takes seven arguments") < 0)
        return NULL;
    long long every = PyLong_AsLongLong(words[5]);
    if (every == -1 && PyErr_Occurred())
        return NULL;
    if (take(&all, words[0], "pixels", 'd', 2, 0, 0, &pixels) < 0 ||
        take(&all, words[1], "normal", 'd', 2, 0, 0, &normal) < 0 ||
        take(&all, words[2], "arc", 'd', 1, 0, 0, &arc) < 0 ||
        take(&all, words[3], "index", 'l', 1, 1, 0, &index) < 0 ||
        take(&all, words[4], "reach", 'd', 1, 0, 0, &reach) < 0 ||
        take(&all, words[6], "masked", '?', 1, 1, 1, &masked) < 0 ||
        require(pixels.shape[1] == 2 && normal.shape[1] == 2 && normal.shape[0] == pixels.shape[0] &&
                    arc.shape[0] == pixels.shape[0] && index.shape[0] == reach.shape[0] &&
                    masked.shape[0] == reach.shape[0] && every > 0,
                "pixels, normal and arc, or index, reach and masked, differ in length") < 0) {
        release(&all);
        return NULL;
    }
    for (Py_ssize_t i = 0; i < index.shape[0]; i++) {
        Py_ssize_t own = ((const int64_t *)index.at)[i];
        if (require(own >= 0 && own < pixels.shape[0], "index: out of range") < 0) {
            release(&all);
            return NULL;
        }
        double u = at(&pixels, own, 0), v = at(&pixels, own, 1), nu = at(&normal, own, 0), nv = at(&normal, own, 1);
        double near = one(&reach, i), far = (near + ALONG_PX) * (near + ALONG_PX), from = one(&arc, own);
        int found = 0;
        for (Py_ssize_t k = 0; k < pixels.shape[0] && !found; k += every) {
            double du = at(&pixels, k, 0) - u, dv = at(&pixels, k, 1) - v, away = fabs(one(&arc, k) - from);
            if (!(away > near && du * du + dv * dv < far && fabs(du * nu + dv * nv) < near))
                continue;
            /* half a circle of that radius, or a turn of 60 degrees, is no neighbourhood any more */
            int turned = at(&normal, k, 0) * nu + at(&normal, k, 1) * nv < 0.5;
            found = away > 2.0 * Py_MATH_PI * near || turned;
        }
        ((uint8_t *)masked.at)[i] |= (uint8_t)found;
    }
    release(&all);
    Py_RETURN_NONE;
}

/* A conductor in the picture: its pixels, the part of it that is in the frame, and a track of samples along that. See
   sagnode.match.templates and sagnode.match.track.trace, which say what they mean and do the same in NumPy. */
#include "geometry.h"
#include "numbers.h"
#include <string.h>

enum { CAMERA_WORDS = 3, CONDUCTOR_WORDS = 5, VIEW_WORDS = CAMERA_WORDS + CONDUCTOR_WORDS };

/* What every function here is asked with first. */
typedef struct {
    camera at;
    conductor of;
} view;

static int take_view(arrays *all, PyObject *const *words, view *out)
{
    return take_camera(all, words, &out->at) < 0 || take_conductor(all, words + CAMERA_WORDS, &out->of) < 0 ? -1 : 0;
}

static inline double seen(const view *as, double t, double pixel[2])
{
    double place[3];
    place_at(&as->of, t, place);
    return pictured(&as->at, place, pixel);
}

PyObject *curve_pixels(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    view as;
    array t, pixels, depth;
    (void)module;
    if (require(count == VIEW_WORDS + 3, "curve_pixels takes eleven arguments") < 0)
        return NULL;
    words += VIEW_WORDS;
    if (take_view(&all, words - VIEW_WORDS, &as) < 0 || take(&all, words[0], "t", 'd', 1, 0, 0, &t) < 0 ||
        take(&all, words[1], "pixels", 'd', 2, 1, 1, &pixels) < 0 ||
        take(&all, words[2], "depth", 'd', 1, 1, 1, &depth) < 0 ||
        require(pixels.shape[0] == t.shape[0] && pixels.shape[1] == 2 && depth.shape[0] == t.shape[0],
                "pixels and depth do not fit t") < 0) {
        release(&all);
        return NULL;
    }
    for (Py_ssize_t k = 0; k < t.shape[0]; k++)
        ((double *)depth.at)[k] = seen(&as, number(&t, k), (double *)pixels.at + 2 * k);
    release(&all);
    Py_RETURN_NONE;
}

PyObject *curve_points(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    conductor of;
    array t, points;
    (void)module;
    if (require(count == CONDUCTOR_WORDS + 2, "curve_points takes seven arguments") < 0)
        return NULL;
    words += CONDUCTOR_WORDS;
    if (take_conductor(&all, words - CONDUCTOR_WORDS, &of) < 0 || take(&all, words[0], "t", 'd', 1, 0, 0, &t) < 0 ||
        take(&all, words[1], "points", 'd', 2, 1, 1, &points) < 0 ||
        require(points.shape[0] == t.shape[0] && points.shape[1] == 3, "points do not fit t") < 0) {
        release(&all);
        return NULL;
    }
    for (Py_ssize_t k = 0; k < t.shape[0]; k++)
        place_at(&of, number(&t, k), (double *)points.at + 3 * k);
    release(&all);
    Py_RETURN_NONE;
}

PyObject *project(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    camera at;
    array points, pixels, depth;
    (void)module;
    if (require(count == CAMERA_WORDS + 3, "project takes six arguments") < 0)
        return NULL;
    words += CAMERA_WORDS;
    if (take_camera(&all, words - CAMERA_WORDS, &at) < 0 ||
        take(&all, words[0], "points", 'd', 2, 1, 0, &points) < 0 ||
        take(&all, words[1], "pixels", 'd', 2, 1, 1, &pixels) < 0 ||
        take(&all, words[2], "depth", 'd', 1, 1, 1, &depth) < 0 ||
        require(points.shape[1] == 3 && pixels.shape[0] == points.shape[0] && pixels.shape[1] == 2 &&
                    depth.shape[0] == points.shape[0],
                "pixels and depth do not fit points") < 0) {
        release(&all);
        return NULL;
    }
    for (Py_ssize_t k = 0; k < points.shape[0]; k++)
        ((double *)depth.at)[k] = pictured(&at, (const double *)points.at + 3 * k, (double *)pixels.at + 2 * k);
    release(&all);
    Py_RETURN_NONE;
}

/* The next of the parameters at which a curve is followed: even along the span, and even in 1/depth. */
typedef struct {
    int count, even, inverse, uneven;
    double near, far, first, last, latest;
} nodes;

/* The k-th of `count` numbers from first to last. */
static inline double between(double first, double last, int k, int count)
{
    return k == count - 1 ? last : first + k * ((last - first) / (count - 1));
}

static nodes first_node(const view *as, int count, double share)
{
    double near[3], far[3], end[3];
    for (int k = 0; k < 3; k++)
        end[k] = as->of.near[k] + as->of.chord[k];
    seen_from(&as->at, as->of.near, near);
    seen_from(&as->at, end, far);
    double most = near[2] > far[2] ? near[2] : far[2], least = near[2] > far[2] ? far[2] : near[2];
    double nearest = share * most;
    nodes each = {count, 0, 0, !(nearest <= 0 || least > 0.5 * most), near[2], far[2], 0.0, 0.0, -1.0};
    each.first = 1 / (near[2] < nearest ? nearest : near[2]);
    each.last = 1 / (far[2] < nearest ? nearest : far[2]);
    return each;
}

/* Rising parameters, no two alike; negative at the end. */
static double next_node(nodes *each)
{
    for (;;) {
        double even = 2.0, inverse = 2.0;
        if (each->even < each->count)
            even = between(0.0, 1.0, each->even, each->count);
        if (each->uneven && each->inverse < each->count) {
            double depth = 1 / between(each->first, each->last, each->inverse, each->count);
            inverse = clipped((depth - each->near) / (each->far - each->near), 0.0, 1.0);
        }
        /* a comparison with NaN is false: such a one is passed over */
        int take_inverse = !(inverse >= even);
        double next = take_inverse ? inverse : even;
        if (next == 2.0)
            return -1.0;
        each->inverse += take_inverse;
        each->even += !take_inverse;
        if (next > each->latest) {
            each->latest = next;
            return next;
        }
    }
}

/* Which part of the step from one pixel to the next is in the frame (Liang and Barsky), as shares of it. */
static int in_frame(const camera *at, double margin, const double from[2], const double to[2], double part[2])
{
    const double corner[2] = {at->width - 1.0 - margin, at->height - 1.0 - margin};
    part[0] = -INFINITY;
    part[1] = INFINITY;
    for (int k = 0; k < 2; k++) {
        double step = to[k] - from[k], slope = fabs(step) < 1e-9 ? 1e-9 : step;
        double a = (margin - from[k]) / slope, b = (corner[k] - from[k]) / slope;
        if (isnan(step))
            return 0;
        double enter = a < b ? a : b, leave = a < b ? b : a;
        part[0] = enter > part[0] ? enter : part[0];
        part[1] = leave < part[1] ? leave : part[1];
    }
    part[0] = clipped(part[0], 0.0, 1.0);
    part[1] = clipped(part[1], 0.0, 1.0);
    return 1;
}

PyObject *curve_visible(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    view as;
    array arc, t;
    double margin, wanted, share;
    (void)module;
    if (require(count == VIEW_WORDS + 5, "curve_visible takes thirteen arguments") < 0)
        return NULL;
    words += VIEW_WORDS;
    if (take_view(&all, words - VIEW_WORDS, &as) < 0 || take_number(words[0], &margin) < 0 ||
        take_number(words[1], &wanted) < 0 || take_number(words[2], &share) < 0 ||
        take(&all, words[3], "arc", 'd', 1, 1, 1, &arc) < 0 || take(&all, words[4], "t", 'd', 1, 1, 1, &t) < 0 ||
        require(wanted >= 2 && wanted <= 100000 && arc.shape[0] >= 4 * wanted && t.shape[0] >= 4 * wanted,
                "arc and t have too little room") < 0) {
        release(&all);
        return NULL;
    }
    double *along = (double *)arc.at, *at = (double *)t.at;
    nodes each = first_node(&as, (int)wanted, share);
    double from[2], to[2], part[2], length = 0.0, start = next_node(&each);
    Py_ssize_t found = 0;
    seen(&as, start, from);
    for (double end; (end = next_node(&each)) >= 0.0; start = end) {
        seen(&as, end, to);
        if (in_frame(&as.at, margin, from, to, part)) {
            double u = to[0] - from[0], v = to[1] - from[1], stretch = (part[1] - part[0]) * sqrt(u * u + v * v);
            if (stretch > 0) {
                along[found] = length;
                along[found + 1] = length += stretch;
                at[found] = start + part[0] * (end - start);
                at[found + 1] = start + part[1] * (end - start);
                found += 2;
            }
        }
        memcpy(from, to, sizeof from);
    }
    release(&all);
    return PyLong_FromSsize_t(found);
}

/* The unit normal to a step. */
static inline void across(double along, double down, double *normal)
{
    double shorten = 1 / sqrt(along * along + down * down);
    normal[0] = down * -shorten;
    normal[1] = along * shorten;
}

/* Unit normals of a polyline by central differences, and the length along it. */
FOR_EACH_PROCESSOR
static void measure(const double *pixels, Py_ssize_t count, double *normal, double *arc)
{
    for (Py_ssize_t k = 1; k < count - 1; k++) {
        const double *at = pixels + 2 * k;
        across(at[2] - at[-2], at[3] - at[-1], normal + 2 * k);
    }
    for (Py_ssize_t k = 1; k < count; k++) {
        double u = pixels[2 * k] - pixels[2 * k - 2], v = pixels[2 * k + 1] - pixels[2 * k - 1];
        arc[k] = sqrt(u * u + v * v);
    }
    if (count == 0)
        return;
    Py_ssize_t end = count - 1, inner = end > 0 ? end - 1 : 0, second = end > 0 ? 1 : 0;
    across(pixels[2 * second] - pixels[0], pixels[2 * second + 1] - pixels[1], normal);
    across(pixels[2 * end] - pixels[2 * inner], pixels[2 * end + 1] - pixels[2 * inner + 1], normal + 2 * end);
    arc[0] = 0.0;
    for (Py_ssize_t k = 1; k < count; k++)
        arc[k] += arc[k - 1];
}

PyObject *curve_track(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    view as;
    array arc, at, t, pixels, depth, normal, along;
    (void)module;
    if (require(count == VIEW_WORDS + 7, "curve_track takes fifteen arguments") < 0)
        return NULL;
    words += VIEW_WORDS;
    if (take_view(&all, words - VIEW_WORDS, &as) < 0 || take(&all, words[0], "arc", 'd', 1, 0, 0, &arc) < 0 ||
        take(&all, words[1], "at", 'd', 1, 0, 0, &at) < 0 || take(&all, words[2], "t", 'd', 1, 1, 1, &t) < 0 ||
        take(&all, words[3], "pixels", 'd', 2, 1, 1, &pixels) < 0 ||
        take(&all, words[4], "depth", 'd', 1, 1, 1, &depth) < 0 ||
        take(&all, words[5], "normal", 'd', 2, 1, 1, &normal) < 0 ||
        take(&all, words[6], "along", 'd', 1, 1, 1, &along) < 0) {
        release(&all);
        return NULL;
    }
    Py_ssize_t known = arc.shape[0], samples = t.shape[0];
    if (require(known > 0 && at.shape[0] == known, "arc and at differ in length") < 0 ||
        require(pixels.shape[0] == samples && pixels.shape[1] == 2 && depth.shape[0] == samples &&
                    normal.shape[0] == samples && normal.shape[1] == 2 && along.shape[0] == samples,
                "pixels, depth, normal and along do not fit t") < 0) {
        release(&all);
        return NULL;
    }
    double *own_t = (double *)t.at, *own_depth = (double *)depth.at, *pixel = (double *)pixels.at;
    double whole = number(&arc, known - 1);
    Py_ssize_t kept = 0, piece = 0;
    for (Py_ssize_t k = 0; k < samples; k++) {
        double wanted = k == samples - 1 ? whole : k * (whole / (double)(samples - 1));
        while (piece < known - 1 && number(&arc, piece + 1) <= wanted)
            piece++;
        double first = number(&at, piece), here = first;
        if (piece < known - 1) {
            double low = number(&arc, piece);
            double slope = (number(&at, piece + 1) - first) / (number(&arc, piece + 1) - low);
            here = slope * (wanted - low) + first;
        }
        own_t[kept] = here;
        own_depth[kept] = seen(&as, here, pixel + 2 * kept);
        kept += isfinite(pixel[2 * kept]) && isfinite(pixel[2 * kept + 1]);
    }
    measure(pixel, kept, (double *)normal.at, (double *)along.at);
    release(&all);
    return PyLong_FromSsize_t(kept);
}

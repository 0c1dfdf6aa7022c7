/* From conductors' shapes to the numbers that are reported: see sagnode.geometry.quantities, which says what they mean
   and does the same in NumPy. */
#include "geometry.h"
#include <stdlib.h>
#include <string.h>

/* Rows of the result, in the order of sagnode.geometry.quantities. */
enum { BELOW, DEPTH, BLOWOUT, LOWEST, LOWEST_ALONG, GAP, GAP_ALONG, MIDSPAN, MIDSPAN_GAP, CONSTANT, ROWS };

typedef struct {
    Py_ssize_t count, obstacles;
    const double *along, *height, *obstacle;
} ground;

typedef struct {
    double place, value;
} point;

/* Values at the rising places, straight between them and constant beyond; `guess` is where the last one was found. */
static double interpolated(const double *places, const double *values, Py_ssize_t count, double at, Py_ssize_t *guess)
{
    if (isnan(at))
        return at;
    if (!(at > places[0]))
        return values[0];
    if (!(at < places[count - 1]))
        return values[count - 1];
    Py_ssize_t k = *guess;
    while (k > 0 && !(places[k] <= at))
        k--;
    while (k < count - 2 && places[k + 1] <= at)
        k++;
    *guess = k;
    double slope = (values[k + 1] - values[k]) / (places[k + 1] - places[k]);
    return slope * (at - places[k]) + values[k];
}

static double top_of(const ground *below, double at, Py_ssize_t *guess)
{
    double top = interpolated(below->along, below->height, below->count, at, guess);
    for (Py_ssize_t k = 0; k < below->obstacles; k++) {
        const double *row = below->obstacle + 3 * k;
        if (at >= row[0] && at <= row[1] && row[2] > top)
            top = row[2];
    }
    return top;
}

/* Greatest value, by the parabola through it and its neighbours. */
static point greatest(const double *values, const double *places, Py_ssize_t count)
{
    Py_ssize_t best = 0;
    for (Py_ssize_t k = 1; k < count && !isnan(values[best]); k++)
        if (values[k] > values[best] || isnan(values[k]))
            best = k;
    point result = {places[best], values[best]};
    if (best == 0 || best == count - 1)
        return result;
    const double *x = places + best - 1, *y = values + best - 1;
    double first = (y[1] - y[0]) / (x[1] - x[0]), second = (y[2] - y[1]) / (x[2] - x[1]);
    double curvature = (second - first) / (x[2] - x[0]);
    if (!(curvature < 0))
        return result;
    double low = x[0] < x[2] ? x[0] : x[2], high = x[0] < x[2] ? x[2] : x[0];
    double at = (x[0] + x[1]) / 2 - first / (2 * curvature);
    at = at < low ? low : at > high ? high : at;
    result.place = at;
    result.value = y[0] + first * (at - x[0]) + curvature * (at - x[0]) * (at - x[1]);
    return result;
}

/* One shape, sampled; `heading` is the horizontal direction from A to B. */
typedef struct {
    conductor of;
    double span, heading[2];
    Py_ssize_t count;
    double *along, *height, *below, *depth, *aside, *lower;
    double *bends; /* what each term of a load adds to the depth over the sag (count, terms): the same for all shapes */
} sampled;

enum { SAMPLED = 6 };

/* What is asked of several shapes. */
typedef struct {
    array near, far, sag, swing, load, t;
    ground below;
    Py_ssize_t count;
} question;

static void hang_shape(const question *q, Py_ssize_t s, sampled *out)
{
    double near[3], far[3];
    for (int k = 0; k < 3; k++) {
        near[k] = number2(&q->near, s, k);
        far[k] = number2(&q->far, s, k);
    }
    conductor *of = &out->of;
    of->load = q->load;
    of->load.at += q->load.shape[0] == 1 ? 0 : s * q->load.step[0];
    of->load.shape[0] = q->load.shape[1];
    of->load.step[0] = q->load.step[1];
    hang(of, near, far, number(&q->sag, s), number(&q->swing, s));
    out->span = hypot(of->chord[0], of->chord[1]);
    out->heading[0] = of->chord[0] / out->span;
    out->heading[1] = of->chord[1] / out->span;
}

static inline double along_of(const sampled *s, const double place[3])
{
    return (place[0] - s->of.near[0]) * s->heading[0] + (place[1] - s->of.near[1]) * s->heading[1];
}

static void sample(const question *q, sampled *s)
{
    double slope = s->of.chord[2] / s->span;
    Py_ssize_t terms = s->of.load.shape[0];
    for (Py_ssize_t k = 0; k < s->count; k++) {
        double t = number(&q->t, k), place[3], bent = 0.0;
        for (Py_ssize_t term = 0; term < terms; term++)
            bent += number(&s->of.load, term) * s->bends[k * terms + term];
        double depth = even_depth(&s->of, t) + s->of.sag * bent;
        for (int i = 0; i < 3; i++)
            place[i] = s->of.near[i] + t * s->of.chord[i] + depth * s->of.down[i];
        double x = place[0] - s->of.near[0], y = place[1] - s->of.near[1], along = along_of(s, place);
        s->along[k] = along;
        s->height[k] = place[2];
        s->lower[k] = -place[2];
        s->depth[k] = depth;
        s->below[k] = s->of.near[2] + slope * along - place[2];
        s->aside[k] = fabs(x * s->heading[1] - y * s->heading[0]);
    }
}

/* The ground's and obstacles' ends, where the ground may come nearer than at any sample. */
static double edge(const ground *below, Py_ssize_t k)
{
    if (k < below->count)
        return below->along[k];
    k -= below->count;
    return k < below->obstacles ? below->obstacle[3 * k] : below->obstacle[3 * (k - below->obstacles) + 1];
}

/* Places and distances to the ground: at the samples, and at the edges from `low` to `high`. Returns how many. */
static Py_ssize_t gaps(const question *q, const sampled *s, double low, double high, point *out)
{
    Py_ssize_t guess = 0, here = 0, found = s->count, edges = q->below.count + 2 * q->below.obstacles;
    for (Py_ssize_t k = 0; k < s->count; k++)
        out[k] = (point){s->along[k], s->height[k] - top_of(&q->below, s->along[k], &guess)};
    for (Py_ssize_t k = 0; k < edges; k++) {
        double at = edge(&q->below, k);
        if (at > low && at < high)
            out[found++] = (point){at, interpolated(s->along, s->height, s->count, at, &here) -
                                           top_of(&q->below, at, &guess)};
    }
    return found;
}

/* The least, the first of several that are alike. */
static point least_of(const point *each, Py_ssize_t count)
{
    Py_ssize_t best = 0;
    for (Py_ssize_t k = 1; k < count && !isnan(each[best].value); k++)
        if (each[k].value < each[best].value || isnan(each[k].value))
            best = k;
    return each[best];
}

/* From where to where along the span all of the shapes reach. */
static void reach(const question *q, double *low, double *high)
{
    *low = -INFINITY;
    *high = INFINITY;
    for (Py_ssize_t k = 0; k < q->count; k++) {
        sampled s;
        double first[3], last[3];
        hang_shape(q, k, &s);
        place_at(&s.of, number(&q->t, 0), first);
        place_at(&s.of, number(&q->t, q->t.shape[0] - 1), last);
        double begin = along_of(&s, first), end = along_of(&s, last);
        /* no edge is between ends that are not numbers */
        *low = begin <= *low ? *low : begin;
        *high = end >= *high ? *high : end;
    }
}

/* The first arguments: near, far, sag, swing, load, t, along, height, obstacles. */
enum { ASKED = 9 };

static int ask(arrays *all, PyObject *const *words, question *q)
{
    array along, height, obstacles;
    if (take(all, words[0], "near", 'd', 2, 0, 0, &q->near) < 0 ||
        take(all, words[1], "far", 'd', 2, 0, 0, &q->far) < 0 ||
        take(all, words[2], "sag", 'd', 1, 0, 0, &q->sag) < 0 ||
        take(all, words[3], "swing", 'd', 1, 0, 0, &q->swing) < 0 ||
        take(all, words[4], "load", 'd', 2, 0, 0, &q->load) < 0 || take(all, words[5], "t", 'd', 1, 1, 0, &q->t) < 0 ||
        take(all, words[6], "along", 'd', 1, 1, 0, &along) < 0 ||
        take(all, words[7], "height", 'd', 1, 1, 0, &height) < 0 ||
        take(all, words[8], "obstacles", 'd', 2, 1, 0, &obstacles) < 0)
        return -1;
    q->count = q->near.shape[0];
    q->below = (ground){along.shape[0], obstacles.shape[0], (const double *)along.at, (const double *)height.at,
                        (const double *)obstacles.at};
    if (require(q->near.shape[1] == 3 && q->far.shape[0] == q->count && q->far.shape[1] == 3 &&
                    q->sag.shape[0] == q->count && q->swing.shape[0] == q->count,
                "near, far, sag and swing do not fit each other") < 0 ||
        require((q->load.shape[0] == q->count || q->load.shape[0] == 1) && q->load.shape[1] <= 1000,
                "load does not fit near") < 0 ||
        require(q->t.shape[0] >= 2, "t: at least two parameters are wanted") < 0 ||
        require(along.shape[0] >= 1 && height.shape[0] == along.shape[0] && obstacles.shape[1] == 3,
                "along, height and obstacles do not fit each other") < 0)
        return -1;
    return 0;
}

/* What the terms of a load add at every sample. */
static void bend(const question *q, sampled *s)
{
    Py_ssize_t terms = q->load.shape[1];
    for (Py_ssize_t k = 0; terms > 0 && k < s->count; k++) {
        shapes each = first_shape(number(&q->t, k));
        for (int term = 0; term < terms; term++)
            s->bends[k * terms + term] = next_shape(&each, term + 1);
    }
}

/* Room for the samples of one shape and its places above the ground, to be let go with free(); NULL without memory. */
static point *room_for(const question *q, sampled *s)
{
    Py_ssize_t count = s->count = q->t.shape[0], places = count + q->below.count + 2 * q->below.obstacles;
    size_t numbers = (size_t)(SAMPLED + q->load.shape[1]) * (size_t)count;
    point *room = malloc((size_t)places * sizeof *room + numbers * sizeof(double));
    if (room == NULL) {
        PyErr_NoMemory();
        return NULL;
    }
    double *each[SAMPLED], *first = (double *)(room + places);
    for (int k = 0; k < SAMPLED; k++)
        each[k] = first + k * count;
    s->along = each[0];
    s->height = each[1];
    s->below = each[2];
    s->depth = each[3];
    s->aside = each[4];
    s->lower = each[5];
    s->bends = first + SAMPLED * count;
    bend(q, s);
    return room;
}

PyObject *quantities(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    question q;
    sampled s;
    array result;
    point *room = NULL;
    (void)module;
    if (require(count == ASKED + 1, "quantities takes ten arguments") < 0)
        return NULL;
    if (ask(&all, words, &q) < 0 || take(&all, words[ASKED], "result", 'd', 2, 1, 1, &result) < 0 ||
        require(result.shape[0] == ROWS && result.shape[1] == q.count, "result does not fit near") < 0 ||
        (room = room_for(&q, &s)) == NULL) {
        release(&all);
        return NULL;
    }
    double low, high, *row = (double *)result.at;
    reach(&q, &low, &high);
    for (Py_ssize_t k = 0; k < q.count; k++, row++) {
        Py_ssize_t guess = 0;
        hang_shape(&q, k, &s);
        sample(&q, &s);
        point lowest = greatest(s.lower, s.along, s.count);
        point gap = least_of(room, gaps(&q, &s, low, high, room));
        double middle = s.span / 2;
        double midspan = interpolated(s.along, s.height, s.count, middle, &guess);
        guess = 0;
        row[BELOW * q.count] = greatest(s.below, s.along, s.count).value;
        row[DEPTH * q.count] = greatest(s.depth, (const double *)q.t.at, s.count).value;
        row[BLOWOUT * q.count] = greatest(s.aside, s.along, s.count).value;
        row[LOWEST * q.count] = -lowest.value;
        row[LOWEST_ALONG * q.count] = lowest.place;
        row[GAP * q.count] = gap.value;
        row[GAP_ALONG * q.count] = gap.place;
        row[MIDSPAN * q.count] = midspan;
        row[MIDSPAN_GAP * q.count] = midspan - top_of(&q.below, middle, &guess);
        row[CONSTANT * q.count] = s.of.constant;
    }
    free(room);
    release(&all);
    Py_RETURN_NONE;
}

static int by_place(const void *a, const void *b)
{
    double x = ((const point *)a)->place, y = ((const point *)b)->place;
    /* what is not a number comes last */
    return isnan(x) || isnan(y) ? isnan(x) - isnan(y) : (x > y) - (x < y);
}

PyObject *clearance_place_u(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    question q;
    sampled s;
    double low, high, height_u, weights = 0.0, sum = 0.0;
    point *room = NULL;
    (void)module;
    if (require(count == ASKED + 1, "clearance_place_u takes ten arguments") < 0)
        return NULL;
    if (ask(&all, words, &q) < 0 || take_number(words[ASKED], &height_u) < 0 ||
        require(q.count == 1, "one shape is wanted") < 0 || (room = room_for(&q, &s)) == NULL) {
        release(&all);
        return NULL;
    }
    reach(&q, &low, &high);
    hang_shape(&q, 0, &s);
    sample(&q, &s);
    Py_ssize_t places = gaps(&q, &s, low, high, room);
    qsort(room, (size_t)places, sizeof *room, by_place);
    point best = least_of(room, places);
    double unsure = height_u > 1e-6 ? height_u : 1e-6;
    for (Py_ssize_t k = 0; k < places; k++) {
        const point *before = room + (k > 0 ? k - 1 : k), *after = room + (k < places - 1 ? k + 1 : k);
        double width = (after->place - before->place) / (double)(after - before);
        double excess = (room[k].value - best.value) / unsure, away = room[k].place - best.place;
        double weight = exp(-0.25 * (excess * excess)) * width;
        weights += weight;
        sum += weight * (away * away);
    }
    free(room);
    release(&all);
    return PyFloat_FromDouble(sqrt(sum / (weights > 1e-12 ? weights : 1e-12)));
}

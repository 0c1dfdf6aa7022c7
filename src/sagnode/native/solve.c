/* The joint estimate of camera and conductor: see sagnode.estimate.joint, which says what it means and does the same in
   NumPy. There the offsets' covariance is a matrix. Here the error that neighbours share, which falls off exponentially
   with their distance along the curve, is what it is then: a first-order Markov process, whose states a scalar Kalman
   filter follows from one offset to the next. Its normalised innovations are the whitened rows. What light from one side
   does to all offsets alike comes as further columns, which are eliminated from the sums of products. */
#include "numbers.h"
#include "terms.h"
#include <stdlib.h>
#include <string.h>

/* What sagnode.estimate.joint hands over of constants and limits, in this order. */
enum { LEAST_SHARED, SHARE, REACH_PX, CAUCHY, SETTLED, ANEW, BENT, SAG_LOW, SAG_HIGH, SWING_LOW, SWING_HIGH, SETTINGS };

/* NaN where any of the values is. */
static double median_of_absolutes(const double *values, Py_ssize_t count, double *room)
{
    for (Py_ssize_t k = 0; k < count; k++) {
        if (isnan(values[k]))
            return NAN;
        room[k] = fabs(values[k]);
    }
    qsort(room, (size_t)count, sizeof *room, rising);
    return count % 2 ? room[count / 2] : 0.5 * (room[count / 2 - 1] + room[count / 2]);
}

/* Directions of light at most, and the most columns of a row: derivatives, the residual, and what each light does. */
enum { LIGHTS = 2, COLUMNS = SIZE + 1 + LIGHTS };

/* Sums of products of the columns of the whitened rows, derivatives first and the residual next, into the upper half of
   (columns, columns), whose number is returned; what is behind the residual's is of no further use. */
static int weigh(const offsets *seen, const double *settings, const double *noise, const double *shared,
                 const double *jacobian, int width, const double *residual, double *sums)
{
    double state[COLUMNS] = {0}, row[COLUMNS], variance = 1.0;
    int columns = width + 1 + seen->lights;
    memset(sums, 0, (size_t)(columns * columns) * sizeof *sums);
    for (Py_ssize_t n = 0; n < seen->count; n++) {
        double kept = n ? exp(-(seen->arc[n] - seen->arc[n - 1]) / settings[REACH_PX]) : 0.0, own = sqrt(shared[n]);
        double before = kept * kept * variance + (1 - kept * kept);
        double total = shared[n] * before + noise[n], gain = own * before / total, shorten = 1 / sqrt(total);
        for (int k = 0; k < columns; k++) {
            double value = k < width    ? jacobian[n * SIZE + k]
                           : k == width ? residual[n]
                                        : seen->shading[n * seen->lights + k - width - 1];
            double foreseen = kept * state[k], surprise = value - own * foreseen;
            state[k] = foreseen + gain * surprise;
            row[k] = surprise * shorten;
        }
        variance = before * noise[n] / total;
        for (int i = 0; i < columns; i++) {
            double *of = sums + i * columns, factor = row[i];
            for (int j = i; j < columns; j++)
                of[j] += factor * row[j];
        }
    }
    /* (C + vv')^-1 = C^-1 - C^-1 v v' C^-1 / (1 + v' C^-1 v), one light after the other */
    for (int last = columns - 1; last > width; last--) {
        double factor = 1.0 / (1.0 + sums[last * columns + last]);
        for (int i = 0; i < last; i++) {
            double own = sums[i * columns + last] * factor;
            for (int j = i; j < last; j++)
                sums[i * columns + j] -= own * sums[j * columns + last];
        }
    }
    return columns;
}

/* What is asked of an estimate, and what it answers. */
typedef struct {
    survey of;
    offsets seen;
    const double *known, *target, *longest, *settings;
    int iterations;
    double *theta, *covariance, *residual, *weight, *noise, *jacobian;
    double inflation, misfit;
    int converged;
} estimate;

/* `marginal`: variance of each offset by all that it shares. */
static void weights(estimate *e, const double *marginal, double spread)
{
    double limit2 = e->settings[CAUCHY] * e->settings[CAUCHY], sum = 0.0, chi2 = 0.0;
    for (Py_ssize_t n = 0; n < e->seen.count; n++) {
        double white = e->seen.sigma[n] * e->seen.sigma[n], squared = e->residual[n] * e->residual[n];
        double weight = 1.0 / (1.0 + squared / (white + marginal[n] + spread * spread) / limit2);
        e->weight[n] = weight;
        e->noise[n] = white / least(weight, 1e-6);
        sum += weight;
        chi2 += weight * squared / least(e->noise[n] + marginal[n], 1e-12);
    }
    double ratio = chi2 / least(sum - 4.0, 1.0);
    e->inflation = ratio > 1.0 ? ratio : 1.0;
}

/* One step; its length in standard uncertainties. */
static double advance(estimate *e, const double *shared, double *posterior)
{
    int width = e->of.free;
    double sums[COLUMNS * COLUMNS], matrix[SIZE * SIZE], vector[SIZE], step[SIZE], ratio = 1.0;
    int columns = weigh(&e->seen, e->settings, e->noise, shared, e->jacobian, width, e->residual, sums);
    for (int i = 0; i < width; i++) {
        vector[i] = e->target[i] + sums[i * columns + width] / e->inflation;
        for (int j = 0; j < width; j++) {
            int upper = i < j ? i * columns + j : j * columns + i;
            matrix[i * width + j] = e->known[i * SIZE + j] + sums[upper] / e->inflation;
            vector[i] -= e->known[i * SIZE + j] * e->theta[j];
        }
    }
    solve_scaled(matrix, vector, width, step, posterior);
    for (int k = 0; k < width; k++) {
        double far = fabs(step[k]) / e->longest[k];
        ratio = far > ratio ? far : ratio;
    }
    for (int k = 0; k < width; k++)
        e->theta[k] += step[k] / ratio;
    e->theta[SAG] = clipped(e->theta[SAG], e->settings[SAG_LOW], e->settings[SAG_HIGH]);
    e->theta[SWING] = clipped(e->theta[SWING], e->settings[SWING_LOW], e->settings[SWING_HIGH]);
    return length_of(step, posterior, width);
}

static int all_finite(const double *values, Py_ssize_t count)
{
    for (Py_ssize_t k = 0; k < count; k++)
        if (!isfinite(values[k]))
            return 0;
    return 1;
}

/* sagnode.estimate.joint.bend, of sag and swing as the derivatives were taken. */
static double bend(const estimate *e, const double *taken, const double *posterior)
{
    int width = e->of.free;
    double moved = fabs(e->theta[SAG] - taken[SAG]) + e->theta[SAG] * fabs(e->theta[SWING] - taken[SWING]);
    return moved * sqrt(posterior[SWING * width + SWING] / posterior[SAG * width + SAG]);
}

/* What is known before any step: the prior's covariance (width, width). */
static void begin(const estimate *e, double *posterior)
{
    double matrix[SIZE * SIZE], none[SIZE] = {0}, step[SIZE];
    int width = e->of.free;
    for (int k = 0; k < width * width; k++)
        matrix[k] = e->known[k / width * SIZE + k % width];
    solve_scaled(matrix, none, width, step, posterior);
}

/* `room` holds three times as many numbers as there are offsets. */
static void settle(estimate *e, double *room)
{
    double *shared = room + e->seen.count, *marginal = shared + e->seen.count;
    double posterior[SIZE * SIZE], after[SIZE * SIZE], before[SIZE], taken[SIZE], sums[(1 + LIGHTS) * (1 + LIGHTS)];
    int width = e->of.free, steps = 0, nowhere = 0;
    for (Py_ssize_t n = 0; n < e->seen.count; n++) {
        double own = hypot(e->settings[LEAST_SHARED], e->settings[SHARE] * e->seen.sigma[n]);
        shared[n] = marginal[n] = own * own;
        for (int k = 0; k < e->seen.lights; k++) {
            double moved = e->seen.shading[n * e->seen.lights + k];
            marginal[n] += moved * moved;
        }
    }
    terms(&e->of, e->theta, &e->seen, e->residual, e->jacobian);
    memcpy(taken, e->theta, sizeof taken);
    for (int k = 0; k < e->iterations && !e->converged && !nowhere; k++) {
        double spread = k < 2 ? least(1.4826 * median_of_absolutes(e->residual, e->seen.count, room), 1e-3) : 0.0;
        weights(e, marginal, spread);
        memcpy(before, e->theta, sizeof before);
        double length = advance(e, shared, after);
        double bent = bend(e, taken, after);
        int anew = length > e->settings[ANEW] || bent > e->settings[BENT];
        terms(&e->of, e->theta, &e->seen, e->residual, anew ? e->jacobian : NULL);
        if (anew)
            memcpy(taken, e->theta, sizeof taken);
        nowhere = !(isfinite(length) && all_finite(e->residual, e->seen.count));
        if (nowhere) {
            memcpy(e->theta, before, sizeof before);
            terms(&e->of, e->theta, &e->seen, e->residual, e->jacobian);
            continue;
        }
        memcpy(posterior, after, sizeof posterior);
        steps++;
        e->converged = k >= 2 && length < e->settings[SETTLED] && bent <= e->settings[BENT];
    }
    if (steps == 0)
        begin(e, posterior);
    memset(e->covariance, 0, SIZE * SIZE * sizeof *e->covariance);
    for (int i = 0; i < width; i++)
        for (int j = 0; j < width; j++)
            e->covariance[i * SIZE + j] = posterior[i * width + j];
    if (nowhere) {
        e->misfit = INFINITY;
        return;
    }
    weigh(&e->seen, e->settings, e->noise, shared, e->jacobian, 0, e->residual, sums);
    e->misfit = sums[0];
    for (int i = 0; i < SIZE; i++) {
        double pull = 0.0;
        for (int j = 0; j < SIZE; j++)
            pull += e->known[i * SIZE + j] * e->theta[j];
        e->misfit += e->theta[i] * (pull - 2 * e->target[i]);
    }
}

PyObject *solve(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    estimate e = {0};
    array theta, arc, sigma, shading, known, target, longest, settings, covariance, residual, weight, noise, jacobian;
    double iterations;
    (void)module;
    if (require(count == ASKED + 14, "solve takes 23 arguments") < 0)
        return NULL;
    PyObject *const *more = words + ASKED;
    if (take_offsets(&all, words, 1, &e.of, &theta, &e.seen) < 0 || take_free(more[0], &e.of.free) < 0 ||
        take(&all, more[1], "arc", 'd', 1, 1, 0, &arc) < 0 || take(&all, more[2], "sigma", 'd', 1, 1, 0, &sigma) < 0 ||
        take(&all, more[3], "shading", 'd', 2, 1, 0, &shading) < 0 ||
        take(&all, more[4], "known", 'd', 2, 1, 0, &known) < 0 ||
        take(&all, more[5], "target", 'd', 1, 1, 0, &target) < 0 ||
        take(&all, more[6], "longest", 'd', 1, 1, 0, &longest) < 0 ||
        take(&all, more[7], "settings", 'd', 1, 1, 0, &settings) < 0 || take_number(more[8], &iterations) < 0 ||
        take(&all, more[9], "covariance", 'd', 2, 1, 1, &covariance) < 0 ||
        take(&all, more[10], "residual", 'd', 1, 1, 1, &residual) < 0 ||
        take(&all, more[11], "weight", 'd', 1, 1, 1, &weight) < 0 ||
        take(&all, more[12], "noise", 'd', 1, 1, 1, &noise) < 0 ||
        take(&all, more[13], "jacobian", 'd', 2, 1, 1, &jacobian) < 0)
        goto refused;
    const array *each[] = {&arc, &sigma, &residual, &weight, &noise, &jacobian};
    for (int k = 0; k < 6; k++)
        if (require(each[k]->shape[0] == e.seen.count && e.seen.count > 0, "an array of a wrong length") < 0)
            goto refused;
    if (require(shading.shape[0] == e.seen.count && shading.shape[1] <= LIGHTS, "shading of a wrong size") < 0 ||
        require(known.shape[0] == SIZE && known.shape[1] == SIZE && target.shape[0] == SIZE &&
                    longest.shape[0] == e.of.free && settings.shape[0] == SETTINGS && covariance.shape[0] == SIZE &&
                    covariance.shape[1] == SIZE && jacobian.shape[1] == SIZE,
                "known, target, longest, settings, covariance or jacobian of a wrong size") < 0 ||
        require(iterations >= 1 && iterations <= 10000, "iterations: 1 to 10000 are wanted") < 0)
        goto refused;
    const double *along = (const double *)arc.at;
    for (Py_ssize_t n = 1; n < e.seen.count; n++)
        if (require(along[n] >= along[n - 1], "arc does not rise") < 0)
            goto refused;
    double *room = malloc(3 * (size_t)e.seen.count * sizeof *room);
    if (room == NULL) {
        PyErr_NoMemory();
        goto refused;
    }
    e.seen.arc = along;
    e.seen.sigma = (const double *)sigma.at;
    e.seen.shading = (const double *)shading.at;
    e.seen.lights = (int)shading.shape[1];
    e.known = (const double *)known.at;
    e.target = (const double *)target.at;
    e.longest = (const double *)longest.at;
    e.settings = (const double *)settings.at;
    e.iterations = (int)iterations;
    e.theta = (double *)theta.at;
    e.covariance = (double *)covariance.at;
    e.residual = (double *)residual.at;
    e.weight = (double *)weight.at;
    e.noise = (double *)noise.at;
    e.jacobian = (double *)jacobian.at;
    settle(&e, room);
    free(room);
    release(&all);
    return Py_BuildValue("ddi", e.inflation, e.misfit, e.converged);
refused:
    release(&all);
    return NULL;
}

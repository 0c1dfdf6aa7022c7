/* What many explanations of a wire's picture say of some swings: see sagnode.estimate.swings, which says what it means and
   does the same in NumPy. */
#include "kernels.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CHUNK = 64, TERMS = 13 };

#define LEAST_EXPONENT -700.0
#define LOG2_E 1.4426950408889634
#define LN2_HIGH 0.693147180369123816490
#define LN2_LOW 1.90821492927058770002e-10
/* Added to a number of less than 2^51, the digits after the point are rounded off, and the whole is in the last bits. */
#define ROUNDED 6755399441055744.0

/* 1 / n!, the highest first. */
static const double inverse_factorials[TERMS] = {
    1.0 / 6227020800.0, 1.0 / 479001600.0, 1.0 / 39916800.0, 1.0 / 3628800.0, 1.0 / 362880.0, 1.0 / 40320.0,
    1.0 / 5040.0,       1.0 / 720.0,       1.0 / 120.0,      1.0 / 24.0,      1.0 / 6.0,      1.0 / 2.0,     1.0,
};

/* exp(x) for x up to 0, as near as double precision has it, in steps that compilers make for several x at a time; what
   is smaller than e^-700 is that. */
static inline double exponential(double x)
{
    union {
        double number;
        uint64_t bits;
    } turns, power;
    x = x < LEAST_EXPONENT ? LEAST_EXPONENT : x;
    turns.number = x * LOG2_E + ROUNDED;
    double whole = turns.number - ROUNDED, rest = (x - whole * LN2_HIGH) - whole * LN2_LOW;
    power.number = inverse_factorials[0];
    for (int k = 1; k < TERMS; k++)
        power.number = power.number * rest + inverse_factorials[k];
    power.number = power.number * rest + 1.0;
    power.bits += turns.bits << 52;
    return power.number;
}

/* Explanations (count,): logarithm of the evidence, swing and variance of each. */
typedef struct {
    Py_ssize_t count;
    const double *level, *swing, *variance;
} explanations;

/* Logarithm of the sum over all explanations at a chunk of swings; `room` holds (count, CHUNK). */
FOR_EACH_PROCESSOR
static void summed(const explanations *all, const double *restrict common, const double *restrict spread, int some,
                   double *restrict room, double *restrict out)
{
    double highest[CHUNK], sum[CHUNK];
    for (int k = 0; k < some; k++) {
        highest[k] = -INFINITY;
        sum[k] = 0.0;
    }
    for (Py_ssize_t e = 0; e < all->count; e++) {
        double level = all->level[e], swing = all->swing[e], variance = all->variance[e], *logs = room + e * CHUNK;
        for (int k = 0; k < some; k++) {
            double away = swing - common[k];
            logs[k] = level - 0.5 * away * away / (variance + spread[k]);
            highest[k] = logs[k] > highest[k] ? logs[k] : highest[k];
        }
    }
    for (Py_ssize_t e = 0; e < all->count; e++) {
        double variance = all->variance[e];
        const double *logs = room + e * CHUNK;
        for (int k = 0; k < some; k++)
            sum[k] += exponential(logs[k] - highest[k]) / sqrt(variance + spread[k]);
    }
    for (int k = 0; k < some; k++)
        out[k] = highest[k] + log(sum[k]);
}

PyObject *sum_explanations(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    array level, swing, variance, common, spread, out;
    (void)module;
    if (require(count == 6, "sum_explanations takes six arguments") < 0)
        return NULL;
    if (take(&all, words[0], "level", 'd', 1, 1, 0, &level) < 0 || take(&all, words[1], "swing", 'd', 1, 1, 0, &swing) < 0 ||
        take(&all, words[2], "variance", 'd', 1, 1, 0, &variance) < 0 ||
        take(&all, words[3], "common", 'd', 1, 1, 0, &common) < 0 ||
        take(&all, words[4], "spread", 'd', 1, 1, 0, &spread) < 0 || take(&all, words[5], "out", 'd', 1, 1, 1, &out) < 0)
        goto refused;
    Py_ssize_t swings = common.shape[0];
    explanations own = {level.shape[0], (const double *)level.at, (const double *)swing.at, (const double *)variance.at};
    if (require(own.count > 0 && swing.shape[0] == own.count && variance.shape[0] == own.count,
                "level, swing and variance do not fit") < 0 ||
        require(spread.shape[0] == swings && out.shape[0] == swings, "common, spread and out do not fit") < 0)
        goto refused;
    double *room = malloc((size_t)own.count * CHUNK * sizeof *room);
    if (room == NULL) {
        PyErr_NoMemory();
        goto refused;
    }
    for (Py_ssize_t start = 0; start < swings; start += CHUNK) {
        int some = (int)(swings - start < CHUNK ? swings - start : CHUNK);
        summed(&own, (const double *)common.at + start, (const double *)spread.at + start, some, room,
               (double *)out.at + start);
    }
    free(room);
    release(&all);
    Py_RETURN_NONE;
refused:
    release(&all);
    return NULL;
}

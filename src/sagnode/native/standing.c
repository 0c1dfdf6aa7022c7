/* Which blocks stand out from what lies beside the curve: see sagnode.match.standing, which says what it means and does
   the same in NumPy. */
#include "kernels.h"
#include <math.h>
#include <string.h>

#define RANK_MIN 0.9
#define NEIGHBOURS 3
#define NEIGHBOUR_PX 0.8
#define NEIGHBOUR_SLOPE 0.06
#define FALSE_PEAK_POWER 6.0
#define TEXTURE_SNR 2.0
#define UNKNOWN_PX 1e3

/* Signal-to-noise ratios of M blocks, one row at each place beside the curve. */
static double with_neighbours(const double *snr, Py_ssize_t blocks, Py_ssize_t k)
{
    /* the first and the last block are their own neighbours */
    double own = snr[k] * snr[k], before = k > 0 ? snr[k - 1] * snr[k - 1] : own;
    double after = k + 1 < blocks ? snr[k + 1] * snr[k + 1] : own;
    return sqrt((own + before + after) / 3.0);
}

/* What the blocks (M,) are judged by; the arrays follow each other without gaps. */
typedef struct {
    const double *offset, *sigma, *snr, *arc, *beside, *range;
    const uint8_t *valid, *inside, *masked;
    Py_ssize_t blocks, shifts, run;
    double widest;
    double *rank, *place, *uncertainty;
    uint8_t *usable;
} question;

/* Rank of one block among the places beside it, and its lead over the second best. */
static void rank_one(const question *q, Py_ssize_t k, double *rank, double *lead)
{
    double here = with_neighbours(q->snr, q->blocks, k), total = 0.0, best = -INFINITY, second = -INFINITY;
    for (Py_ssize_t s = 0; s < q->shifts; s++) {
        /* a block that leaves the frame when shifted proves nothing, for or against */
        double there = q->inside[s * q->blocks + k] ? with_neighbours(q->beside + s * q->blocks, q->blocks, k) : here;
        total += there == here ? 0.5 : there < here;
        second = there > best ? best : there > second ? there : second;
        best = there > best ? there : best;
    }
    *rank = total / (double)q->shifts;
    *lead = here / (second > 1.0 ? second : 1.0);
}

static int same_line(const question *q, Py_ssize_t j, Py_ssize_t k)
{
    double limit = NEIGHBOUR_PX + NEIGHBOUR_SLOPE * (q->arc[k] - q->arc[j]);
    return q->usable[j] && q->usable[k] && fabs(q->place[k] - q->place[j]) < limit;
}

/* Whether enough usable neighbours of a block lie on the same smooth line. */
static int agrees(const question *q, Py_ssize_t k)
{
    int count = 0, exist = 0, foretold = q->range[k] < q->widest;
    for (Py_ssize_t away = 1; away <= NEIGHBOURS; away++) {
        if (k >= away) {
            count += same_line(q, k - away, k);
            exist += !q->masked[k - away];
        }
        if (k + away < q->blocks) {
            count += same_line(q, k, k + away);
            exist += !q->masked[k + away];
        }
    }
    /* at the ends of the curve half of the neighbours do not exist */
    int least = (exist + 1) / 2;
    least = least > 1 + foretold ? least : 1 + foretold;
    least = least < NEIGHBOURS ? least : NEIGHBOURS;
    return count + foretold >= least;
}

/* Leave out usable blocks that are not in a stretch of enough of them; one may be missing here or there. */
static void in_runs(const question *q, uint8_t *closed)
{
    Py_ssize_t count = q->blocks;
    for (Py_ssize_t k = 0; k < count; k++)
        closed[k] = q->usable[k] || (q->usable[(k + count - 1) % count] && q->usable[(k + 1) % count]);
    for (Py_ssize_t start = 0; start < count;) {
        Py_ssize_t end = start, sum = 0;
        for (; end < count && closed[end]; end++)
            sum += q->usable[end];
        if (sum < q->run)
            memset(q->usable + start, 0, (size_t)(end - start));
        start = end + 1;
    }
}

static void judge(question *q, uint8_t *scratch)
{
    for (Py_ssize_t k = 0; k < q->blocks; k++) {
        double lead;
        rank_one(q, k, &q->rank[k], &lead);
        q->place[k] = isnan(q->offset[k]) ? 0.0 : q->offset[k];
        double chance = 0.5 * pow(lead > 1.0 ? lead : 1.0, -FALSE_PEAK_POWER);
        double weak = exp((1.0 - q->snr[k]) / TEXTURE_SNR);
        weak = weak < 0.5 ? weak : 0.5;
        /* texture must look like a wire about here, and the block must be weak enough to be texture */
        double false_peak = q->range[k] * sqrt((chance < weak ? chance : weak) / 3.0);
        q->uncertainty[k] = hypot(isnan(q->sigma[k]) ? UNKNOWN_PX : q->sigma[k], false_peak);
        q->usable[k] = q->valid[k] && q->rank[k] >= RANK_MIN && !q->masked[k];
    }
    for (Py_ssize_t k = 0; k < q->blocks; k++)
        scratch[k] = q->usable[k] && agrees(q, k);
    memcpy(q->usable, scratch, (size_t)q->blocks);
    if (q->run > 1)
        in_runs(q, scratch);
}

PyObject *stand_out(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    question q;
    /* offset, sigma, snr, arc, range, rank, place, uncertainty; valid, masked, usable */
    array real[8], flag[3], beside, inside;
    static const char *const reals[] = {"offset", "sigma", "snr", "arc", "half_range", "rank", "place", "uncertainty"};
    static const char *const flags[] = {"valid", "masked", "usable"};
    static const int real_at[] = {0, 1, 2, 3, 8, 11, 12, 13}, flag_at[] = {4, 7, 14};
    uint8_t *scratch = NULL;
    PyObject *result = NULL;
    (void)module;
    if (require(count == 15, "stand_out takes fifteen arguments") < 0)
        return NULL;
    q.widest = PyFloat_AsDouble(words[9]);
    q.run = PyLong_AsSsize_t(words[10]);
    if (PyErr_Occurred())
        return NULL;
    for (int k = 0; k < 8; k++)
        if (take(&all, words[real_at[k]], reals[k], 'd', 1, 1, k >= 5, &real[k]) < 0)
            goto done;
    for (int k = 0; k < 3; k++)
        if (take(&all, words[flag_at[k]], flags[k], '?', 1, 1, k == 2, &flag[k]) < 0)
            goto done;
    if (take(&all, words[5], "beside", 'd', 2, 1, 0, &beside) < 0 ||
        take(&all, words[6], "inside", '?', 2, 1, 0, &inside) < 0)
        goto done;
    q.blocks = real[0].shape[0];
    q.shifts = beside.shape[0];
    int alike = beside.shape[1] == q.blocks && inside.shape[1] == q.blocks && inside.shape[0] == q.shifts;
    for (int k = 0; k < 8; k++)
        alike &= real[k].shape[0] == q.blocks;
    for (int k = 0; k < 3; k++)
        alike &= flag[k].shape[0] == q.blocks;
    if (require(alike, "the blocks' values differ in length") < 0 ||
        require(q.shifts >= 2, "at least two places beside the curve are wanted") < 0)
        goto done;
    scratch = PyMem_Malloc((size_t)q.blocks + 1);
    if (scratch == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    q.offset = (const double *)real[0].at;
    q.sigma = (const double *)real[1].at;
    q.snr = (const double *)real[2].at;
    q.arc = (const double *)real[3].at;
    q.range = (const double *)real[4].at;
    q.rank = (double *)real[5].at;
    q.place = (double *)real[6].at;
    q.uncertainty = (double *)real[7].at;
    q.valid = (const uint8_t *)flag[0].at;
    q.masked = (const uint8_t *)flag[1].at;
    q.usable = (uint8_t *)flag[2].at;
    q.beside = (const double *)beside.at;
    q.inside = (const uint8_t *)inside.at;
    judge(&q, scratch);
    result = Py_None;
    Py_INCREF(result);
done:
    PyMem_Free(scratch);
    release(&all);
    return result;
}

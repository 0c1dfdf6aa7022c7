/* Whether a curve responds more strongly than the same curve shifted aside, as a whole and window by window: see
   sagnode.match.sight.compared, which says what it means and does the same in NumPy. */
#include "kernels.h"
#include <math.h>
#include <string.h>

enum { MOST_SHIFTS = 255, LEAST_COMPARED = 6 };
#define WINDOW_PX 24.0
#define WINDOW_SHARE 0.04
#define WINDOW_RANK 0.95
#define LEAST_SPREAD 0.05

/* Responses (K, N) of a curve, the first row, and of it shifted aside; NaN outside the frame. */
typedef struct {
    const float *response;
    const double *t, *arc;
    Py_ssize_t rows, samples;
} question;

/* Mean over some samples of one row; NaN where less than half of them are in the frame. */
static double mean_of(const question *q, Py_ssize_t row, Py_ssize_t start, Py_ssize_t end)
{
    const float *own = q->response + row * q->samples;
    double total = 0.0;
    Py_ssize_t count = 0;
    for (Py_ssize_t k = start; k < end; k++)
        if (isfinite(own[k])) {
            total += (double)own[k];
            count++;
        }
    return (double)count > 0.5 * (double)(end - start) ? total / (double)(count > 1 ? count : 1) : NAN;
}

/* Means of the shifted rows as far as they are known, in rising order; how many. */
static int background(const question *q, Py_ssize_t start, Py_ssize_t end, double *sorted)
{
    int count = 0;
    for (Py_ssize_t row = 1; row < q->rows; row++) {
        double mean = mean_of(q, row, start, end);
        if (!isfinite(mean))
            continue;
        int k = count++;
        for (; k > 0 && sorted[k - 1] > mean; k--)
            sorted[k] = sorted[k - 1];
        sorted[k] = mean;
    }
    return count;
}

static double middle_of(const double *sorted, int count)
{
    return count % 2 ? sorted[count / 2] : 0.5 * (sorted[count / 2 - 1] + sorted[count / 2]);
}

/* Robust z-score of the whole curve among the shifted ones. */
static double score_of(const question *q)
{
    double sorted[MOST_SHIFTS], away[MOST_SHIFTS], own = mean_of(q, 0, 0, q->samples);
    int count = background(q, 0, q->samples, sorted);
    if (count < LEAST_COMPARED || !isfinite(own))
        return 0.0;
    double middle = middle_of(sorted, count);
    for (int n = 0; n < count; n++) {
        double apart = fabs(sorted[n] - middle);
        int k = n;
        for (; k > 0 && away[k - 1] > apart; k--)
            away[k] = away[k - 1];
        away[k] = apart;
    }
    double spread = 1.4826 * middle_of(away, count);
    return (own - middle) / (spread > LEAST_SPREAD ? spread : LEAST_SPREAD);
}

/* The end of the window that begins at a sample; 0 where what is left is too short. */
static Py_ssize_t window_end(const question *q, Py_ssize_t start)
{
    double first = fabs(q->t[start] - q->t[0]);
    for (Py_ssize_t k = start + 1; k < q->samples; k++)
        if (q->arc[k] >= q->arc[start] + WINDOW_PX && fabs(fabs(q->t[k] - q->t[0]) - first) >= WINDOW_SHARE)
            return k + 1;
    return 0;
}

/* Judge one window; 1 where it can be judged. */
static int judge(const question *q, Py_ssize_t start, Py_ssize_t end, uint8_t *seen, Py_ssize_t *stand_out)
{
    double sorted[MOST_SHIFTS], own = mean_of(q, 0, start, end);
    int count = background(q, start, end, sorted), below = 0;
    if (count < LEAST_COMPARED || !isfinite(own))
        return 0;
    for (int k = 0; k < count; k++)
        below += own > sorted[k];
    int outstanding = (double)below / count >= WINDOW_RANK;
    memset(seen + start, outstanding, (size_t)(end - start));
    *stand_out += outstanding;
    return 1;
}

PyObject *sight(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    array response, t, arc, seen;
    (void)module;
    if (require(count == 4, "sight takes four arguments") < 0)
        return NULL;
    if (take(&all, words[0], "response", 'f', 2, 1, 0, &response) < 0 ||
        take(&all, words[1], "t", 'd', 1, 1, 0, &t) < 0 || take(&all, words[2], "arc", 'd', 1, 1, 0, &arc) < 0 ||
        take(&all, words[3], "seen", '?', 1, 1, 1, &seen) < 0 ||
        require(response.shape[0] >= 1 && response.shape[0] <= MOST_SHIFTS + 1,
                "response: 1 to 256 curves are wanted") < 0 ||
        require(t.shape[0] >= 1 && response.shape[1] == t.shape[0] && arc.shape[0] == t.shape[0] &&
                    seen.shape[0] == t.shape[0],
                "response, t, arc and seen differ in length") < 0) {
        release(&all);
        return NULL;
    }
    question q = {(const float *)response.at, (const double *)t.at, (const double *)arc.at, response.shape[0],
                  response.shape[1]};
    uint8_t *found = (uint8_t *)seen.at;
    Py_ssize_t judged = 0, stand_out = 0;
    memset(found, 0, (size_t)q.samples);
    double score = score_of(&q);
    for (Py_ssize_t start = 0; start < q.samples;) {
        Py_ssize_t end = window_end(&q, start);
        /* a remainder too short to be judged by itself is judged with the stretch before it */
        if (end == 0 || window_end(&q, end < q.samples ? end : start) == 0)
            end = q.samples;
        judged += judge(&q, start, end, found, &stand_out);
        start = end;
    }
    release(&all);
    return Py_BuildValue("dnn", score, judged, stand_out);
}

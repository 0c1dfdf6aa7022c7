/* What a block shows across a curve, and what it would show of a wire: see sagnode.match.across and
   sagnode.match.kernels, which do the same in NumPy. */
#include "across.h"
#include <string.h>

static void add_steps(task *t, double u, double v, double nu, double nv, int first, int count)
{
    int wide = t->reach + t->near;
    double du = STEP_PX * nu, dv = STEP_PX * nv;
    add_samples(&t->image, u + first * du, v + first * dv, du, dv, count, t->sums + wide + first);
}

void block_profile(task *t, int wire, Py_ssize_t block, double *profile)
{
    int wide = t->reach + t->near, narrow = t->far + t->near, columns = 2 * wide + 1;
    Py_ssize_t start = whole(&t->starts, block), end = end_of(t, block), sparse = 0;
    memset(t->sums, 0, (size_t)columns * sizeof *t->sums);
    for (Py_ssize_t i = start; i < end; i++) {
        double u, v, nu = number2(&t->normal, i, 0), nv = number2(&t->normal, i, 1);
        sample(t, wire, i, &u, &v);
        if (i % t->every == 0) {
            sparse++;
            add_steps(t, u, v, nu, nv, -wide, columns);
        } else
            add_steps(t, u, v, nu, nv, -narrow, 2 * narrow + 1);
    }
    for (int k = 0; k < columns; k++) {
        int own = k >= wide - narrow && k <= wide + narrow;
        profile[k] = (double)t->sums[k] / (double)(own ? end - start : sparse);
    }
}

/* Slope of values (n,) as numpy.gradient has it. */
static void gradient(const double *values, int n, double *out)
{
    for (int k = 1; k < n - 1; k++)
        out[k] = (values[k + 1] - values[k - 1]) / 2.0;
    out[0] = values[1] - values[0];
    out[n - 1] = values[n - 1] - values[n - 2];
}

void block_kernels(task *t, Py_ssize_t block)
{
    int n = 2 * t->near + 1;
    double squared = 0.0;
    for (int wire = 0; wire < t->wires; wire++) {
        double *kernel = t->kernels + wire * n, own = t->middles[wire * t->blocks + block];
        for (int k = 0; k < n; k++) {
            kernel[k] = 0.0;
            for (int other = 0; other < t->wires; other++) {
                double away = t->wires > 1 ? t->middles[other * t->blocks + block] - own : 0.0;
                kernel[k] += wire_kernel(t->widths[block], STEP_PX * (k - t->near) - away, t->blur);
            }
        }
        level(kernel, n, t->wires > 1);
        for (int k = 0; k < n; k++)
            squared += kernel[k] * kernel[k];
    }
    t->norm = sqrt(squared);
    for (int k = 0; k < t->wires * n; k++)
        t->kernels[k] /= t->norm;
    for (int wire = 0; wire < t->wires; wire++)
        gradient(t->kernels + wire * n, n, t->slopes + wire * n);
}

double shared_noise(const task *t, Py_ssize_t block)
{
    int n = 2 * t->near + 1, last = n - 1;
    double alone = 0.0, shared = 0.0;
    for (int k = 0; k < t->wires * n; k++)
        alone += t->slopes[k] * t->slopes[k];
    for (int one = 0; one < t->wires; one++)
        for (int other = one + 1; other < t->wires; other++) {
            const double *mine = t->slopes + one * n, *theirs = t->slopes + other * n;
            double away = (t->middles[one * t->blocks + block] - t->middles[other * t->blocks + block]) / STEP_PX;
            double sum = 0.0;
            for (int k = 0; k < n; k++) {
                double place = k + away;
                if (!(place >= 0.0 && place <= last))
                    continue;
                int first = (int)place < last - 1 ? (int)place : last - 1;
                sum += mine[k] * (theirs[first] + (place - first) * (theirs[first + 1] - theirs[first]));
            }
            shared += 2.0 * sum;
        }
    double factor = 1.0 + shared / alone;
    return factor > 1.0 || isnan(factor) ? factor : 1.0;
}

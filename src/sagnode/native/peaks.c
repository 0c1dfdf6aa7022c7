/* Which of a block's windows holds the wire, and how surely: see sagnode.match.across, which does the same in NumPy. */
#include "across.h"
#include <string.h>

#define FLOOR_GREY 0.2

/* Add the amplitude and the energy of all windows (K - n + 1,) of a profile (K,); the profile loses its mean. */
FOR_EACH_PROCESSOR
static void add_compared(double *restrict profile, int columns, const double *restrict kernel, int n,
                         double *restrict running, double *restrict amplitude, double *restrict energy)
{
    double *total = running, *tilted = running + columns + 1, *squared = tilted + columns + 1;
    double steepest = (double)n * ((double)n * n - 1.0) / 12.0;
    level(profile, columns, 0);
    total[0] = tilted[0] = squared[0] = 0.0;
    for (int c = 0; c < columns; c++) {
        total[c + 1] = total[c] + profile[c];
        tilted[c + 1] = tilted[c] + profile[c] * c;
        squared[c + 1] = squared[c] + profile[c] * profile[c];
    }
    int windows = columns - n + 1, k = 0;
    /* several of the kernel's values at a time: most of the work is fetching and storing otherwise */
    for (; k + 4 <= n; k += 4) {
        double a = kernel[k], b = kernel[k + 1], c = kernel[k + 2], d = kernel[k + 3];
        const double *from = profile + k;
        for (int w = 0; w < windows; w++)
            amplitude[w] = amplitude[w] + a * from[w] + b * from[w + 1] + c * from[w + 2] + d * from[w + 3];
    }
    for (; k < n; k++)
        for (int w = 0; w < windows; w++)
            amplitude[w] += kernel[k] * profile[w + k];
    for (int w = 0; w < windows; w++) {
        double sum = total[w + n] - total[w], tilt = tilted[w + n] - tilted[w], power = squared[w + n] - squared[w];
        double middle = w + 0.5 * (n - 1), sloping = tilt - middle * sum;
        double left = power - sum * sum / n - sloping * sloping / steepest;
        energy[w] += left > 0.0 ? left : 0.0;
    }
}

/* Correlation of all windows with the kernel, small where there is only rounding. */
FOR_EACH_PROCESSOR
static void correlate(const double *amplitude, const double *energy, int windows, double floor, double *score)
{
    for (int w = 0; w < windows; w++)
        score[w] = fabs(amplitude[w]) / sqrt(energy[w] + floor);
}

void compare(task *t)
{
    int n = 2 * t->near + 1, columns = 2 * (t->reach + t->near) + 1, windows = columns - n + 1;
    memset(t->amplitude, 0, (size_t)windows * sizeof *t->amplitude);
    memset(t->energy, 0, (size_t)windows * sizeof *t->energy);
    for (int wire = 0; wire < t->wires; wire++)
        add_compared(t->profiles + wire * columns, columns, t->kernels + wire * n, n, t->running, t->amplitude,
                     t->energy);
    correlate(t->amplitude, t->energy, windows, t->wires * n * FLOOR_GREY * FLOOR_GREY, t->score);
}

static inline int sign_of(double x) { return (x > 0.0) - (x < 0.0); }

peak find_peak(const task *t, int first, double range, double steepness, double height_of, double overlap)
{
    int across = 1, n = t->wires * (2 * t->near + 1);
    double best = -1.0;
    /* the outermost windows only serve the parabola */
    for (int k = 1; k < 2 * t->far; k++) {
        double value = fabs(STEP_PX * (k - t->far)) <= range + STEP_PX ? t->score[first + k] : -1.0;
        if (value > best) {
            best = value;
            across = k;
        }
    }
    int at = first + across;
    double height = t->amplitude[at], here = t->score[at];
    double before = sign_of(t->amplitude[at - 1]) == sign_of(height) ? t->score[at - 1] : 0.0;
    double after = sign_of(t->amplitude[at + 1]) == sign_of(height) ? t->score[at + 1] : 0.0;
    double bend = before - 2.0 * here + after, size = fabs(height), power = t->energy[at] - size * size;
    peak found;
    found.position = here >= before && here >= after && bend < 0.0 ? across + 0.5 * (before - after) / bend : NAN;
    found.noise = sqrt((power > 0.0 ? power : 0.0) / (n - 3 * t->wires) + ROUNDING_GREY * ROUNDING_GREY);
    found.snr = size / (found.noise * sqrt(CORRELATED * overlap));
    found.sigma = 1.0 / fmax(found.snr * steepness, 1e-6);
    found.likeness = here;
    found.contrast = height * height_of;
    return found;
}

double uneven_noise(task *t, double first)
{
    int n = 2 * t->near + 1, columns = 2 * (t->reach + t->near) + 1, all = t->wires * n;
    double along = 0.0, norm = 0.0, sum = 0.0;
    /* the windows, then the kernels' slopes, in order across the curve */
    double *windows = t->rest, *turned = t->rest + all, *rest = t->rest + 2 * all;
    for (int k = 0; k < t->wires; k++) {
        const double *profile = t->profiles + t->order[k] * columns;
        for (int j = 0; j < n; j++) {
            double place = first + j;
            int column = place > 0.0 ? (place < columns - 1 ? (int)place : columns - 1) : 0;
            windows[k * n + j] = profile[column];
        }
        level(windows + k * n, n, 1);
        const double *slopes = t->slopes + t->order[k] * n;
        double tilt = 0.0, steps = 0.0;
        for (int j = 0; j < n; j++) {
            turned[k * n + j] = slopes[j];
            tilt += (j - n / 2) * turned[k * n + j];
            steps += (double)(j - n / 2) * (j - n / 2);
        }
        for (int j = 0; j < n; j++)
            turned[k * n + j] -= tilt / steps * (j - n / 2);
    }
    for (int k = 0; k < all; k++) {
        rest[k] = 0.5 * (windows[k] - windows[all - 1 - k]);
        norm += turned[k] * turned[k];
    }
    norm = sqrt(norm);
    /* a fraction of a step between window and wire looks like the kernel's slope, and is no noise */
    for (int k = 0; k < all; k++) {
        turned[k] /= norm;
        along += rest[k] * turned[k];
    }
    for (int k = 0; k < all; k++) {
        double left = rest[k] - along * turned[k];
        sum += left * left;
    }
    int freedom = t->wires * (n / 2) - t->wires - 1;
    return sum / (freedom > 1 ? freedom : 1);
}

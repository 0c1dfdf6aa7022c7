/* Where wires lie across a curve, block by block: see sagnode.match.localise.localise_beside, which says what it means
   and does the same in NumPy. Names of parts are those of the functions there and in sagnode.match.kernels. */
#include "closer.h"
#include "profile.h"
#include "wire.h"
#include <string.h>

#define FLOOR_GREY 0.2
#define BESIDE_SAMPLES 6
#define SHARING 1.05
#define SYMMETRIC_PX 0.2
#define CORRELATED 2.7
/* Farthest that a ribbon may reach, in steps, and most sub-conductors: far beyond what is ever asked for. */
#define MOST_STEPS 20000
#define MOST_WIRES 64

/* What is asked, and what of it holds for all blocks. */
typedef struct {
    scene image;
    array pixels, normal, width, range, members, starts, centres;
    Py_ssize_t samples, blocks, shifts;
    int wires, near, far, reach, every, exact;
    double blur, margin;
    /* per block: means over its samples */
    double *widths, *ranges, *middles; /* (M,), (M,), (m, M) */
    int *order;                        /* of the sub-conductors across the curve (m,) */
    int symmetric;
    /* for one block at a time */
    float *sums;                                /* (K,) */
    double *profiles, *kernels, *slopes;        /* (m, K), (m, n), (m, n) */
    double *amplitude, *energy, *score; /* (K,) each */
    double *running, *rest;             /* 3 (K + 1,), 5 (m, n) */
    double norm;                        /* of the kernels, were they of height 1 */
} task;

/* What its peak says about one block at one place. */
typedef struct {
    double position, sigma, snr, likeness, contrast, noise;
} peak;

static inline double real(const array *of, Py_ssize_t i) { return *(const double *)(of->at + i * of->step[0]); }
static inline double part(const array *of, Py_ssize_t i, Py_ssize_t j)
{
    return *(const double *)(of->at + i * of->step[0] + j * of->step[1]);
}
static inline Py_ssize_t whole(const array *of, Py_ssize_t i) { return ((const int64_t *)of->at)[i]; }
static inline Py_ssize_t end_of(const task *t, Py_ssize_t block)
{
    return block + 1 < t->blocks ? whole(&t->starts, block + 1) : t->samples;
}

/* A sample of one of the wires, px; of the centre line where `wire` is negative. */
static inline void sample(const task *t, int wire, Py_ssize_t i, double *u, double *v)
{
    double aside = t->wires > 1 && wire >= 0 ? part(&t->members, wire, i) : 0.0;
    *u = part(&t->pixels, i, 0) + aside * part(&t->normal, i, 0);
    *v = part(&t->pixels, i, 1) + aside * part(&t->normal, i, 1);
}

/* ---- profiles ---- */

static void add_steps(task *t, double u, double v, double nu, double nv, int first, int count)
{
    int wide = t->reach + t->near;
    double du = STEP_PX * nu, dv = STEP_PX * nv;
    add_samples(&t->image, u + first * du, v + first * dv, du, dv, count, t->sums + wide + first);
}

/* Mean profile (K,) of one block across one wire; its outer parts are sampled more sparsely. */
static void block_profile(task *t, int wire, Py_ssize_t block, double *profile)
{
    int wide = t->reach + t->near, narrow = t->far + t->near, columns = 2 * wide + 1;
    Py_ssize_t start = whole(&t->starts, block), end = end_of(t, block), sparse = 0;
    memset(t->sums, 0, (size_t)columns * sizeof *t->sums);
    for (Py_ssize_t i = start; i < end; i++) {
        double u, v, nu = part(&t->normal, i, 0), nv = part(&t->normal, i, 1);
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

/* ---- kernels ---- */

/* Slope of values (n,) as numpy.gradient has it. */
static void gradient(const double *values, int n, double *out)
{
    for (int k = 1; k < n - 1; k++)
        out[k] = (values[k + 1] - values[k - 1]) / 2.0;
    out[0] = values[1] - values[0];
    out[n - 1] = values[n - 1] - values[n - 2];
}

/* Kernels (m, n) and their slopes for one block. */
static void block_kernels(task *t, Py_ssize_t block)
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

/* By how much what the sub-conductors' windows share makes the offset's variance worse. */
static double shared_noise(const task *t, Py_ssize_t block)
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

/* ---- comparison ---- */

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

static inline int sign_of(double x) { return (x > 0.0) - (x < 0.0); }

/* The best window about a place, `first` being the first of its 2 far + 1. */
static peak find_peak(const task *t, int first, double range, double steepness, double height_of, double overlap)
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

/* Mean square of what of a block is not the same on both sides; the windows begin at the column `first`. */
static double uneven_noise(task *t, double first)
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

/* ---- in the frame ---- */

static int seen_at(const task *t, int wire, Py_ssize_t i, double aside)
{
    double u, v;
    sample(t, wire, i, &u, &v);
    u += aside * part(&t->normal, i, 0);
    v += aside * part(&t->normal, i, 1);
    return u >= 0.0 && u <= t->image.width - 1 && v >= 0.0 && v <= t->image.height - 1;
}

/* Whether all windows of a block about a place lie wholly in the frame. */
static int block_seen(const task *t, Py_ssize_t block, Py_ssize_t centre)
{
    int narrow = t->far + t->near;
    Py_ssize_t ends[2] = {whole(&t->starts, block), end_of(t, block) - 1};
    for (int wire = 0; wire < t->wires; wire++)
        for (int k = 0; k < 4; k++)
            if (!seen_at(t, wire, ends[k & 1], STEP_PX * (double)(centre + (k & 2 ? narrow : -narrow))))
                return 0;
    return 1;
}

/* ---- the whole ---- */

static int by_place(task *t)
{
    double *mean = PyMem_Malloc((size_t)t->wires * sizeof *mean);
    if (mean == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    for (int wire = 0; wire < t->wires; wire++) {
        mean[wire] = 0.0;
        for (Py_ssize_t b = 0; b < t->blocks; b++)
            mean[wire] += t->middles[wire * t->blocks + b];
        int k = wire;
        for (; k > 0 && mean[t->order[k - 1]] > mean[wire]; k--)
            t->order[k] = t->order[k - 1];
        t->order[k] = wire;
    }
    PyMem_Free(mean);
    t->symmetric = 1;
    for (int k = 0; k < t->wires; k++)
        for (Py_ssize_t b = 0; b < t->blocks; b++) {
            double here = t->middles[t->order[k] * t->blocks + b];
            double there = -t->middles[t->order[t->wires - 1 - k] * t->blocks + b];
            t->symmetric &= fabs(here - there) <= SYMMETRIC_PX + 1e-5 * fabs(there);
        }
    return 0;
}

/* Means over the blocks, and the sizes that follow from them; -1 with a Python error set. */
static int prepare(task *t)
{
    double widest = 0.0, farthest = 0.0;
    Py_ssize_t shortest = t->samples, reach = 0;
    for (Py_ssize_t b = 0; b < t->blocks; b++) {
        Py_ssize_t start = whole(&t->starts, b), end = end_of(t, b);
        double width = 0.0, range = 0.0;
        for (Py_ssize_t i = start; i < end; i++) {
            double own = real(&t->range, i);
            width += real(&t->width, i);
            range += own;
            farthest = own > farthest ? own : farthest;
        }
        t->widths[b] = width / (double)(end - start);
        t->ranges[b] = range / (double)(end - start);
        for (int wire = 0; wire < t->wires; wire++) {
            double sum = 0.0;
            for (Py_ssize_t i = start; i < end; i++)
                sum += part(&t->members, wire, i);
            t->middles[wire * t->blocks + b] = sum / (double)(end - start);
        }
        widest = t->widths[b] > widest ? t->widths[b] : widest;
        shortest = end - start < shortest ? end - start : shortest;
        if (require(isfinite(t->widths[b]) && isfinite(t->ranges[b]), "width and half range: finite values are wanted"))
            return -1;
    }
    for (Py_ssize_t s = 0; s < t->shifts; s++) {
        Py_ssize_t centre = whole(&t->centres, s);
        if (require(centre > -MOST_STEPS && centre < MOST_STEPS, "a shift reaches too far") < 0)
            return -1;
        reach = centre > reach ? centre : -centre > reach ? -centre : reach;
    }
    double near = ceil((0.5 * widest + 1.5 * t->blur + t->margin) / STEP_PX), far = ceil(farthest / STEP_PX) + 1.0;
    if (require(near >= 2.0 && near < MOST_STEPS && far >= 1.0 && far < MOST_STEPS,
                "width, half range, blur and margin: out of range") < 0)
        return -1;
    t->near = (int)near;
    t->far = (int)far;
    t->reach = (int)reach + t->far;
    Py_ssize_t dense = t->samples / t->blocks / BESIDE_SAMPLES;
    /* no fewer than one sample a block, the shortest included */
    dense = dense < shortest ? dense : shortest;
    t->every = dense > 1 ? (int)dense : 1;
    return by_place(t);
}

static int allocate(void **out, Py_ssize_t count, size_t size)
{
    *out = PyMem_Malloc((size_t)count * size);
    if (*out != NULL)
        return 0;
    PyErr_NoMemory();
    return -1;
}

static int ask(arrays *all, PyObject *const *words, task *t)
{
    if (take_scene(all, words[0], &t->image) < 0 || take(all, words[1], "pixels", 'd', 2, 0, 0, &t->pixels) < 0 ||
        take(all, words[2], "normal", 'd', 2, 0, 0, &t->normal) < 0 ||
        take(all, words[3], "width", 'd', 1, 0, 0, &t->width) < 0 ||
        take(all, words[4], "half_range", 'd', 1, 0, 0, &t->range) < 0 ||
        take(all, words[5], "members", 'd', 2, 0, 0, &t->members) < 0 ||
        take(all, words[6], "starts", 'l', 1, 1, 0, &t->starts) < 0 ||
        take(all, words[7], "centres", 'l', 1, 1, 0, &t->centres) < 0)
        return -1;
    t->samples = t->pixels.shape[0];
    t->blocks = t->starts.shape[0];
    t->shifts = t->centres.shape[0];
    if (require(t->pixels.shape[1] == 2 && t->normal.shape[0] == t->samples && t->normal.shape[1] == 2 &&
                    t->width.shape[0] == t->samples && t->range.shape[0] == t->samples &&
                    t->members.shape[1] == t->samples,
                "pixels, normal, width, half_range and members differ in length") < 0 ||
        require(t->members.shape[0] >= 1 && t->members.shape[0] <= MOST_WIRES, "members: 1 to 64 are wanted") < 0 ||
        require(t->shifts >= 1 && t->blocks >= 1, "centres and starts: at least one each is wanted") < 0)
        return -1;
    t->wires = (int)t->members.shape[0];
    for (Py_ssize_t b = 0; b < t->blocks; b++)
        if (require(whole(&t->starts, b) >= 0 && whole(&t->starts, b) < end_of(t, b) && end_of(t, b) <= t->samples,
                    "starts: must rise within the samples") < 0)
            return -1;
    return 0;
}

/* Fill blocks (5, M): offset, sigma, snr, correlation, contrast; and for all places snr, validity and being centred. */
static void measure(task *t, double *blocks, uint8_t *valid, double *beside, uint8_t *inside)
{
    int n = 2 * t->near + 1, columns = 2 * (t->reach + t->near) + 1, windows = columns - n + 1;
    Py_ssize_t count = t->blocks;
    double *offset = blocks, *sigma = blocks + count, *snr = sigma + count, *likeness = snr + count;
    double *contrast = likeness + count;
    looks all = looks_in(contrast + count, count);
    for (Py_ssize_t b = 0; b < count; b++) {
        double steepest = 0.0, least = INFINITY, most = -INFINITY;
        block_kernels(t, b);
        memset(t->amplitude, 0, (size_t)windows * sizeof *t->amplitude);
        memset(t->energy, 0, (size_t)windows * sizeof *t->energy);
        for (int wire = 0; wire < t->wires; wire++) {
            double *profile = t->profiles + wire * columns;
            block_profile(t, wire, b, profile);
            add_compared(profile, columns, t->kernels + wire * n, n, t->running, t->amplitude, t->energy);
        }
        correlate(t->amplitude, t->energy, windows, t->wires * n * FLOOR_GREY * FLOOR_GREY, t->score);
        for (int k = 0; k < t->wires * n; k++) {
            double slope = t->slopes[k] / STEP_PX;
            steepest += slope * slope;
            least = t->kernels[k] < least ? t->kernels[k] : least;
            most = t->kernels[k] > most ? t->kernels[k] : most;
        }
        double overlap = shared_noise(t, b), steepness = sqrt(steepest);
        Py_ssize_t start = whole(&t->starts, b), middle = start + (end_of(t, b) - start) / 2;
        for (Py_ssize_t s = 0; s < t->shifts; s++) {
            Py_ssize_t centre = whole(&t->centres, s);
            int first = t->reach + (int)centre - t->far;
            peak found = find_peak(t, first, t->ranges[b], steepness, most - least, overlap);
            double away = STEP_PX * (found.position - t->far);
            int good = block_seen(t, b, centre) && isfinite(away) && fabs(away) <= t->ranges[b];
            if (s > 0) {
                beside[(s - 1) * count + b] = good ? found.snr : 0.0;
                inside[(s - 1) * count + b] = (uint8_t)seen_at(t, -1, middle, STEP_PX * (double)centre);
                continue;
            }
            valid[b] = (uint8_t)good;
            offset[b] = away;
            snr[b] = good ? found.snr : 0.0;
            likeness[b] = good ? found.likeness : 0.0;
            contrast[b] = good ? found.contrast : 0.0;
            /* where the window has no summit, its noise is not known, but its neighbours count it all the same */
            int summit = isfinite(found.position);
            all.sigma[b] = found.sigma;
            all.noise[b] = found.noise;
            all.uneven[b] = uneven_noise(t, summit ? rint(first + found.position) : 0.0);
            all.height[b] = found.contrast / ((most - least) * t->norm);
            /* where windows share pixels, the noise of one side is in the other too */
            all.alike[b] = t->symmetric && overlap < SHARING && summit;
            all.correlated[b] = sqrt(CORRELATED * overlap);
            profiles about = {t->profiles, columns, t->wires, t->order, t->middles + b, count, t->widths[b]};
            look_closer(&about, summit && t->exact ? t->near + first + found.position : NAN, t->margin, t->near, t->rest, &all, b);
        }
    }
    settle(&all, count, offset, sigma);
    for (Py_ssize_t b = 0; b < count; b++)
        if (!valid[b])
            offset[b] = sigma[b] = NAN;
}

PyObject *localise(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    task t = {0};
    array blocks, valid, beside, inside;
    PyObject *result = NULL;
    (void)module;
    if (require(count == 15, "localise takes fifteen arguments") < 0)
        return NULL;
    t.blur = PyFloat_AsDouble(words[8]);
    t.margin = PyFloat_AsDouble(words[9]);
    t.exact = PyObject_IsTrue(words[10]);
    if (PyErr_Occurred())
        return NULL;
    if (ask(&all, words, &t) < 0 || take(&all, words[11], "blocks", 'd', 2, 1, 1, &blocks) < 0 ||
        take(&all, words[12], "valid", '?', 1, 1, 1, &valid) < 0 ||
        take(&all, words[13], "beside", 'd', 2, 1, 1, &beside) < 0 ||
        take(&all, words[14], "inside", '?', 2, 1, 1, &inside) < 0 ||
        require(blocks.shape[0] == 5 + LOOKS && blocks.shape[1] == t.blocks && valid.shape[0] == t.blocks &&
                    beside.shape[0] == t.shifts - 1 && beside.shape[1] == t.blocks &&
                    inside.shape[0] == t.shifts - 1 && inside.shape[1] == t.blocks,
                "blocks, valid, beside and inside do not fit starts and centres") < 0)
        goto done;
    if (allocate((void **)&t.widths, (2 + t.wires) * t.blocks, sizeof(double)) < 0 ||
        allocate((void **)&t.order, t.wires, sizeof(int)) < 0)
        goto done;
    t.ranges = t.widths + t.blocks;
    t.middles = t.ranges + t.blocks;
    if (prepare(&t) < 0)
        goto done;
    Py_ssize_t n = 2 * t.near + 1, columns = 2 * (t.reach + t.near) + 1;
    if (allocate((void **)&t.sums, columns, sizeof(float)) < 0 ||
        allocate((void **)&t.profiles, (t.wires + 6) * columns + 3 + 7 * t.wires * n, sizeof(double)) < 0)
        goto done;
    t.amplitude = t.profiles + t.wires * columns;
    t.energy = t.amplitude + columns;
    t.score = t.energy + columns;
    t.running = t.score + columns;
    t.kernels = t.running + 3 * (columns + 1);
    t.slopes = t.kernels + t.wires * n;
    t.rest = t.slopes + t.wires * n;
    measure(&t, (double *)blocks.at, (uint8_t *)valid.at, (double *)beside.at, (uint8_t *)inside.at);
    result = Py_None;
    Py_INCREF(result);
done:
    PyMem_Free(t.widths);
    PyMem_Free(t.order);
    PyMem_Free(t.sums);
    PyMem_Free(t.profiles);
    release(&all);
    return result;
}

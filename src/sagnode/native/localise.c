/* Where wires lie across a curve, block by block: see sagnode.match.localise.localise_beside, which says what it means.
   What is asked is checked here, and what the blocks show is put together as sagnode.match.across has it in NumPy. */
#include "across.h"
#include "closer.h"

#define BESIDE_SAMPLES 6
#define SHARING 1.05
#define SYMMETRIC_PX 0.2
/* Farthest that a ribbon may reach, in steps, and most sub-conductors: far beyond what is ever asked for. */
#define MOST_STEPS 20000
#define MOST_WIRES 64

static int seen_at(const task *t, int wire, Py_ssize_t i, double aside)
{
    double u, v;
    sample(t, wire, i, &u, &v);
    u += aside * number2(&t->normal, i, 0);
    v += aside * number2(&t->normal, i, 1);
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

/* The order of the sub-conductors across the curve, and whether they are symmetric; -1 with a Python error set. */
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
            double own = number(&t->range, i);
            width += number(&t->width, i);
            range += own;
            farthest = own > farthest ? own : farthest;
        }
        t->widths[b] = width / (double)(end - start);
        t->ranges[b] = range / (double)(end - start);
        for (int wire = 0; wire < t->wires; wire++) {
            double sum = 0.0;
            for (Py_ssize_t i = start; i < end; i++)
                sum += number2(&t->members, wire, i);
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

/* Read and check what is looked at, the first eight arguments; -1 with a Python error set. */
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
    int n = 2 * t->near + 1, columns = 2 * (t->reach + t->near) + 1;
    Py_ssize_t count = t->blocks;
    double *offset = blocks, *sigma = blocks + count, *snr = sigma + count, *likeness = snr + count;
    double *contrast = likeness + count;
    looks all = looks_in(contrast + count, count);
    for (Py_ssize_t b = 0; b < count; b++) {
        double steepest = 0.0, least = INFINITY, most = -INFINITY;
        block_kernels(t, b);
        for (int wire = 0; wire < t->wires; wire++)
            block_profile(t, wire, b, t->profiles + wire * columns);
        compare(t);
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
            double column = summit && t->exact ? t->near + first + found.position : NAN;
            look_closer(&about, column, t->margin, t->near, t->rest, &all, b);
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

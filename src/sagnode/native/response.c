/* The polarity-agnostic response of lines across curves: see sagnode.match.ribbon.pooled_response, which says what it
   means and does the same in NumPy. Grey values are bilinear on a grid of 1/32 px and whole, as OpenCV's remap has
   them, so that both give the same numbers. */
#include "kernels.h"
#include <math.h>
#include <string.h>

enum { CHUNK = 64, CLIP = 24, MOST_STEPS = 16 };

typedef struct {
    const uint8_t *at;
    Py_ssize_t row;
    int width, height;
} picture;

/* Where on a line of the grid a coordinate is read: its first pixel, and the weight of the second one in 1/32. */
static inline void place(float x, int end, int *first, int *weight)
{
    /* a comparison with NaN is false, which puts it at the edge */
    float within = x > 0.0f ? x : 0.0f;
    float last = (float)(end - 1);
    within = within < last ? within : last;
    /* rounded to even: the sum's last digit is 1 */
    union { float number; int32_t bits; } sum = {within * 32.0f + 12582912.0f};
    int fine = sum.bits - 0x4B400000;
    int whole = fine >> 5;
    whole = whole < end - 2 ? whole : end - 2;
    *first = whole;
    *weight = fine - 32 * whole;
}

/* Bilinear grey values of a chunk of coordinates; a picture has at least two rows and columns. */
static inline void grey(const picture *image, const float *u, const float *v, int count, int16_t *out)
{
    int32_t offset[CHUNK];
    int16_t right[CHUNK], below[CHUNK], upper[CHUNK], lower[CHUNK];
    for (int k = 0; k < count; k++) {
        int column, line, across, down;
        place(u[k], image->width, &column, &across);
        place(v[k], image->height, &line, &down);
        offset[k] = (int32_t)(line * image->row + column);
        right[k] = (int16_t)across;
        below[k] = (int16_t)down;
    }
    for (int k = 0; k < count; k++) {
        const uint8_t *p = image->at + offset[k], *q = p + image->row;
        upper[k] = (int16_t)(p[0] | p[1] << 8);
        lower[k] = (int16_t)(q[0] | q[1] << 8);
    }
    for (int k = 0; k < count; k++) {
        int16_t a = upper[k] & 255, b = (int16_t)((uint16_t)upper[k] >> 8);
        int16_t c = lower[k] & 255, d = (int16_t)((uint16_t)lower[k] >> 8);
        int16_t left = 32 - right[k], above = 32 - below[k];
        int16_t top = a * left + b * right[k], bottom = c * left + d * right[k];
        out[k] = (int16_t)(((int32_t)top * above + (int32_t)bottom * below[k] + 512) >> 10);
    }
}

static inline int16_t least(int16_t a, int16_t b) { return a < b ? a : b; }
static inline int16_t most(int16_t a, int16_t b) { return a > b ? a : b; }

/* Best pooled response of a chunk of samples. */
FOR_EACH_PROCESSOR
static void respond(const picture *image, const float *u, const float *v, const float *nu, const float *nv,
                    const float *places, const float *sides, int lines, const float *band, Py_ssize_t band_step,
                    int bands, int count, int16_t *best)
{
    float at_u[CHUNK], at_v[CHUNK], side_u[CHUNK], side_v[CHUNK];
    int16_t centre[CHUNK], left[CHUNK], right[CHUNK], total[CHUNK];
    for (int k = 0; k < count; k++)
        best[k] = -CLIP;
    for (int b = 0; b < bands; b++) {
        float shift = *(const float *)((const char *)band + b * band_step);
        for (int k = 0; k < count; k++)
            total[k] = 0;
        for (int line = 0; line < lines; line++) {
            const float *middle = places + line * CHUNK, *side = sides + line * CHUNK;
            for (int k = 0; k < count; k++) {
                float away = middle[k] + shift;
                at_u[k] = u[k] + away * nu[k];
                at_v[k] = v[k] + away * nv[k];
            }
            grey(image, at_u, at_v, count, centre);
            for (int k = 0; k < count; k++) {
                side_u[k] = at_u[k] - side[k] * nu[k];
                side_v[k] = at_v[k] - side[k] * nv[k];
            }
            grey(image, side_u, side_v, count, left);
            for (int k = 0; k < count; k++) {
                side_u[k] = at_u[k] + side[k] * nu[k];
                side_v[k] = at_v[k] + side[k] * nv[k];
            }
            grey(image, side_u, side_v, count, right);
            for (int k = 0; k < count; k++) {
                int16_t dark = least(left[k], right[k]) - centre[k];
                int16_t bright = centre[k] - most(left[k], right[k]);
                int16_t better = most(dark, bright);
                total[k] += most(least(better, CLIP), -CLIP);
            }
        }
        if (lines > 1)
            for (int k = 0; k < count; k++) {
                /* rounded down, as Python does */
                int sum = total[k];
                int quotient = sum / lines;
                total[k] = (int16_t)(quotient - (sum % lines != 0 && sum < 0));
            }
        for (int k = 0; k < count; k++)
            best[k] = most(best[k], total[k]);
    }
}

/* The same for one line whose middle is the sample and whose sides are `away` steps of the band from there, where the
   band's places are one step apart: each place's sides are among the other places. */
FOR_EACH_PROCESSOR
static void respond_in_steps(const picture *image, const float *u, const float *v, const float *nu, const float *nv,
                             float first, float step, int bands, int away, int count, int16_t *best)
{
    int16_t profile[MOST_STEPS][CHUNK];
    float at_u[CHUNK], at_v[CHUNK];
    for (int j = 0; j < bands + 2 * away; j++) {
        float across = first + (float)(j - away) * step;
        for (int k = 0; k < count; k++) {
            at_u[k] = u[k] + across * nu[k];
            at_v[k] = v[k] + across * nv[k];
        }
        grey(image, at_u, at_v, count, profile[j]);
    }
    for (int k = 0; k < count; k++)
        best[k] = -CLIP;
    for (int b = 0; b < bands; b++) {
        const int16_t *left = profile[b], *centre = profile[b + away], *right = profile[b + 2 * away];
        for (int k = 0; k < count; k++) {
            int16_t dark = least(left[k], right[k]) - centre[k];
            int16_t bright = centre[k] - most(left[k], right[k]);
            best[k] = most(best[k], least(most(dark, bright), CLIP));
        }
    }
}

/* What both functions are asked with. */
typedef struct {
    picture image;
    array u, v, nu, nv, places, sides, band;
    float reach; /* farthest that a band goes */
} question;

static int ask(arrays *all, PyObject *const *words, question *q)
{
    array image;
    if (take(all, words[0], "image", 'B', 2, 0, 0, &image) < 0 || take(all, words[1], "u", 'f', 2, 0, 0, &q->u) < 0 ||
        take(all, words[2], "v", 'f', 2, 0, 0, &q->v) < 0 || take(all, words[3], "nu", 'f', 2, 0, 0, &q->nu) < 0 ||
        take(all, words[4], "nv", 'f', 2, 0, 0, &q->nv) < 0 ||
        take(all, words[5], "places", 'f', 3, 0, 0, &q->places) < 0 ||
        take(all, words[6], "sides", 'f', 3, 0, 0, &q->sides) < 0 ||
        take(all, words[7], "band", 'f', 2, 0, 0, &q->band) < 0)
        return -1;
    Py_ssize_t rows = q->u.shape[0], columns = q->u.shape[1];
    const array *same[] = {&q->v, &q->nu, &q->nv};
    for (int k = 0; k < 3; k++)
        if (require(same[k]->shape[0] == rows && same[k]->shape[1] == columns, "u, v, nu and nv differ in shape") < 0)
            return -1;
    const array *lines[] = {&q->places, &q->sides};
    for (int k = 0; k < 2; k++)
        if (require(lines[k]->shape[0] == q->places.shape[0] && lines[k]->shape[0] <= 16 &&
                        (lines[k]->shape[1] == rows || lines[k]->shape[1] == 1) &&
                        (lines[k]->shape[2] == columns || lines[k]->shape[2] == 1),
                    "places and sides do not fit u") < 0)
            return -1;
    if (require(q->band.shape[1] == rows || q->band.shape[1] == 1, "band does not fit u") < 0 ||
        require(image.step[1] == 1 && image.shape[0] >= 2 && image.shape[1] >= 2 && image.shape[0] < (1 << 15) &&
                    image.shape[1] < (1 << 15) && image.step[0] >= image.shape[1],
                "image: rows of 2 to 32767 pixels are wanted") < 0)
        return -1;
    q->image = (picture){(const uint8_t *)image.at, image.step[0], (int)image.shape[1], (int)image.shape[0]};
    return 0;
}

/* Where an axis of length 1 stands for all. */
static Py_ssize_t along(const array *of, int axis) { return of->shape[axis] == 1 ? 0 : of->step[axis]; }

/* How many steps of the band the sides of all samples of a chunk are from their middles; 0 where that does not hold. */
FOR_EACH_PROCESSOR
static int steps_away(const question *q, const float *band, int lines, const float *places, const float *sides, int count)
{
    int bands = (int)q->band.shape[0], apart = 0;
    if (lines != 1 || bands < 3)
        return 0;
    const char *at = (const char *)band;
    float first = *band, step = *(const float *)(at + q->band.step[0]) - first;
    for (int b = 2; b < bands; b++)
        if (!(fabsf(*(const float *)(at + b * q->band.step[0]) - first - (float)b * step) < 1e-4f))
            return 0;
    float steps = step > 0 ? sides[0] / step : 0.0f;
    if (!(steps > 0.5f && steps < (float)(MOST_STEPS - bands) / 2))
        return 0;
    int away = (int)(steps + 0.5f);
    if (bands + 2 * away > MOST_STEPS)
        return 0;
    for (int k = 0; k < count; k++)
        apart |= (places[k] != 0.0f) | !(fabsf(sides[k] - (float)away * step) < 1e-4f);
    return apart ? 0 : away;
}

/* Which of a chunk's samples, all that is looked at about them reaching so far, are in the frame; whether any is. */
FOR_EACH_PROCESSOR
static int in_frame(const picture *image, const float *u, const float *v, const float *nu, const float *nv,
                    const float *outer, int count, uint8_t *seen)
{
    float right = (float)(image->width - 1), bottom = (float)(image->height - 1);
    int any = 0;
    for (int k = 0; k < count; k++) {
        float across = fabsf(outer[k] * nu[k]), down = fabsf(outer[k] * nv[k]);
        int within = (u[k] >= across) & (u[k] + across <= right) & (v[k] >= down) & (v[k] + down <= bottom);
        seen[k] = (uint8_t)within;
        any |= within;
    }
    return any;
}

/* Elements of a row from column `start`: where they are, if nothing is between them, else copied into `room`. */
static const float *row(const array *of, Py_ssize_t i, Py_ssize_t start, int count, float *room)
{
    const char *at = of->at + i * of->step[0] + start * of->step[1];
    if (of->step[1] == sizeof(float))
        return (const float *)at;
    for (int k = 0; k < count; k++)
        room[k] = *(const float *)(at + k * of->step[1]);
    return room;
}

/* Responses of one row's chunk from column `start`, and which of its samples are in the frame with all their sides. */
static void chunk(const question *q, Py_ssize_t i, Py_ssize_t start, int count, int16_t *best, uint8_t *seen)
{
    float room[4][CHUNK], places[16 * CHUNK], sides[16 * CHUNK], outer[CHUNK];
    int lines = (int)q->places.shape[0];
    const float *u = row(&q->u, i, start, count, room[0]), *v = row(&q->v, i, start, count, room[1]);
    const float *nu = row(&q->nu, i, start, count, room[2]), *nv = row(&q->nv, i, start, count, room[3]);
    memset(outer, 0, sizeof outer);
    Py_ssize_t place_row = i * along(&q->places, 1), side_row = i * along(&q->sides, 1);
    Py_ssize_t place_step = along(&q->places, 2), side_step = along(&q->sides, 2);
    for (int line = 0; line < lines; line++) {
        const char *middle = q->places.at + line * q->places.step[0] + place_row + start * place_step;
        const char *side = q->sides.at + line * q->sides.step[0] + side_row + start * side_step;
        for (int k = 0; k < count; k++) {
            float own = *(const float *)(middle + k * place_step), beside = *(const float *)(side + k * side_step);
            float far = fabsf(own) + beside;
            places[line * CHUNK + k] = own;
            sides[line * CHUNK + k] = beside;
            outer[k] = far > outer[k] ? far : outer[k];
        }
    }
    if (!in_frame(&q->image, u, v, nu, nv, outer, count, seen)) {
        memset(best, 0, (size_t)count * sizeof *best);
        return;
    }
    const float *band = (const float *)(q->band.at + i * along(&q->band, 1));
    int bands = (int)q->band.shape[0], away = steps_away(q, band, lines, places, sides, count);
    if (away > 0) {
        float second = *(const float *)((const char *)band + q->band.step[0]);
        respond_in_steps(&q->image, u, v, nu, nv, band[0], second - band[0], bands, away, count, best);
        return;
    }
    respond(&q->image, u, v, nu, nv, places, sides, lines, band, q->band.step[0], bands, count, best);
}

PyObject *response(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    question q;
    array best, seen;
    (void)module;
    if (require(count == 10, "response takes ten arguments") < 0)
        return NULL;
    if (ask(&all, words, &q) < 0 || take(&all, words[8], "best", 'h', 2, 1, 1, &best) < 0 ||
        take(&all, words[9], "seen", '?', 2, 1, 1, &seen) < 0 ||
        require(best.shape[0] == q.u.shape[0] && best.shape[1] == q.u.shape[1] && seen.shape[0] == q.u.shape[0] &&
                    seen.shape[1] == q.u.shape[1],
                "best and seen differ from u in shape") < 0) {
        release(&all);
        return NULL;
    }
    Py_ssize_t rows = q.u.shape[0], columns = q.u.shape[1];
    for (Py_ssize_t i = 0; i < rows; i++)
        for (Py_ssize_t start = 0; start < columns; start += CHUNK) {
            int some = (int)(columns - start < CHUNK ? columns - start : CHUNK);
            chunk(&q, i, start, some, (int16_t *)best.at + i * columns + start,
                  (uint8_t *)seen.at + i * columns + start);
        }
    release(&all);
    Py_RETURN_NONE;
}

/* Add a chunk's responses in the frame, and their weight. */
FOR_EACH_PROCESSOR
static void add(const int16_t *restrict best, const uint8_t *restrict seen, double weight, int count,
                double *restrict sum, double *restrict within)
{
    for (int k = 0; k < count; k++) {
        double counted = seen[k] ? weight : 0.0;
        sum[k] += counted * best[k];
        within[k] += counted;
    }
}

PyObject *response_sums(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    question q;
    array weight, total, weights;
    (void)module;
    if (require(count == 11, "response_sums takes eleven arguments") < 0)
        return NULL;
    if (ask(&all, words, &q) < 0 || take(&all, words[8], "weight", 'f', 1, 1, 0, &weight) < 0 ||
        take(&all, words[9], "total", 'd', 1, 1, 1, &total) < 0 ||
        take(&all, words[10], "weights", 'd', 1, 1, 1, &weights) < 0 ||
        require(weight.shape[0] == q.u.shape[0] && total.shape[0] == q.u.shape[1] && weights.shape[0] == q.u.shape[1],
                "weight, total and weights do not fit u") < 0) {
        release(&all);
        return NULL;
    }
    Py_ssize_t rows = q.u.shape[0], columns = q.u.shape[1];
    double *sum = (double *)total.at, *within = (double *)weights.at;
    memset(sum, 0, (size_t)columns * sizeof *sum);
    memset(within, 0, (size_t)columns * sizeof *within);
    int16_t best[CHUNK];
    uint8_t seen[CHUNK];
    for (Py_ssize_t i = 0; i < rows; i++) {
        double own = ((const float *)weight.at)[i];
        for (Py_ssize_t start = 0; start < columns; start += CHUNK) {
            int some = (int)(columns - start < CHUNK ? columns - start : CHUNK);
            chunk(&q, i, start, some, best, seen);
            add(best, seen, own, some, sum + start, within + start);
        }
    }
    release(&all);
    Py_RETURN_NONE;
}

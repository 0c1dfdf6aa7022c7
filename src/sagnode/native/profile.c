/* Grey values across a curve: see sagnode.match.ribbon.straighten and sagnode.match.across, which do the same in NumPy.
   They are bilinear, and summed without being kept. */
#include "profile.h"
#include <math.h>
#include <string.h>

enum { CHUNK = 64 };

/* A row of samples that keeps this far from the last line and column needs no looking after each of them. */
#define MARGIN 0.0625

int take_scene(arrays *all, PyObject *object, scene *out)
{
    array image;
    if (take(all, object, "image", '*', 2, 0, 0, &image) < 0)
        return -1;
    Py_ssize_t size = image.kind == 'f' ? (Py_ssize_t)sizeof(float) : 1;
    if (image.kind != 'B' && image.kind != 'f') {
        PyErr_SetString(PyExc_TypeError, "image: bytes or single precision is wanted");
        return -1;
    }
    if (require(image.shape[0] >= 2 && image.shape[1] >= 2 && image.shape[0] < (1 << 15) && image.shape[1] < (1 << 15),
                "image: 2 to 32767 lines and columns are wanted") < 0 ||
        require(image.step[1] == size && image.step[0] >= image.shape[1] * size && image.step[0] % size == 0 &&
                    image.step[0] / size < 60000,
                "image: lines without gaps are wanted") < 0)
        return -1;
    *out = (scene){image.at, image.kind == 'f', (int)(image.step[0] / size), (int)image.shape[1], (int)image.shape[0]};
    return 0;
}

/* Where a chunk of samples is read: the first of four pixels each, and the shares of the second column and line. */
typedef struct {
    int32_t offset[CHUNK];
    float right[CHUNK], below[CHUNK];
} spots;

/* Samples x + k dx, y + k dy, none of them near an edge; nothing is negative. */
static inline void within(float x, float dx, float y, float dy, int32_t origin, int row, int count, spots *out)
{
    for (int k = 0; k < count; k++) {
        float across = x + (float)k * dx, down = y + (float)k * dy;
        int32_t column = (int32_t)across, line = (int32_t)down;
        out->offset[k] = origin + line * row + column;
        out->right[k] = across - (float)column;
        out->below[k] = down - (float)line;
    }
}

/* The first of two pixels along an axis and the share of the second: the edge goes on beyond the picture. */
static inline int pixel_before(double x, int end, float *share)
{
    /* a comparison with NaN is false, which puts it at the edge */
    double inside = x > 0.0 ? x : 0.0;
    inside = inside < end - 1.0 ? inside : end - 1.0;
    int first = (int)inside;
    first = first < end - 2 ? first : end - 2;
    *share = (float)(inside - first);
    return first;
}

static inline void mixed(const float *a, const float *b, const float *c, const float *d, const spots *at, int count,
                         float *sums)
{
    for (int k = 0; k < count; k++) {
        float upper = a[k] + at->right[k] * (b[k] - a[k]), lower = c[k] + at->right[k] * (d[k] - c[k]);
        sums[k] += upper + at->below[k] * (lower - upper);
    }
}

static inline void gather(const scene *image, const spots *at, int count, float *sums)
{
    float a[CHUNK], b[CHUNK], c[CHUNK], d[CHUNK];
    if (image->single) {
        const float *first = image->at;
        for (int k = 0; k < count; k++) {
            const float *p = first + at->offset[k], *q = p + image->row;
            a[k] = p[0], b[k] = p[1], c[k] = q[0], d[k] = q[1];
        }
    } else {
        const uint8_t *first = image->at;
        uint16_t upper[CHUNK], lower[CHUNK];
        for (int k = 0; k < count; k++) {
            const uint8_t *p = first + at->offset[k], *q = p + image->row;
            upper[k] = (uint16_t)(p[0] | p[1] << 8);
            lower[k] = (uint16_t)(q[0] | q[1] << 8);
        }
        for (int k = 0; k < count; k++) {
            int32_t above = upper[k], below = lower[k];
            a[k] = (float)(above & 255), b[k] = (float)(above >> 8);
            c[k] = (float)(below & 255), d[k] = (float)(below >> 8);
        }
    }
    mixed(a, b, c, d, at, count, sums);
}

FOR_EACH_PROCESSOR
void add_samples(const scene *image, double u, double v, double du, double dv, int count, float *sums)
{
    double end_u = u + (count - 1) * du, end_v = v + (count - 1) * dv;
    double right = image->width - 1 - MARGIN, bottom = image->height - 1 - MARGIN;
    /* no comparison holds with NaN */
    int clear = u >= 0.0 && u < right && end_u >= 0.0 && end_u < right && fabs(du) <= 1.0 && v >= 0.0 && v < bottom &&
                end_v >= 0.0 && end_v < bottom && fabs(dv) <= 1.0;
    /* from a pixel near by, single precision is fine enough */
    int column = clear ? (int)(u < end_u ? u : end_u) : 0, line = clear ? (int)(v < end_v ? v : end_v) : 0;
    float x = (float)(u - column), y = (float)(v - line);
    spots at;
    for (int start = 0; start < count; start += CHUNK) {
        int some = count - start < CHUNK ? count - start : CHUNK;
        if (clear)
            within(x + (float)(start * du), (float)du, y + (float)(start * dv), (float)dv, line * image->row + column,
                   image->row, some, &at);
        else
            for (int k = 0; k < some; k++) {
                int from = pixel_before(v + (start + k) * dv, image->height, &at.below[k]) * image->row;
                at.offset[k] = from + pixel_before(u + (start + k) * du, image->width, &at.right[k]);
            }
        gather(image, &at, some, sums + start);
    }
}

/* A closer look at a wire that was found, and which look is surer: sagnode.match.closer and sagnode.match.surer say what
   it means and do the same in NumPy. */
#include "closer.h"
#include "numbers.h"
#include "wire.h"
#include <stdlib.h>

#define SHARP_BLUR_PX 0.7
#define SHARP_MARGIN_PX 1.0
#define LEAST_REACH 2
#define ROUNDS 2
#define LONGEST_PX 0.5
#define SHORT_PX 0.02
#define FARTHEST_PX 0.75
#define UNEVEN 1.1
#define AROUND 3
#define GAIN_LEAST 0.1
#define GAIN_MOST 2.0
/* So many deviations of the blur beyond its edge a wire shows nothing. */
#define NOTHING 7.0

looks looks_in(double *rows, Py_ssize_t count)
{
    looks all;
    double **parts[LOOKS] = {&all.sigma,      &all.noise,   &all.uneven, &all.height, &all.alike,    &all.correlated,
                             &all.farther, &all.rest, &all.odd,    &all.steepness, &all.reply};
    for (int k = 0; k < LOOKS; k++)
        *parts[k] = rows + k * count;
    return all;
}

/* What all wires show about one of them (n,), and how that changes as they move; both without mean and slope. */
static void shapes(const profiles *about, int wire, int reach, double place, double *shown, double *moved)
{
    double half = half_width(about->width), scale = 1.0 / (SHARP_BLUR_PX * sqrt(2.0));
    int n = 2 * reach + 1;
    for (int k = 0; k < n; k++)
        shown[k] = moved[k] = 0.0;
    for (int other = 0; other < about->wires; other++) {
        double away = about->middles[other * about->apart] - about->middles[wire * about->apart];
        if (other != wire && fabs(away) > STEP_PX * reach + fabs(place) + half + NOTHING * SHARP_BLUR_PX)
            continue;
        for (int k = 0; k < n; k++) {
            double across = STEP_PX * (k - reach) - place - away;
            double before, after;
            shown[k] += 0.5 * (error_function((across + half) * scale, &before) -
                               error_function((across - half) * scale, &after));
            moved[k] -= (before - after) / (SHARP_BLUR_PX * sqrt(2.0 * PI));
        }
    }
    level(shown, n, 1);
    level(moved, n, 1);
}

static double product(const double *one, const double *other, int count)
{
    double sum = 0.0;
    for (int k = 0; k < count; k++)
        sum += one[k] * other[k];
    return sum;
}

void look_closer(const profiles *about, double found, double margin, int most, double *room, looks *all, Py_ssize_t b)
{
    double near = margin < SHARP_MARGIN_PX ? margin : SHARP_MARGIN_PX;
    double asked = ceil((0.5 * about->width + 1.5 * SHARP_BLUR_PX + near) / STEP_PX);
    int reach = (int)clipped(asked, LEAST_REACH, most), n = 2 * reach + 1;
    int wires = about->wires, count = wires * n, lost = !isfinite(found);
    double *seen = room, *moving = seen + count, *shown = moving + count, *moved = shown + count, *rest = moved + count;
    all->farther[b] = NAN;
    all->rest[b] = all->odd[b] = all->steepness[b] = all->reply[b] = 0.0;
    if (lost)
        return;
    int middle = (int)rint(found), last = about->columns - 1;
    for (int wire = 0; wire < wires; wire++) {
        const double *profile = about->at + (Py_ssize_t)wire * about->columns;
        for (int k = 0; k < n; k++) {
            int column = middle + k - reach;
            int here = column < 0 ? 0 : column > last ? last : column;
            int before = column < 1 ? 0 : column > last + 1 ? last : column - 1;
            int after = column < -1 ? 0 : column > last - 1 ? last : column + 1;
            seen[wire * n + k] = profile[here];
            moving[wire * n + k] = (profile[after] - profile[before]) / (2 * STEP_PX);
        }
        level(seen + wire * n, n, 1);
    }
    double start = STEP_PX * (found - middle), place = start, height = 0.0, turn = 0.0, alone = 0.0;
    for (int round = 0; round < ROUNDS; round++) {
        for (int wire = 0; wire < wires; wire++)
            shapes(about, wire, reach, place, shown + wire * n, moved + wire * n);
        double square = product(shown, shown, count), share = product(shown, moved, count) / square;
        for (int k = 0; k < count; k++)
            moved[k] -= share * shown[k];
        alone = product(moved, moved, count);
        height = product(shown, seen, count) / square;
        turn = product(moved, seen, count) / alone;
        double step = clipped(turn / height, -LONGEST_PX, LONGEST_PX);
        place += step;
        if (fabs(step) < SHORT_PX)
            break;
    }
    for (int k = 0; k < count; k++) {
        rest[k] = seen[k] - height * shown[k] - turn * moved[k];
        if (!isfinite(rest[k]))
            return;
    }
    double odd = 0.0;
    for (int wire = 0; wire < wires; wire++) {
        const double *one = rest + about->order[wire] * n, *other = rest + about->order[wires - 1 - wire] * n;
        for (int k = 0; k < n; k++)
            odd += 0.25 * (one[k] - other[n - 1 - k]) * (one[k] - other[n - 1 - k]);
    }
    int freedom = wires * reach - wires - 1;
    all->farther[b] = fabs(place - start) <= FARTHEST_PX ? place - start : NAN;
    all->rest[b] = product(rest, rest, count) / (count - 2 * wires - 2);
    all->odd[b] = odd / (freedom > 1 ? freedom : 1);
    all->steepness[b] = sqrt(alone);
    all->reply[b] = -product(moved, moving, count) / sqrt(alone);
}

/* What the movement of a wire shows over what it would show in a picture as sharp as the kernel; `room` is for M. */
static double gain(const looks *all, Py_ssize_t count, double *room)
{
    size_t known = 0;
    for (Py_ssize_t b = 0; b < count; b++) {
        double answer = all->reply[b] / (all->height[b] * all->steepness[b]);
        if (isfinite(all->farther[b]) && isfinite(answer))
            room[known++] = answer;
        else
            all->farther[b] = NAN;
    }
    if (known == 0)
        return 1.0;
    qsort(room, known, sizeof *room, rising);
    double middle = known % 2 ? room[known / 2] : 0.5 * (room[known / 2 - 1] + room[known / 2]);
    return clipped(middle, GAIN_LEAST, GAIN_MOST);
}

/* Mean over a block and those up to `far` to either side, mirrored at the ends. */
static double around(const double *values, Py_ssize_t count, Py_ssize_t b, Py_ssize_t far)
{
    double sum = 0.0;
    far = far < count - 1 ? far : count - 1;
    for (Py_ssize_t k = b - far; k <= b + far; k++)
        sum += values[k < 0 ? -k : k >= count ? 2 * (count - 1) - k : k];
    return sum / (double)(2 * far + 1);
}

static inline double grey(double squared) { return sqrt(squared + ROUNDING_GREY * ROUNDING_GREY); }

void settle(looks *all, Py_ssize_t count, double *offset, double *sigma)
{
    double answers = gain(all, count, sigma);
    for (Py_ssize_t b = 0; b < count; b++) {
        double near = around(all->uneven, count, b, 1), wide = around(all->uneven, count, b, AROUND);
        double close_near = around(all->odd, count, b, 1), close_wide = around(all->odd, count, b, AROUND);
        double noise[2] = {all->noise[b], all->noise[b]}, close[2] = {grey(all->rest[b]), grey(all->rest[b])};
        if (all->alike[b] != 0.0) {
            double squared[2] = {fmax(all->uneven[b], near), wide};
            for (int k = 0; k < 2; k++)
                noise[k] = fmin(noise[k], grey(UNEVEN * UNEVEN * squared[k]));
            close[0] = grey(fmax(all->odd[b], fmax(close_near, close_wide)));
            close[1] = grey(close_wide);
        }
        double broad_unit = all->sigma[b] / all->noise[b];
        double close_unit = all->correlated[b] / (answers * fabs(all->height[b]) * all->steepness[b]);
        int surer = isfinite(all->farther[b]) && close[1] * close_unit < noise[1] * broad_unit;
        sigma[b] = surer ? close[0] * close_unit : noise[0] * broad_unit;
        offset[b] += surer ? all->farther[b] : 0.0;
    }
}

/* What the parts of sagnode.match.across share that measure where wires lie across a curve, block by block; names of
   parts are those of the functions there and in sagnode.match.kernels. */
#ifndef SAGNODE_ACROSS_H
#define SAGNODE_ACROSS_H
#include "profile.h"
#include "wire.h"

/* Variance factor of the offset for neighbouring samples sharing pixels. */
#define CORRELATED 2.7

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
    float *sums;                         /* (K,) */
    double *profiles, *kernels, *slopes; /* (m, K), (m, n), (m, n) */
    double *amplitude, *energy, *score;  /* (K,) each */
    double *running, *rest;              /* 3 (K + 1,), 5 (m, n) */
    double norm;                         /* of the kernels, were they of height 1 */
} task;

/* What its peak says about one block at one place. */
typedef struct {
    double position, sigma, snr, likeness, contrast, noise;
} peak;

static inline Py_ssize_t whole(const array *of, Py_ssize_t i) { return ((const int64_t *)of->at)[i]; }
static inline Py_ssize_t end_of(const task *t, Py_ssize_t block)
{
    return block + 1 < t->blocks ? whole(&t->starts, block + 1) : t->samples;
}

/* A sample of one of the wires, px; of the centre line where `wire` is negative. */
static inline void sample(const task *t, int wire, Py_ssize_t i, double *u, double *v)
{
    double aside = t->wires > 1 && wire >= 0 ? number2(&t->members, wire, i) : 0.0;
    *u = number2(&t->pixels, i, 0) + aside * number2(&t->normal, i, 0);
    *v = number2(&t->pixels, i, 1) + aside * number2(&t->normal, i, 1);
}

/* Mean profile (K,) of one block across one wire; its outer parts are sampled more sparsely. */
void block_profile(task *t, int wire, Py_ssize_t block, double *profile);
/* Kernels (m, n) and their slopes for one block, and the norm they had. */
void block_kernels(task *t, Py_ssize_t block);
/* By how much what the sub-conductors' windows share makes the offset's variance worse. */
double shared_noise(const task *t, Py_ssize_t block);

/* Amplitude, energy and score of all windows of one block in all its profiles, which lose their means. */
void compare(task *t);
/* The best window about a place, `first` being the first of its 2 far + 1. */
peak find_peak(const task *t, int first, double range, double steepness, double height_of, double overlap);
/* Mean square of what of a block is not the same on both sides; the windows begin at the column `first`. */
double uneven_noise(task *t, double first);

#endif

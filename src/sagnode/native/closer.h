/* A closer look at a wire that was found, and which look is surer: see sagnode.match.closer and sagnode.match.surer. */
#ifndef SAGNODE_CLOSER_H
#define SAGNODE_CLOSER_H
#include "kernels.h"

/* Rows of doubles that `looks` takes up. */
#define LOOKS 11

/* What two looks say of the blocks of a curve (M,) each; names as in Found and Close there. */
typedef struct {
    double *sigma, *noise, *uneven, *height, *alike, *correlated;
    double *farther, *rest, *odd, *steepness, *reply;
} looks;

/* Profiles (m, K) of one block across each sub-conductor, in order across the curve, which lie at middles (m,), `apart`
   doubles from each other, px. */
typedef struct {
    const double *at;
    int columns, wires;
    const int *order;
    const double *middles;
    Py_ssize_t apart;
    double width;
} profiles;

/* Rows (LOOKS, M) as looks. */
looks looks_in(double *rows, Py_ssize_t count);
/* Look closer at the block number `b`, found at a column, NaN for nowhere, in windows that reach `most` steps at most;
   `room` is for 5 m such windows. */
void look_closer(const profiles *about, double found, double margin, int most, double *room, looks *all, Py_ssize_t b);
/* Offsets and uncertainties (M,) of the surer look; what is spoiled is what `looks` hold. */
void settle(looks *all, Py_ssize_t count, double *offset, double *sigma);

#endif

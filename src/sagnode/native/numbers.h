/* Small arithmetic that several kernels need. */
#ifndef SAGNODE_NUMBERS_H
#define SAGNODE_NUMBERS_H

#define PI 3.14159265358979323846

/* A value within bounds; NaN stays. */
static inline double clipped(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/* Order of doubles, for qsort. */
static inline int rising(const void *one, const void *other)
{
    double a = *(const double *)one, b = *(const double *)other;
    return (a > b) - (a < b);
}

#endif

/* What a wire looks like across its curve: see sagnode.match.kernels. */
#ifndef SAGNODE_WIRE_H
#define SAGNODE_WIRE_H
#include <math.h>

#define STEP_PX 0.5
#define ROUNDING_GREY 0.15

/* Error function, absolute error under 1.5e-7 (Abramowitz and Stegun 7.1.26), and exp(-x²). */
static inline double error_function(double x, double *falling)
{
    double t = 1.0 / (1.0 + 0.3275911 * fabs(x));
    double series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
    double sign = (double)((x > 0.0) - (x < 0.0)), fall = exp(-x * x);
    *falling = fall;
    return sign * (1.0 - series * fall);
}

/* Half a wire's width; none is so thin that it has no sides. */
static inline double half_width(double width) { return 0.5 * (width > 0.05 ? width : 0.05); }

static inline double wire_kernel(double width, double position, double blur)
{
    double half = half_width(width), scale = 1.0 / (blur * sqrt(2.0));
    double unused;
    return 0.5 * (error_function((position + half) * scale, &unused) -
                  error_function((position - half) * scale, &unused));
}

/* Take the mean and, where `tilted` is set, the slope out of values (n,). */
static inline void level(double *values, int n, int tilted)
{
    double mean, tilt = 0.0, norm = 0.0, part[4] = {0.0};
    /* one sum would wait for itself */
    for (int k = 0; k < n; k++)
        part[k & 3] += values[k];
    mean = (part[0] + part[1] + part[2] + part[3]) / n;
    for (int k = 0; k < n; k++)
        values[k] -= mean;
    if (!tilted)
        return;
    for (int k = 0; k < n; k++) {
        double step = k - n / 2;
        tilt += step * values[k];
        norm += step * step;
    }
    for (int k = 0; k < n; k++)
        values[k] -= tilt / norm * (k - n / 2);
}

#endif

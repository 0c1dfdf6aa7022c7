/* The camera from landmarks: see sagnode.estimate.camera, which says what it means and does the same in NumPy. */
#include "steps.h"
#include <string.h>

enum { CAUCHY, SETTLED, SETTINGS };

typedef struct {
    camera surveyed;
    Py_ssize_t count;
    const double *positions, *position_u, *pixels, *pixel_u;
} landmarks;

/* What the landmarks say at theta: sums for the normal equation, residuals and, where they are asked for anew, weights.
   Returns the weighted sum of squares of the standardised residuals. */
static double say(const landmarks *seen, const double *theta, double cauchy, double *precision, double *pull,
                  double *residual, double *weight)
{
    static const double axes[2][2] = {{1.0, 0.0}, {0.0, 1.0}};
    camera at;
    double total = 0.0;
    camera_at(&seen->surveyed, theta, &at);
    memset(precision, 0, CAMERA * CAMERA * sizeof *precision);
    memset(pull, 0, CAMERA * sizeof *pull);
    for (Py_ssize_t n = 0; n < seen->count; n++) {
        const double *place = seen->positions + 3 * n;
        double pixel[2], by_place[2][3], by_camera[2][CAMERA], own[3] = {0}, *rest = residual + 2 * n;
        pictured(&at, place, pixel);
        movement m = moves(&at, place);
        for (int i = 0; i < 2; i++) {
            rest[i] = seen->pixels[2 * n + i] - pixel[i];
            slopes(&at, &m, axes[i], by_place[i], by_camera[i]);
        }
        /* covariance of the pixel: of the place as it is surveyed, and of where it was seen */
        double place2 = seen->position_u[n] * seen->position_u[n], seen2 = seen->pixel_u[n] * seen->pixel_u[n];
        for (int k = 0; k < 3; k++) {
            own[0] += by_place[0][k] * by_place[0][k];
            own[1] += by_place[0][k] * by_place[1][k];
            own[2] += by_place[1][k] * by_place[1][k];
        }
        double a = own[0] * place2 + seen2, b = own[1] * place2, c = own[2] * place2 + seen2, det = a * c - b * b;
        double inverse[2][2] = {{c / det, -b / det}, {-b / det, a / det}}, squared = 0.0;
        for (int i = 0; i < 2; i++)
            squared += rest[i] * (inverse[i][0] * rest[0] + inverse[i][1] * rest[1]);
        if (cauchy > 0)
            weight[n] = 1.0 / (1.0 + squared / (cauchy * cauchy));
        total += weight[n] * squared;
        for (int k = 0; k < CAMERA; k++) {
            double first = weight[n] * (by_camera[0][k] * inverse[0][0] + by_camera[1][k] * inverse[1][0]);
            double second = weight[n] * (by_camera[0][k] * inverse[0][1] + by_camera[1][k] * inverse[1][1]);
            pull[k] += first * rest[0] + second * rest[1];
            for (int i = 0; i < CAMERA; i++)
                precision[k * CAMERA + i] += first * by_camera[0][i] + second * by_camera[1][i];
        }
    }
    return total;
}

/* Moves theta, step by step; what the landmarks say there goes into precision and vector. Returns z. */
static double settle(const landmarks *seen, const double *sigma, const double *settings, int iterations, double *theta,
                     double *precision, double *vector, double *residual, double *weight)
{
    double pull[CAMERA], step[CAMERA], matrix[CAMERA * CAMERA], posterior[CAMERA * CAMERA], sum = 0.0;
    for (int number = 0; number < iterations; number++) {
        double ratio = 1.0;
        say(seen, theta, settings[CAUCHY], precision, pull, residual, weight);
        memcpy(matrix, precision, sizeof matrix);
        for (int k = 0; k < CAMERA; k++) {
            matrix[k * CAMERA + k] += 1 / (sigma[k] * sigma[k]);
            pull[k] -= theta[k] / (sigma[k] * sigma[k]);
        }
        solve_scaled(matrix, pull, CAMERA, step, posterior);
        if (number >= 2 && length_of(step, posterior, CAMERA) < settings[SETTLED])
            break;
        for (int k = 0; k < CAMERA; k++) {
            double far = fabs(step[k]) / (3 * sigma[k]);
            ratio = far > ratio ? far : ratio;
        }
        for (int k = 0; k < CAMERA; k++)
            theta[k] += step[k] / ratio;
    }
    double total = say(seen, theta, 0.0, precision, pull, residual, weight);
    for (int k = 0; k < CAMERA; k++) {
        vector[k] = pull[k];
        for (int i = 0; i < CAMERA; i++)
            vector[k] += precision[k * CAMERA + i] * theta[i];
    }
    for (Py_ssize_t n = 0; n < seen->count; n++)
        sum += weight[n];
    return sqrt(total / (2 * least(sum, 1e-9)));
}

PyObject *solve_camera(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    landmarks seen;
    array theta, sigma, positions, position_u, pixels, pixel_u, settings, precision, vector, residual, weight;
    double iterations;
    (void)module;
    if (require(count == 15, "solve_camera takes fifteen arguments") < 0)
        return NULL;
    if (take_camera(&all, words, &seen.surveyed) < 0 || take(&all, words[3], "theta", 'd', 1, 1, 1, &theta) < 0 ||
        take(&all, words[4], "sigma", 'd', 1, 1, 0, &sigma) < 0 ||
        take(&all, words[5], "positions", 'd', 2, 1, 0, &positions) < 0 ||
        take(&all, words[6], "position_u", 'd', 1, 1, 0, &position_u) < 0 ||
        take(&all, words[7], "pixels", 'd', 2, 1, 0, &pixels) < 0 ||
        take(&all, words[8], "pixel_u", 'd', 1, 1, 0, &pixel_u) < 0 ||
        take(&all, words[9], "settings", 'd', 1, 1, 0, &settings) < 0 || take_number(words[10], &iterations) < 0 ||
        take(&all, words[11], "precision", 'd', 2, 1, 1, &precision) < 0 ||
        take(&all, words[12], "vector", 'd', 1, 1, 1, &vector) < 0 ||
        take(&all, words[13], "residual", 'd', 2, 1, 1, &residual) < 0 ||
        take(&all, words[14], "weight", 'd', 1, 1, 1, &weight) < 0)
        goto refused;
    seen.count = positions.shape[0];
    if (require(theta.shape[0] == SIZE && sigma.shape[0] == CAMERA && settings.shape[0] == SETTINGS &&
                    precision.shape[0] == CAMERA && precision.shape[1] == CAMERA && vector.shape[0] == CAMERA,
                "theta, sigma, settings, precision or vector of a wrong size") < 0 ||
        require(positions.shape[1] == 3 && position_u.shape[0] == seen.count && pixels.shape[0] == seen.count &&
                    pixels.shape[1] == 2 && pixel_u.shape[0] == seen.count && residual.shape[0] == seen.count &&
                    residual.shape[1] == 2 && weight.shape[0] == seen.count,
                "pixels, uncertainties, residual or weight do not fit positions") < 0 ||
        require(iterations >= 1 && iterations <= 10000, "iterations: 1 to 10000 are wanted") < 0)
        goto refused;
    seen.positions = (const double *)positions.at;
    seen.position_u = (const double *)position_u.at;
    seen.pixels = (const double *)pixels.at;
    seen.pixel_u = (const double *)pixel_u.at;
    double z = settle(&seen, (const double *)sigma.at, (const double *)settings.at, (int)iterations,
                      (double *)theta.at, (double *)precision.at, (double *)vector.at, (double *)residual.at,
                      (double *)weight.at);
    release(&all);
    return PyFloat_FromDouble(z);
refused:
    release(&all);
    return NULL;
}

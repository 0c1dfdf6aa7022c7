/* Many small systems of equations at once: see sagnode.estimate.steps.solved_each, which says what it means and does the
   same in NumPy. */
#include "kernels.h"
#include <math.h>
#include <stdlib.h>

/* One system: the solution (width, columns) in the place of the right side, and the log determinant. `room` holds the
   factor (width, width) and the scales. */
static double solve_one(const double *matrix, Py_ssize_t width, Py_ssize_t columns, double *solution, double *room)
{
    double *factor = room, *scale = room + width * width, spread = 0.0;
    for (Py_ssize_t i = 0; i < width; i++)
        scale[i] = 1 / sqrt(matrix[i * width + i]);
    for (Py_ssize_t i = 0; i < width; i++)
        for (Py_ssize_t j = 0; j <= i; j++) {
            double sum = matrix[i * width + j] * (scale[i] * scale[j]);
            for (Py_ssize_t k = 0; k < j; k++)
                sum -= factor[i * width + k] * factor[j * width + k];
            /* no comparison holds with NaN */
            if (i == j && !(sum > 0.0 && sum < INFINITY))
                return NAN;
            factor[i * width + j] = i == j ? sqrt(sum) : sum / factor[j * width + j];
        }
    for (Py_ssize_t i = 0; i < width; i++) {
        double *row = solution + i * columns;
        spread += 2 * log(factor[i * width + i] / scale[i]);
        for (Py_ssize_t c = 0; c < columns; c++) {
            double sum = row[c] * scale[i];
            for (Py_ssize_t k = 0; k < i; k++)
                sum -= factor[i * width + k] * solution[k * columns + c];
            row[c] = sum / factor[i * width + i];
        }
    }
    for (Py_ssize_t i = width - 1; i >= 0; i--)
        for (Py_ssize_t c = 0; c < columns; c++) {
            double sum = solution[i * columns + c];
            for (Py_ssize_t k = i + 1; k < width; k++)
                sum -= factor[k * width + i] * solution[k * columns + c];
            solution[i * columns + c] = sum / factor[i * width + i];
        }
    for (Py_ssize_t i = 0; i < width; i++)
        for (Py_ssize_t c = 0; c < columns; c++)
            solution[i * columns + c] *= scale[i];
    return spread;
}

PyObject *solve_each(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    array matrices, right, solution, spread;
    (void)module;
    if (require(count == 4, "solve_each takes four arguments") < 0)
        return NULL;
    if (take(&all, words[0], "matrices", 'd', 3, 1, 0, &matrices) < 0 ||
        take(&all, words[1], "right", 'd', 3, 1, 0, &right) < 0 ||
        take(&all, words[2], "solution", 'd', 3, 1, 1, &solution) < 0 ||
        take(&all, words[3], "spread", 'd', 1, 1, 1, &spread) < 0)
        goto refused;
    Py_ssize_t systems = matrices.shape[0], width = matrices.shape[1], columns = right.shape[2];
    if (require(matrices.shape[2] == width && right.shape[0] == systems && right.shape[1] == width &&
                    solution.shape[0] == systems && solution.shape[1] == width && solution.shape[2] == columns &&
                    spread.shape[0] == systems,
                "matrices, right, solution and spread do not fit") < 0)
        goto refused;
    double *room = malloc((size_t)(width * (width + 1) + 1) * sizeof *room);
    if (room == NULL) {
        PyErr_NoMemory();
        goto refused;
    }
    Py_ssize_t own = width * columns;
    for (Py_ssize_t k = 0; k < systems; k++) {
        double *out = (double *)solution.at + k * own;
        for (Py_ssize_t i = 0; i < own; i++)
            out[i] = ((const double *)right.at)[k * own + i];
        double found = solve_one((const double *)matrices.at + k * width * width, width, columns, out, room);
        ((double *)spread.at)[k] = found;
        for (Py_ssize_t i = 0; isnan(found) && i < own; i++)
            out[i] = NAN;
    }
    free(room);
    release(&all);
    Py_RETURN_NONE;
refused:
    release(&all);
    return NULL;
}

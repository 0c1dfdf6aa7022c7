/* Rows weighed by the error that neighbouring offsets share, for every size of it: see sagnode.estimate.whitened, which
   says what it means and does the same in NumPy. */
#include "kernels.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* What the error kept of itself since the offset before, the offsets' own variances, and the rows (count, columns). */
typedef struct {
    Py_ssize_t count, columns;
    const double *kept, *sigma, *white, *rows;
} observed;

/* Sums of products of the columns of the whitened rows (columns, columns), and the logarithm of the determinant, for
   one size; `room` holds two rows. */
FOR_EACH_PROCESSOR
static double weighed(const observed *of, double least_px, double share, double *restrict room, double *restrict sums)
{
    Py_ssize_t columns = of->columns;
    double variance = 1.0, spread = 0.0, *state = room, *whitened = room + columns;
    memset(room, 0, (size_t)(2 * columns) * sizeof *room);
    memset(sums, 0, (size_t)(columns * columns) * sizeof *sums);
    for (Py_ssize_t n = 0; n < of->count; n++) {
        const double *row = of->rows + n * columns;
        double kept = of->kept[n], white = of->white[n], part = share * of->sigma[n];
        double shared = least_px * least_px + part * part, own = sqrt(shared);
        double before = kept * kept * variance + (1 - kept * kept), total = shared * before + white;
        double gain = own * before / total, shorten = 1 / sqrt(total);
        for (Py_ssize_t k = 0; k < columns; k++) {
            double foreseen = kept * state[k], surprise = row[k] - own * foreseen;
            state[k] = foreseen + gain * surprise;
            whitened[k] = surprise * shorten;
        }
        variance = before * white / total;
        spread += log(total);
        for (Py_ssize_t i = 0; i < columns; i++) {
            double own = whitened[i], *restrict to = sums + i * columns;
            for (Py_ssize_t j = i; j < columns; j++)
                to[j] += own * whitened[j];
        }
    }
    for (Py_ssize_t i = 0; i < columns; i++)
        for (Py_ssize_t j = 0; j < i; j++)
            sums[i * columns + j] = sums[j * columns + i];
    return spread;
}

PyObject *shared_products(PyObject *module, PyObject *const *words, Py_ssize_t count)
{
    arrays all = {0};
    array kept, sigma, white, rows, grid, products, spread;
    double *room = NULL;
    (void)module;
    if (require(count == 7, "shared_products takes seven arguments") < 0)
        return NULL;
    if (take(&all, words[0], "kept", 'd', 1, 1, 0, &kept) < 0 || take(&all, words[1], "sigma", 'd', 1, 1, 0, &sigma) < 0 ||
        take(&all, words[2], "white", 'd', 1, 1, 0, &white) < 0 || take(&all, words[3], "rows", 'd', 2, 1, 0, &rows) < 0 ||
        take(&all, words[4], "grid", 'd', 2, 1, 0, &grid) < 0 ||
        take(&all, words[5], "products", 'd', 3, 1, 1, &products) < 0 ||
        take(&all, words[6], "spread", 'd', 1, 1, 1, &spread) < 0)
        goto refused;
    Py_ssize_t offsets = rows.shape[0], columns = rows.shape[1], sizes = grid.shape[0];
    if (require(kept.shape[0] == offsets && sigma.shape[0] == offsets && white.shape[0] == offsets,
                "kept, sigma and white do not fit rows") < 0 ||
        require(grid.shape[1] == 2 && spread.shape[0] == sizes && products.shape[0] == sizes &&
                    products.shape[1] == columns && products.shape[2] == columns,
                "products and spread do not fit grid and rows") < 0)
        goto refused;
    room = malloc((size_t)(2 * columns + 1) * sizeof *room);
    if (room == NULL) {
        PyErr_NoMemory();
        goto refused;
    }
    observed of = {offsets, columns, (const double *)kept.at, (const double *)sigma.at, (const double *)white.at,
                   (const double *)rows.at};
    for (Py_ssize_t g = 0; g < sizes; g++)
        ((double *)spread.at)[g] = weighed(&of, number2(&grid, g, 0), number2(&grid, g, 1), room,
                                           (double *)products.at + g * columns * columns);
    free(room);
    release(&all);
    Py_RETURN_NONE;
refused:
    release(&all);
    return NULL;
}

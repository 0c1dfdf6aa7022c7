#include "steps.h"

/* Rodrigues' formula: a rotation after a small one. */
static void turn(const double v[3], const double before[9], double out[9])
{
    double x = v[0], y = v[1], z = v[2], angle = sqrt(x * x + y * y + z * z), a = 1.0, b = 1.0;
    if (angle > 1e-12) {
        a = sin(angle) / angle;
        b = (1 - cos(angle)) / (angle * angle);
    }
    const double own[9] = {1 - b * (y * y + z * z), b * x * y - a * z,         b * x * z + a * y,
                           b * x * y + a * z,       1 - b * (x * x + z * z),   b * y * z - a * x,
                           b * x * z - a * y,       b * y * z + a * x,         1 - b * (x * x + y * y)};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = own[3 * i] * before[j] + own[3 * i + 1] * before[3 + j] + own[3 * i + 2] * before[6 + j];
}

void camera_at(const camera *surveyed, const double *theta, camera *out)
{
    *out = *surveyed;
    turn(theta, surveyed->rotation, out->rotation);
    for (int k = 0; k < 3; k++)
        out->position[k] += theta[3 + k];
    double scale = 1 + theta[6];
    out->fx *= scale;
    out->fy *= scale;
    out->cx += theta[7];
    out->cy += theta[8];
    if (theta[9] != 0.0 && !out->fisheye) {
        out->k[0] += theta[9];
        out->distorted = 0;
        for (int k = 0; k < 8; k++)
            out->distorted |= out->k[k] != 0.0;
    }
}

movement moves(const camera *at, const double place[3])
{
    const double step = 1e-6, focal[2] = {at->fx, at->fy};
    movement m;
    seen_from(at, place, m.own);
    double z = m.own[2], ax, ay, bx, by;
    double x = m.x = m.own[0] / z, y = m.y = m.own[1] / z;
    if (at->distorted) {
        distorted(at, x, y, &m.xd, &m.yd);
        distorted(at, x + step, y, &ax, &ay);
        distorted(at, x, y + step, &bx, &by);
    } else {
        m.xd = x;
        m.yd = y;
        ax = x + step;
        ay = y;
        bx = x;
        by = y + step;
    }
    const double by_x[2] = {(ax - m.xd) / step, (ay - m.yd) / step};
    const double by_y[2] = {(bx - m.xd) / step, (by - m.yd) / step};
    for (int row = 0; row < 2; row++) {
        double dx = focal[row] * by_x[row], dy = focal[row] * by_y[row];
        m.by_own[row][0] = dx / z;
        m.by_own[row][1] = dy / z;
        m.by_own[row][2] = -(dx * x + dy * y) / z;
    }
    return m;
}

void slopes(const camera *at, const movement *m, const double along[2], double by_place[3], double *by_camera)
{
    double by_own[3];
    for (int k = 0; k < 3; k++)
        by_own[k] = along[0] * m->by_own[0][k] + along[1] * m->by_own[1][k];
    for (int k = 0; k < 3; k++) {
        const double *r = at->rotation + k;
        by_place[k] = by_own[0] * r[0] + by_own[1] * r[3] + by_own[2] * r[6];
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        by_camera[i] = m->own[j] * by_own[k] - m->own[k] * by_own[j];
        by_camera[3 + i] = -by_place[i];
    }
    by_camera[6] = along[0] * at->fx * m->xd + along[1] * at->fy * m->yd;
    by_camera[7] = along[0];
    by_camera[8] = along[1];
    double r2 = m->x * m->x + m->y * m->y;
    by_camera[9] = at->fisheye ? 0.0 : along[0] * at->fx * m->x * r2 + along[1] * at->fy * m->y * r2;
}

void solve_scaled(const double *matrix, const double *vector, int width, double *step, double *inverse)
{
    double scale[SIZE], factor[SIZE * SIZE], below[SIZE * SIZE];
    for (int i = 0; i < width; i++)
        scale[i] = 1 / sqrt(matrix[i * width + i]);
    /* Cholesky's factor, and its inverse */
    for (int i = 0; i < width; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = matrix[i * width + j] * (scale[i] * scale[j]) + (i == j ? 1e-9 : 0.0);
            for (int k = 0; k < j; k++)
                sum -= factor[i * width + k] * factor[j * width + k];
            factor[i * width + j] = i == j ? sqrt(sum) : sum / factor[j * width + j];
        }
        for (int j = 0; j <= i; j++) {
            double sum = i == j ? 1.0 : 0.0;
            for (int k = j; k < i; k++)
                sum -= factor[i * width + k] * below[k * width + j];
            below[i * width + j] = sum / factor[i * width + i];
        }
    }
    for (int i = 0; i < width; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = i; k < width; k++)
                sum += below[k * width + i] * below[k * width + j];
            inverse[i * width + j] = inverse[j * width + i] = sum * (scale[i] * scale[j]);
        }
    for (int i = 0; i < width; i++) {
        step[i] = 0.0;
        for (int j = 0; j < width; j++)
            step[i] += inverse[i * width + j] * vector[j];
    }
}

double length_of(const double *step, const double *covariance, int width)
{
    double most = 0.0;
    for (int k = 0; k < width; k++) {
        double own = fabs(step[k]) / sqrt(covariance[k * width + k]);
        if (isnan(own))
            return own;
        most = own > most ? own : most;
    }
    return most;
}

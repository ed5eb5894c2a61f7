/* A cone and its coil: x = x, i, x'; u = U, F_x; p = m, d, k, B, R, L. */
static void rates(double t, const double *x, const double *u, const double *p, double *f)
{
    (void)t;
    f[0] = x[2];
    f[1] = (u[0] - p[4] * x[1] - p[3] * x[2]) / p[5];
    f[2] = (p[3] * x[1] + u[1] - p[1] * x[2] - p[2] * x[0]) / p[0];
}

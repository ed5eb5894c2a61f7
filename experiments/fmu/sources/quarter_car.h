/* Body and wheel on a road: x = b, w, b', w'; u = road, F_b, F_w; p = mb, mw, k, c, kt. */
static void rates(double t, const double *x, const double *u, const double *p, double *f)
{
    const double strut = p[2] * (x[0] - x[1]) + p[3] * (x[2] - x[3]);
    const double tyre = p[4] * (x[1] - u[0]);
    (void)t;
    f[0] = x[2];
    f[1] = x[3];
    f[2] = (u[1] - strut) / p[0];
    f[3] = (u[2] + strut - tyre) / p[1];
}

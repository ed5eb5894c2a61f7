/* A cylinder that moves a sprung mass: x = x, P, x'; u = u, F_x; p = m, A, d, k, E, g, l. */
static void rates(double t, const double *x, const double *u, const double *p, double *f)
{
    const double piston = p[1] * x[1], swept = p[1] * x[2], leak = p[6] * x[1];
    (void)t;
    f[0] = x[2];
    f[1] = p[4] * (p[5] * u[0] - swept - leak);
    f[2] = (piston + u[1] - p[2] * x[2] - p[3] * x[0]) / p[0];
}

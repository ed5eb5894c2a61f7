/* A driven pendulum: x = th, th'; u = T, F_th; p = J, d, G. */
static void rates(double t, const double *x, const double *u, const double *p, double *f)
{
    (void)t;
    f[0] = x[1];
    f[1] = (u[0] + u[1] - p[1] * x[1] - p[2] * sin(x[0])) / p[0];
}

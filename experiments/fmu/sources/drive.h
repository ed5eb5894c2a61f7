/* Motor, flexible shaft and load: x = a, b, a', b'; u = T, F_a, F_b; p = J1, J2, k, c, p, d. */
static void rates(double t, const double *x, const double *u, const double *p, double *f)
{
    const double twist = x[1] - x[0], speed = x[3] - x[2];
    const double moment = p[2] * twist + p[3] * speed;
    (void)t;
    f[0] = x[2];
    f[1] = x[3];
    f[2] = (u[0] + u[1] + moment - p[4] * x[0] - p[5] * x[2]) / p[0];
    f[3] = (u[2] - moment) / p[1];
}

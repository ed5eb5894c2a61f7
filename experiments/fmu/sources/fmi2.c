/*
 * FMI 2.0 for model exchange around rates(t, x, u, p, f) of one of the files beside it.
 *
 * Value references: states, their derivatives, inputs, parameters. Strict about the standard:
 * parameters are set before or during initialization or in event mode, all else of a simulation in
 * continuous-time mode. No directional derivatives.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include MODEL

#define FMI(name) __attribute__((visibility("default"))) int name
enum { OK, WARNING, DISCARD, ERROR };
enum { BEFORE, INITIALIZATION, EVENT, CONTINUOUS };
enum { F0 = N, U0 = 2 * N, P0 = U0 + NU, END = P0 + NP };

typedef struct {
    int mode;
    double t, x[N], u[NU], p[NP];
} Instance;

__attribute__((visibility("default"))) const char *fmi2GetTypesPlatform(void) { return "default"; }
__attribute__((visibility("default"))) const char *fmi2GetVersion(void) { return "2.0"; }
__attribute__((visibility("default"))) void *fmi2Instantiate(const char *name, int type,
    const char *guid, const char *resources, const void *functions, int visible, int logging)
{
    static const double start[] = START;
    Instance *m = calloc(1, sizeof *m);
    (void)name; (void)type; (void)guid; (void)resources; (void)functions; (void)visible;
    (void)logging;
    if (m != NULL) memcpy(m->p, start, sizeof start);
    return m;
}
__attribute__((visibility("default"))) void fmi2FreeInstance(void *c) { free(c); }

static int entered(void *c, int from, int to)
{
    Instance *m = c;
    if (m->mode != from) return ERROR;
    m->mode = to;
    return OK;
}
FMI(fmi2SetupExperiment)(void *c, int given, double tolerance, double start, int ends, double stop)
{
    (void)given; (void)tolerance; (void)ends; (void)stop;
    ((Instance *)c)->t = start;
    return OK;
}
FMI(fmi2EnterInitializationMode)(void *c) { return entered(c, BEFORE, INITIALIZATION); }
FMI(fmi2ExitInitializationMode)(void *c) { return entered(c, INITIALIZATION, EVENT); }
FMI(fmi2EnterContinuousTimeMode)(void *c) { return entered(c, EVENT, CONTINUOUS); }
FMI(fmi2EnterEventMode)(void *c) { return entered(c, CONTINUOUS, EVENT); }
FMI(fmi2Terminate)(void *c) { (void)c; return OK; }
FMI(fmi2Reset)(void *c) { ((Instance *)c)->mode = BEFORE; return OK; }
FMI(fmi2SetDebugLogging)(void *c, int on, size_t n, const char *const *kinds)
{
    (void)c; (void)on; (void)n; (void)kinds;
    return OK;
}
FMI(fmi2NewDiscreteStates)(void *c, int *events)
{
    memset(events, 0, 5 * sizeof *events);
    return ((Instance *)c)->mode == EVENT ? OK : ERROR;
}
FMI(fmi2CompletedIntegratorStep)(void *c, int final, int *event, int *ends)
{
    (void)c; (void)final;
    *event = *ends = 0;
    return OK;
}

FMI(fmi2SetReal)(void *c, const unsigned *r, size_t n, const double *value)
{
    Instance *m = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= END || (r[i] >= F0 && r[i] < U0)) return ERROR;
        if (r[i] >= P0) {
            if (m->mode == CONTINUOUS) return ERROR;
            m->p[r[i] - P0] = value[i];
        } else if (r[i] >= U0) m->u[r[i] - U0] = value[i];
        else m->x[r[i]] = value[i];
    }
    return OK;
}
FMI(fmi2GetReal)(void *c, const unsigned *r, size_t n, double *value)
{
    Instance *m = c;
    double f[N];
    rates(m->t, m->x, m->u, m->p, f);
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= END) return ERROR;
        value[i] = r[i] < F0 ? m->x[r[i]] : r[i] < U0 ? f[r[i] - F0]
            : r[i] < P0 ? m->u[r[i] - U0] : m->p[r[i] - P0];
    }
    return OK;
}
FMI(fmi2SetTime)(void *c, double t)
{
    ((Instance *)c)->t = t;
    return ((Instance *)c)->mode == CONTINUOUS ? OK : ERROR;
}
FMI(fmi2SetContinuousStates)(void *c, const double *x, size_t n)
{
    Instance *m = c;
    if (n != N || m->mode != CONTINUOUS) return ERROR;
    memcpy(m->x, x, sizeof m->x);
    return OK;
}
FMI(fmi2GetContinuousStates)(void *c, double *x, size_t n)
{
    if (n != N) return ERROR;
    memcpy(x, ((Instance *)c)->x, n * sizeof *x);
    return OK;
}
FMI(fmi2GetNominalsOfContinuousStates)(void *c, double *x, size_t n)
{
    (void)c;
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return OK;
}
FMI(fmi2GetDerivatives)(void *c, double *f, size_t n)
{
    Instance *m = c;
    if (n != N || m->mode != CONTINUOUS) return ERROR;
    rates(m->t, m->x, m->u, m->p, f);
    return OK;
}
FMI(fmi2GetEventIndicators)(void *c, double *z, size_t n)
{
    (void)c; (void)z;
    return n == 0 ? OK : ERROR;
}

/* The rest of the standard, which this program has not. */
#define NOTHING(name, type) FMI(name)(void *c, const unsigned *r, size_t n, type *value) \
    { (void)c; (void)r; (void)value; return n == 0 ? OK : ERROR; }
NOTHING(fmi2GetInteger, int)
NOTHING(fmi2GetBoolean, int)
NOTHING(fmi2GetString, const char *)
NOTHING(fmi2SetInteger, const int)
NOTHING(fmi2SetBoolean, const int)
NOTHING(fmi2SetString, const char *const)
FMI(fmi2GetFMUstate)(void *c, void **s) { (void)c; (void)s; return ERROR; }
FMI(fmi2SetFMUstate)(void *c, void *s) { (void)c; (void)s; return ERROR; }
FMI(fmi2FreeFMUstate)(void *c, void **s) { (void)c; (void)s; return ERROR; }
FMI(fmi2SerializedFMUstateSize)(void *c, void *s, size_t *n)
{
    (void)c; (void)s; (void)n;
    return ERROR;
}
FMI(fmi2SerializeFMUstate)(void *c, void *s, char *b, size_t n)
{
    (void)c; (void)s; (void)b; (void)n;
    return ERROR;
}
FMI(fmi2DeSerializeFMUstate)(void *c, const char *b, size_t n, void **s)
{
    (void)c; (void)b; (void)n; (void)s;
    return ERROR;
}
FMI(fmi2GetDirectionalDerivative)(void *c, const unsigned *z, size_t nz, const unsigned *v,
    size_t nv, const double *dv, double *dz)
{
    (void)c; (void)z; (void)nz; (void)v; (void)nv; (void)dv; (void)dz;
    return ERROR;
}

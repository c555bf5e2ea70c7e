/* A small FMI 2.0 FMU for tests, Model Exchange and Co-Simulation: a ball with drag under a force u,
 *   h' = v,  v' = -g - d v |v| + u,  y = h,  w = 2 v.
 * With BOUNCE it bounces at h = 0 (state event: v = -e v); with SWITCH the gravity changes its sign at t = 1 (time
 * event); with REMEMBERS a part of the drag is that of the last completed step. TRAP makes it misbehave in one call,
 * from the time TRAP_TIME on. The instance number WEARS_OUT of a process crashes it.
 * SLOW are microseconds that every evaluation takes; with RANDOM the force has noise that nobody can repeat. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "fmi2Functions.h"

#ifndef BOUNCE
#define BOUNCE 0
#endif
#ifndef SWITCH
#define SWITCH 0
#endif
#ifndef REMEMBERS
#define REMEMBERS 0
#endif
#ifndef SLOW
#define SLOW 0
#endif
#ifndef RANDOM
#define RANDOM 0
#endif
#ifndef TRAP
#define TRAP NONE
#endif
#ifndef TRAP_TIME
#define TRAP_TIME 0.5
#endif
enum { NONE, CRASH, HANG, EXIT, ABORT, LOG, PRINT, MEMORY, REFUSE_ALL, NOT_A_NUMBER, NEVER_SETTLES, TERMINATES, ZERO_NOMINALS };
enum { H, V, DH, DV, U, Y, W, D, E, G, N };
typedef struct { double v[N], t, sign, heard; int below; const fmi2CallbackFunctions *f; } M;

static int trap(M *m) {
    if (m->t < TRAP_TIME) return 0;
    switch (TRAP) {
        case CRASH: *(volatile int *)8 = 1; break;
        case HANG: for (;;) pause();
        case EXIT: exit(3);
        case ABORT: abort();
        case LOG: for (;;) m->f->logger(m->f->componentEnvironment, "ball", fmi2OK, "log", "again and again at %g", m->t); break;
        case PRINT: for (;;) puts("a line that is printed again and again without any end, by a tool that was left in debug mode"); break;
        case MEMORY: for (;;) { char *p = malloc(1 << 24); if (!p) abort(); memset(p, 1, 1 << 24); } break;
        case REFUSE_ALL: m->f->logger(m->f->componentEnvironment, "ball", fmi2Error, "error", "no air at %g s", m->t); return 1;
        case NOT_A_NUMBER: m->v[G] = NAN; break;
        default: break;
    }
    return 0;
}
static void compute(M *m) {
    if (SLOW) usleep(SLOW);
    m->v[DH] = m->v[V];
    m->v[DV] = -m->sign * m->v[G] - m->v[D] * m->v[V] * fabs(m->v[V]) + m->v[U];
    if (REMEMBERS) m->v[DV] -= 0.1 * m->heard;
    if (RANDOM) m->v[DV] += RANDOM * (double)rand() / RAND_MAX;
    m->v[Y] = m->v[H];
    m->v[W] = 2 * m->v[V];
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean log) {
    M *m = calloc(1, sizeof(M));
#ifdef WEARS_OUT
    static int made;
    if (++made >= WEARS_OUT) *(volatile int *)8 = 1;
#endif
    m->v[H] = 1.0; m->v[D] = 0.1; m->v[E] = 0.7; m->v[G] = 9.81; m->sign = 1; m->f = f;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real t, fmi2Boolean e, fmi2Real f) { ((M *)c)->t = t; return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    M *m = c;
    memset(info, 0, sizeof *info);
    info->newDiscreteStatesNeeded = TRAP == NEVER_SETTLES && m->t >= TRAP_TIME;
    info->terminateSimulation = TRAP == TERMINATES && m->t >= TRAP_TIME;
    if (BOUNCE && m->v[H] <= 0 && m->v[V] < 0) { m->v[V] *= -m->v[E]; m->v[H] = 0; info->valuesOfContinuousStatesChanged = 1; }
    if (SWITCH) {
        if (m->t >= 1.0) m->sign = -1;
        info->nextEventTimeDefined = m->t < 1.0;
        info->nextEventTime = 1.0;
    }
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean a, fmi2Boolean *event, fmi2Boolean *end) {
    *event = (TRAP == NEVER_SETTLES || TRAP == TERMINATES) && ((M *)c)->t >= TRAP_TIME;
    *end = 0;
    ((M *)c)->heard = ((M *)c)->v[V];
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { ((M *)c)->t = t; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { memcpy(((M *)c)->v, x, n * sizeof *x); return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { memcpy(x, ((M *)c)->v, n * sizeof *x); return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = TRAP == ZERO_NOMINALS ? 0.0 : 1.0;
    return fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { if (n) z[0] = ((M *)c)->v[H] + (((M *)c)->v[V] > 0 ? 1e-12 : 0); return fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    M *m = c;
    if (trap(m)) return fmi2Error;
    compute(m);
    memcpy(dx, m->v + DH, n * sizeof *dx);
    return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    compute(c);
    for (size_t i = 0; i < n; i++) value[i] = ((M *)c)->v[vr[i]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) ((M *)c)->v[vr[i]] = value[i];
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real length, fmi2Boolean b) {
    M *m = c;
    int n = 50;
    m->t = t;
    if (trap(m)) return fmi2Error;
    for (int i = 0; i < n; i++) { /* midpoint rule */
        double h = m->v[H], v = m->v[V], s = length / n;
        compute(m);
        m->v[H] = h + s / 2 * m->v[DH]; m->v[V] = v + s / 2 * m->v[DV];
        compute(m);
        m->v[H] = h + s * m->v[DH]; m->v[V] = v + s * m->v[DV];
    }
    m->t = t + length;
    return fmi2OK;
}

/* Everything else is there and refuses. */
int refuse(void) { return fmi2Error; }
#define REFUSE(NAME) extern __typeof__(NAME) NAME __attribute__((alias("refuse")));
REFUSE(fmi2GetTypesPlatform) REFUSE(fmi2GetVersion) REFUSE(fmi2SetDebugLogging) REFUSE(fmi2Reset)
REFUSE(fmi2GetInteger) REFUSE(fmi2GetBoolean) REFUSE(fmi2GetString) REFUSE(fmi2SetInteger) REFUSE(fmi2SetBoolean)
REFUSE(fmi2SetString) REFUSE(fmi2GetFMUstate) REFUSE(fmi2SetFMUstate) REFUSE(fmi2FreeFMUstate)
REFUSE(fmi2SerializedFMUstateSize) REFUSE(fmi2SerializeFMUstate) REFUSE(fmi2DeSerializeFMUstate)
REFUSE(fmi2GetDirectionalDerivative) REFUSE(fmi2SetRealInputDerivatives) REFUSE(fmi2GetRealOutputDerivatives)
REFUSE(fmi2CancelStep) REFUSE(fmi2GetStatus) REFUSE(fmi2GetRealStatus) REFUSE(fmi2GetIntegerStatus)
REFUSE(fmi2GetBooleanStatus) REFUSE(fmi2GetStringStatus)

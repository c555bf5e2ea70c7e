/* A small FMI 2.0 Model Exchange FMU for tests, linear but for its memory m: x' = -x + m + u, y = x + m, der(x)
 * likewise. What changes m is chosen by MEMORY:
 *   RELAY  a relay with hysteresis: m = -1 above x = 0.5, m = 1 below x = -0.5 (state events);
 *   STUCK  the same, with the sign alone for an indicator, which stays changed once it was, until the next event;
 *   UNREAD the same, with an indicator that sees x as it was when, before the last time that was set, a variable was
 *          read;
 *   CLOCK  m = -m at every multiple of 0.4 s (time events);
 *   STEPS  m = -m after a completed step beyond a multiple of 0.4 s (event asked for by the step);
 *   DELAY  m is the input 0.4 s ago, from the steps that were heard of. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

enum { RELAY, CLOCK, STEPS, DELAY, STUCK, UNREAD };
enum { X, DX, U, Y, MODE, N };
#define PERIOD 0.4
#define HEARD 100000
typedef struct { double v[N], t, next, seen, late; int n, changed, is_set; double times[HEARD], values[HEARD]; } M;

static double delayed(const M *m) {
    double t = m->t - PERIOD;
    int k = m->n - 1;
    if (k < 0 || t <= m->times[0]) return 0;
    while (k > 0 && m->times[k] > t) k--;
    if (k + 1 >= m->n) return m->values[k];
    return m->values[k] + (t - m->times[k]) / (m->times[k + 1] - m->times[k]) * (m->values[k + 1] - m->values[k]);
}
static void see(M *m) { /* the indicator of a point that was set */
    if (m->is_set) m->late = m->v[MODE] * m->seen - 0.5;
    m->is_set = 0;
}
static void compute(M *m) {
    if (MEMORY == DELAY) m->v[MODE] = delayed(m);
    m->v[DX] = -m->v[X] + m->v[MODE] + m->v[U];
    m->v[Y] = m->v[X] + m->v[MODE];
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean log) {
    M *m = calloc(1, sizeof(M));
    m->v[MODE] = MEMORY == DELAY ? 0 : 1;
    m->next = PERIOD;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real t, fmi2Boolean e, fmi2Real f) { ((M *)c)->t = t; return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    M *m = c;
    memset(info, 0, sizeof *info);
    m->changed = 0;
    if ((MEMORY == RELAY || MEMORY == STUCK || MEMORY == UNREAD) && fabs(m->v[X]) >= 0.5) m->v[MODE] = m->v[X] > 0 ? -1 : 1;
    if ((MEMORY == CLOCK || MEMORY == STEPS) && m->t >= m->next) { m->v[MODE] = -m->v[MODE]; m->next += PERIOD; }
    info->nextEventTimeDefined = MEMORY == CLOCK;
    info->nextEventTime = m->next;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean a, fmi2Boolean *event, fmi2Boolean *end) {
    M *m = c;
    *event = MEMORY == STEPS && m->t >= m->next;
    *end = 0;
    if (m->n < HEARD && (!m->n || m->t > m->times[m->n - 1])) { m->times[m->n] = m->t; m->values[m->n++] = m->v[U]; }
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { ((M *)c)->t = t; ((M *)c)->is_set = 1; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { ((M *)c)->v[X] = x[0]; return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = ((M *)c)->v[X]; return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = 1; return fmi2OK; }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    M *m = c;
    double now = m->v[MODE] * m->v[X] - 0.5;
    if (now > 0) m->changed = 1;
    see(m);
    if (n) z[0] = MEMORY == STUCK ? (m->changed ? 1 : -1) : MEMORY == UNREAD ? (m->late > 0 ? 1 : -1) : now;
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { compute(c); see(c); dx[0] = ((M *)c)->v[DX]; return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    compute(c);
    see(c);
    ((M *)c)->seen = ((M *)c)->v[X];
    for (size_t i = 0; i < n; i++) value[i] = ((M *)c)->v[vr[i]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) ((M *)c)->v[vr[i]] = value[i];
    return fmi2OK;
}

/* A small FMI 2.0 FMU with the habits of other tools, for tests: x1' = x2, x2' = -k x1 + u, y = x1 (alias of the
 * state, read before the derivatives or stale), z = x1 + 2 x2.
 * Its directional derivatives are right only after the event iteration, and forget that y is a state with
 * FORGETS_ALIAS. Those of z, which is neither a derivative nor an output, are refused with PROMISED_ALONE=1, those
 * of another variable with PROMISED_ALONE=2, and no numbers with PROMISED_ALONE=3. */
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

enum { X1, X2, DX1, DX2, U, Y, Z, K, N };
typedef struct { double v[N]; int stale, settled; } M;

static void compute(M *m) {
    m->v[DX1] = m->v[X2];
    m->v[DX2] = -m->v[K] * m->v[X1] + m->v[U];
    m->v[Z] = m->v[X1] + 2 * m->v[X2];
    if (!m->stale) m->v[Y] = m->v[X1];
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean log) {
    M *m = calloc(1, sizeof(M));
    if (strcmp(guid, "{oscillator}")) { f->logger(f->componentEnvironment, name, fmi2Error, "error", "wrong %s", "guid"); return NULL; }
    m->v[X1] = 1.0;
    m->v[K] = 4.0;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    M *m = c;
    memset(info, 0, sizeof *info);
    info->newDiscreteStatesNeeded = !m->settled; /* one round is not enough */
    m->settled = 1;
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return ((M *)c)->settled ? fmi2OK : fmi2Error; }
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { ((M *)c)->stale = 0; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    ((M *)c)->v[X1] = x[0];
    ((M *)c)->v[X2] = x[1];
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    x[0] = ((M *)c)->v[X1];
    x[1] = ((M *)c)->v[X2];
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    M *m = c;
    compute(m);
    m->stale = 1;
    dx[0] = m->v[DX1];
    dx[1] = m->v[DX2];
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
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu,
                                        const fmi2ValueReference k[], size_t nk, const fmi2Real dk[], fmi2Real du[]) {
    M *m = c, d;
    memset(&d, 0, sizeof d);
    d.v[K] = m->v[K];
    d.stale = FORGETS_ALIAS;
    for (size_t i = 0; i < nk; i++) d.v[k[i]] = dk[i];
    compute(&d);
    for (size_t i = 0; i < nu; i++) {
#ifdef PROMISED_ALONE
        if (u[i] == Z && PROMISED_ALONE == 1) return fmi2Error;
#endif
        du[i] = d.v[u[i]];
#ifdef PROMISED_ALONE
        if (u[i] == Z) du[i] = PROMISED_ALONE == 3 ? 0.0 / 0.0 : d.v[DX2];
#endif
    }
    return fmi2OK;
}

/* Everything else is there and refuses. */
int refuse(void) { return fmi2Error; }
#define REFUSE(NAME) extern __typeof__(NAME) NAME __attribute__((alias("refuse")));
REFUSE(fmi2GetTypesPlatform) REFUSE(fmi2GetVersion) REFUSE(fmi2SetDebugLogging) REFUSE(fmi2Terminate) REFUSE(fmi2Reset)
REFUSE(fmi2GetInteger) REFUSE(fmi2GetBoolean) REFUSE(fmi2GetString) REFUSE(fmi2SetInteger) REFUSE(fmi2SetBoolean)
REFUSE(fmi2SetString) REFUSE(fmi2GetFMUstate) REFUSE(fmi2SetFMUstate) REFUSE(fmi2FreeFMUstate)
REFUSE(fmi2SerializedFMUstateSize) REFUSE(fmi2SerializeFMUstate) REFUSE(fmi2DeSerializeFMUstate)
REFUSE(fmi2EnterEventMode) REFUSE(fmi2CompletedIntegratorStep) REFUSE(fmi2GetEventIndicators)
REFUSE(fmi2GetNominalsOfContinuousStates)

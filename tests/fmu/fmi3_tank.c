/* A small FMI 3.0 Model Exchange FMU for tests: the level h of a tank, h' = u - k sqrt(h), y = 2 h, which has no
 * answer at h < 0. As the standard has it, an error is a state: from then on everything is refused but Reset and
 * FreeInstance. With ONLY_ONCE the process cannot instantiate it a second time, and its state is global. With
 * SHARED it keeps the values of all instances in one place, as no FMU should. */
#include <math.h>
#include <stdlib.h>
#include "fmi3Functions.h"

enum { TIME, H, DH, U, Y, K, N };
typedef struct { double v[N]; int broken; fmi3LogMessageCallback log; fmi3InstanceEnvironment environment; } M;
static int made;
#ifdef SHARED
static M only;
#endif

static void fresh(M *m) {
    for (int i = 0; i < N; i++) m->v[i] = 0;
    m->v[H] = 1.0;
    m->v[K] = 0.5;
    m->broken = 0;
}
static fmi3Status error(M *m, const char *why) {
    m->broken = 1;
    m->log(m->environment, fmi3Error, "error", why);
    return fmi3Error;
}
static fmi3Status compute(M *m) {
    if (m->broken) return error(m, "the instance is in the error state");
    if (m->v[H] < 0) return error(m, "no level below zero");
    m->v[DH] = m->v[U] - m->v[K] * sqrt(m->v[H]);
    m->v[Y] = 2 * m->v[H];
    return fmi3OK;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment e, fmi3LogMessageCallback log) {
    if (ONLY_ONCE && made++) return NULL;
#ifdef SHARED
    M *m = &only;
#else
    M *m = calloc(1, sizeof(M));
#endif
    m->log = log;
    m->environment = e;
    fresh(m);
    return m;
}
#ifdef SHARED
void fmi3FreeInstance(fmi3Instance c) { (void)c; }
#else
void fmi3FreeInstance(fmi3Instance c) { free(c); }
#endif
fmi3Status fmi3Reset(fmi3Instance c) { fresh(c); return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 d, fmi3Boolean e, fmi3Float64 f) { return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals,
                                    fmi3Boolean *states, fmi3Boolean *has_next, fmi3Float64 *next) {
    *again = *end = *nominals = *states = *has_next = 0;
    return fmi3OK;
}
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) { return ((M *)c)->broken ? fmi3Error : fmi3OK; }
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { *n = 0; return fmi3OK; }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    ((M *)c)->v[H] = x[0];
    return ((M *)c)->broken ? fmi3Error : fmi3OK;
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { x[0] = ((M *)c)->v[H]; return fmi3OK; }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { x[0] = 0; return fmi3OK; }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
    fmi3Status status = compute(c);
    dx[0] = ((M *)c)->v[DH];
    return status;
}
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t m) {
    fmi3Status status = compute(c);
    for (size_t i = 0; i < n; i++) value[i] = ((M *)c)->v[vr[i]];
    return status;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[], size_t m) {
    for (size_t i = 0; i < n; i++) ((M *)c)->v[vr[i]] = value[i];
    return ((M *)c)->broken ? fmi3Error : fmi3OK;
}
/* Not declared in the description: asking for it is an error. */
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference a[], size_t na,
                                        const fmi3ValueReference b[], size_t nb, const fmi3Float64 s[], size_t ns,
                                        fmi3Float64 r[], size_t nr) {
    return error(c, "there are no directional derivatives");
}

/* Everything else is there and refuses. */
int refuse(void) { return fmi3Error; }
#define REFUSE(NAME) extern __typeof__(NAME) NAME __attribute__((alias("refuse")));
REFUSE(fmi3ActivateModelPartition) REFUSE(fmi3CompletedIntegratorStep) REFUSE(fmi3DeserializeFMUState)
REFUSE(fmi3DoStep) REFUSE(fmi3EnterConfigurationMode) REFUSE(fmi3EnterStepMode) REFUSE(fmi3EvaluateDiscreteStates)
REFUSE(fmi3ExitConfigurationMode) REFUSE(fmi3FreeFMUState) REFUSE(fmi3GetAdjointDerivative) REFUSE(fmi3GetBinary)
REFUSE(fmi3GetBoolean) REFUSE(fmi3GetClock) REFUSE(fmi3GetEventIndicators) REFUSE(fmi3GetFMUState)
REFUSE(fmi3GetFloat32) REFUSE(fmi3GetInt16) REFUSE(fmi3GetInt32) REFUSE(fmi3GetInt64) REFUSE(fmi3GetInt8)
REFUSE(fmi3GetIntervalDecimal) REFUSE(fmi3GetIntervalFraction) REFUSE(fmi3GetNumberOfContinuousStates)
REFUSE(fmi3GetNumberOfVariableDependencies) REFUSE(fmi3GetOutputDerivatives) REFUSE(fmi3GetShiftDecimal)
REFUSE(fmi3GetShiftFraction) REFUSE(fmi3GetString) REFUSE(fmi3GetUInt16) REFUSE(fmi3GetUInt32) REFUSE(fmi3GetUInt64)
REFUSE(fmi3GetUInt8) REFUSE(fmi3GetVariableDependencies) REFUSE(fmi3GetVersion) REFUSE(fmi3InstantiateCoSimulation)
REFUSE(fmi3InstantiateScheduledExecution) REFUSE(fmi3SerializeFMUState) REFUSE(fmi3SerializedFMUStateSize)
REFUSE(fmi3SetBinary) REFUSE(fmi3SetBoolean) REFUSE(fmi3SetClock) REFUSE(fmi3SetDebugLogging) REFUSE(fmi3SetFMUState)
REFUSE(fmi3SetFloat32) REFUSE(fmi3SetInt16) REFUSE(fmi3SetInt32) REFUSE(fmi3SetInt64) REFUSE(fmi3SetInt8)
REFUSE(fmi3SetIntervalDecimal) REFUSE(fmi3SetIntervalFraction) REFUSE(fmi3SetShiftDecimal)
REFUSE(fmi3SetShiftFraction) REFUSE(fmi3SetString) REFUSE(fmi3SetUInt16) REFUSE(fmi3SetUInt32) REFUSE(fmi3SetUInt64)
REFUSE(fmi3SetUInt8) REFUSE(fmi3Terminate)

/* FMI 3.0 Co-Simulation interface of an estimator written by daest. */
#include "fmi3Functions.h"

#include "instance.h"

typedef struct {
    State state;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Instance;

static fmi3Status fail(Instance *m, const char *what, const char *why) {
    char text[512];
    snprintf(text, sizeof text, "%s: %s.", what, why);
    if (m && m->log) m->log(m->environment, fmi3Error, "logStatusError", text);
    return fmi3Error;
}

FMI3_Export const char *fmi3GetVersion(void) { return fmi3Version; }

FMI3_Export fmi3Status fmi3SetDebugLogging(fmi3Instance m, fmi3Boolean on, size_t n, const fmi3String names[]) {
    (void)m, (void)on, (void)n, (void)names;
    return fmi3OK;
}

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
                                                     fmi3Boolean early, const fmi3ValueReference intermediate[],
                                                     size_t n, fmi3InstanceEnvironment environment,
                                                     fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Instance *m = (Instance *)calloc(1, sizeof(Instance));
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)intermediate, (void)n;
    (void)update;
    if (!m) return NULL;
    m->environment = environment;
    m->log = log;
    if (!token || strcmp(token, INSTANTIATION_TOKEN) != 0) {
        fail(m, "fmi3InstantiateCoSimulation", "the token is not the one of this FMU");
        free(m);
        return NULL;
    }
    begin(&m->state);
    return m;
}

FMI3_Export void fmi3FreeInstance(fmi3Instance m) { free(m); }

static fmi3Status move(fmi3Instance instance, int from, int to, const char *name) {
    Instance *m = (Instance *)instance;
    if (from >= 0 && m->state.phase != from) return fail(m, name, "not allowed in the current phase");
    m->state.phase = to;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3EnterInitializationMode(fmi3Instance m, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                                   fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((Instance *)m)->state.time = start;
    return move(m, INSTANTIATED, INITIALIZATION, "fmi3EnterInitializationMode");
}

FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance m) {
    return move(m, INITIALIZATION, STEPPING, "fmi3ExitInitializationMode");
}

FMI3_Export fmi3Status fmi3Terminate(fmi3Instance m) { return move(m, -1, TERMINATED, "fmi3Terminate"); }

FMI3_Export fmi3Status fmi3Reset(fmi3Instance m) {
    begin(&((Instance *)m)->state);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_return,
                                  fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    Instance *m = (Instance *)instance;
    const char *why;
    (void)no_return;
    if (event) *event = fmi3False;
    if (terminate) *terminate = fmi3False;
    if (early) *early = fmi3False;
    if (m->state.phase != STEPPING) return fail(m, "fmi3DoStep", "not allowed in the current phase");
    why = do_step(&m->state, t, h);
    if (why) return fail(m, "fmi3DoStep", why);
    if (last) *last = t + h;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vrs[], size_t n,
                                      fmi3Float64 values[], size_t n_values) {
    Instance *m = (Instance *)instance;
    if (n != n_values) return fail(m, "fmi3GetFloat64", "all variables are scalar");
    for (size_t i = 0; i < n; ++i) {
        const double *found = knob(&m->state, vrs[i]);
        if (!found) found = dial(&m->state, vrs[i]);
        if (!found) return fail(m, "fmi3GetFloat64", "there is no Float64 variable with this value reference");
        values[i] = *found;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vrs[], size_t n,
                                      const fmi3Float64 values[], size_t n_values) {
    Instance *m = (Instance *)instance;
    if (n != n_values) return fail(m, "fmi3SetFloat64", "all variables are scalar");
    for (size_t i = 0; i < n; ++i) {
        double *found = knob(&m->state, vrs[i]);
        if (!found) return fail(m, "fmi3SetFloat64", "there is no variable to be set with this value reference");
        *found = values[i];
        if (is_tuning(vrs[i])) m->state.is_tuned = 1;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference vrs[], size_t n,
                                      fmi3Boolean values[], size_t n_values) {
    Instance *m = (Instance *)instance;
    for (size_t i = 0; i < n && i < n_values; ++i) {
        const int *found = flag(&m->state, vrs[i]);
        if (!found) return fail(m, "fmi3GetBoolean", "there is no Boolean with this value reference");
        values[i] = *found ? fmi3True : fmi3False;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference vrs[], size_t n,
                                      const fmi3Boolean values[], size_t n_values) {
    Instance *m = (Instance *)instance;
    for (size_t i = 0; i < n && i < n_values; ++i) {
        int *found = flag(&m->state, vrs[i]);
        if (!found) return fail(m, "fmi3SetBoolean", "there is no Boolean with this value reference");
        *found = values[i] ? 1 : 0;
    }
    return fmi3OK;
}

static State *state_of(fmi3Instance m) { return &((Instance *)m)->state; }
static void state_was_set(fmi3Instance m) { (void)m; }
static fmi3Status refuse(fmi3Instance m, const char *name, const char *why) { return fail((Instance *)m, name, why); }

#include "fmi3_shared.h"

NOT_SUPPORTED(fmi3GetDirectionalDerivative, VRS, const fmi3ValueReference c[], size_t d, const fmi3Float64 e[],
              size_t f, fmi3Float64 g[], size_t h)
NOT_SUPPORTED(fmi3SetTime, fmi3Float64 a)
NOT_SUPPORTED(fmi3SetContinuousStates, const fmi3Float64 a[], size_t b)
NOT_SUPPORTED(fmi3GetContinuousStates, fmi3Float64 a[], size_t b)
NOT_SUPPORTED(fmi3GetContinuousStateDerivatives, fmi3Float64 a[], size_t b)
NOT_SUPPORTED(fmi3GetNominalsOfContinuousStates, fmi3Float64 a[], size_t b)
NOT_SUPPORTED(fmi3GetNumberOfContinuousStates, size_t *a)
NOT_SUPPORTED(fmi3GetNumberOfEventIndicators, size_t *a)
NOT_SUPPORTED(fmi3GetEventIndicators, fmi3Float64 a[], size_t b)
NOT_SUPPORTED(fmi3CompletedIntegratorStep, fmi3Boolean a, fmi3Boolean *b, fmi3Boolean *c)
NOT_SUPPORTED(fmi3UpdateDiscreteStates, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *c, fmi3Boolean *d,
              fmi3Boolean *e, fmi3Float64 *f)
NOT_SUPPORTED_ALONE(fmi3EvaluateDiscreteStates)
NOT_SUPPORTED_ALONE(fmi3EnterConfigurationMode)
NOT_SUPPORTED_ALONE(fmi3ExitConfigurationMode)
NOT_SUPPORTED_ALONE(fmi3EnterEventMode)
NOT_SUPPORTED_ALONE(fmi3EnterContinuousTimeMode)

FMI3_Export fmi3Instance fmi3InstantiateModelExchange(fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d,
                                                      fmi3Boolean e, fmi3InstanceEnvironment f,
                                                      fmi3LogMessageCallback g) {
    (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g;
    return NULL;
}

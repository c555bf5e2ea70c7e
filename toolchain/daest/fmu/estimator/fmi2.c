/* FMI 2.0 Co-Simulation interface of an estimator written by daest. */
#include "fmi2Functions.h"

#include "instance.h"

typedef struct {
    State state;
    const fmi2CallbackFunctions *callbacks;
} Instance;

static fmi2Status fail(Instance *m, const char *what, const char *why) {
    if (m && m->callbacks && m->callbacks->logger)
        m->callbacks->logger(m->callbacks->componentEnvironment, MODEL_NAME, fmi2Error, "logStatusError", "%s: %s.",
                             what, why);
    return fmi2Error;
}

FMI2_Export const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
FMI2_Export const char *fmi2GetVersion(void) { return fmi2Version; }

FMI2_Export fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    (void)c, (void)on, (void)n, (void)names;
    return fmi2OK;
}

FMI2_Export fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                          fmi2Boolean logging) {
    Instance *m = (Instance *)calloc(1, sizeof(Instance));
    (void)name, (void)resources, (void)visible, (void)logging;
    if (!m) return NULL;
    m->callbacks = callbacks;
    if (type != fmi2CoSimulation || !guid || strcmp(guid, INSTANTIATION_TOKEN) != 0) {
        fail(m, "fmi2Instantiate", "not a Co-Simulation, or the guid is not the one of this FMU");
        free(m);
        return NULL;
    }
    begin(&m->state);
    return m;
}

FMI2_Export void fmi2FreeInstance(fmi2Component c) { free(c); }

FMI2_Export fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
                                           fmi2Real start, fmi2Boolean has_stop, fmi2Real stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((Instance *)c)->state.time = start;
    return fmi2OK;
}

static fmi2Status move(fmi2Component c, int from, int to, const char *name) {
    Instance *m = (Instance *)c;
    if (from >= 0 && m->state.phase != from) return fail(m, name, "not allowed in the current phase");
    m->state.phase = to;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return move(c, INSTANTIATED, INITIALIZATION, "fmi2EnterInitializationMode");
}
FMI2_Export fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    return move(c, INITIALIZATION, STEPPING, "fmi2ExitInitializationMode");
}
FMI2_Export fmi2Status fmi2Terminate(fmi2Component c) { return move(c, -1, TERMINATED, "fmi2Terminate"); }
FMI2_Export fmi2Status fmi2Reset(fmi2Component c) {
    begin(&((Instance *)c)->state);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_return) {
    Instance *m = (Instance *)c;
    const char *why;
    (void)no_return;
    if (m->state.phase != STEPPING) return fail(m, "fmi2DoStep", "not allowed in the current phase");
    why = do_step(&m->state, t, h);
    return why ? fail(m, "fmi2DoStep", why) : fmi2OK;
}

FMI2_Export fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vrs[], size_t n, fmi2Real values[]) {
    Instance *m = (Instance *)c;
    for (size_t i = 0; i < n; ++i) {
        const double *found = knob(&m->state, vrs[i]);
        if (!found) found = dial(&m->state, vrs[i]);
        if (!found) return fail(m, "fmi2GetReal", "there is no Real variable with this value reference");
        values[i] = *found;
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vrs[], size_t n,
                                   const fmi2Real values[]) {
    Instance *m = (Instance *)c;
    for (size_t i = 0; i < n; ++i) {
        double *found = knob(&m->state, vrs[i]);
        if (!found) return fail(m, "fmi2SetReal", "there is no variable to be set with this value reference");
        *found = values[i];
        if (is_tuning(vrs[i])) m->state.is_tuned = 1;
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vrs[], size_t n,
                                      fmi2Boolean values[]) {
    Instance *m = (Instance *)c;
    for (size_t i = 0; i < n; ++i) {
        const int *found = flag(&m->state, vrs[i]);
        if (!found) return fail(m, "fmi2GetBoolean", "there is no Boolean with this value reference");
        values[i] = *found ? fmi2True : fmi2False;
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vrs[], size_t n,
                                      const fmi2Boolean values[]) {
    Instance *m = (Instance *)c;
    for (size_t i = 0; i < n; ++i) {
        int *found = flag(&m->state, vrs[i]);
        if (!found) return fail(m, "fmi2SetBoolean", "there is no Boolean with this value reference");
        *found = values[i] ? 1 : 0;
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    if (!*saved) *saved = malloc(sizeof(State));
    if (!*saved) return fail((Instance *)c, "fmi2GetFMUstate", "out of memory");
    memcpy(*saved, &((Instance *)c)->state, sizeof(State));
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved) {
    memcpy(&((Instance *)c)->state, saved, sizeof(State));
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    (void)c;
    free(*saved);
    *saved = NULL;
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size) {
    (void)c, (void)saved;
    *size = sizeof(State);
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size) {
    if (size < sizeof(State)) return fail((Instance *)c, "fmi2SerializeFMUstate", "too few bytes");
    memcpy(bytes, saved, sizeof(State));
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                               fmi2FMUstate *saved) {
    if (size != sizeof(State)) return fail((Instance *)c, "fmi2DeSerializeFMUstate", "not a state of this FMU");
    if (!*saved) *saved = malloc(sizeof(State));
    if (!*saved) return fail((Instance *)c, "fmi2DeSerializeFMUstate", "out of memory");
    memcpy(*saved, bytes, sizeof(State));
    return fmi2OK;
}

#define NOT_SUPPORTED(NAME, ...) \
    FMI2_Export fmi2Status NAME(fmi2Component m, __VA_ARGS__) { return fail((Instance *)m, #NAME, "not supported"); }
#define VRS const fmi2ValueReference a[], size_t b
FMI2_Export fmi2Status fmi2GetInteger(fmi2Component m, VRS, fmi2Integer c[]) {
    (void)a, (void)c;
    return b ? fail((Instance *)m, "fmi2GetInteger", "not supported") : fmi2OK;
}
FMI2_Export fmi2Status fmi2SetInteger(fmi2Component m, VRS, const fmi2Integer c[]) {
    (void)a, (void)c;
    return b ? fail((Instance *)m, "fmi2SetInteger", "not supported") : fmi2OK;
}
FMI2_Export fmi2Status fmi2GetString(fmi2Component m, VRS, fmi2String c[]) {
    (void)a, (void)c;
    return b ? fail((Instance *)m, "fmi2GetString", "not supported") : fmi2OK;
}
FMI2_Export fmi2Status fmi2SetString(fmi2Component m, VRS, const fmi2String c[]) {
    (void)a, (void)c;
    return b ? fail((Instance *)m, "fmi2SetString", "not supported") : fmi2OK;
}
NOT_SUPPORTED(fmi2GetDirectionalDerivative, VRS, const fmi2ValueReference c[], size_t d, const fmi2Real e[],
              fmi2Real f[])
NOT_SUPPORTED(fmi2SetRealInputDerivatives, VRS, const fmi2Integer c[], const fmi2Real d[])
NOT_SUPPORTED(fmi2GetRealOutputDerivatives, VRS, const fmi2Integer c[], fmi2Real d[])
NOT_SUPPORTED(fmi2GetStatus, const fmi2StatusKind a, fmi2Status *b)
NOT_SUPPORTED(fmi2GetRealStatus, const fmi2StatusKind a, fmi2Real *b)
NOT_SUPPORTED(fmi2GetIntegerStatus, const fmi2StatusKind a, fmi2Integer *b)
NOT_SUPPORTED(fmi2GetBooleanStatus, const fmi2StatusKind a, fmi2Boolean *b)
NOT_SUPPORTED(fmi2GetStringStatus, const fmi2StatusKind a, fmi2String *b)
FMI2_Export fmi2Status fmi2CancelStep(fmi2Component m) { return fail((Instance *)m, "fmi2CancelStep", "not supported"); }

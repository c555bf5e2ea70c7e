/* FMI 3.0 Model Exchange interface of a model written by daest.
 *
 * The model itself stands in two generated files: "model.h" (sizes, value references, start values) and
 * "model.c" (functions with their forward derivatives). The FMU has two modes:
 *   ODE mode (default): plain FMI. The states x are the importer's, everything else follows from
 *       (x, u, v, w, theta, t), where v are derivatives of inputs and w are white noises.
 *   DAE mode (fmi-ls-dae, structural parameter): the unknowns xi and their derivatives dxi are the importer's,
 *       and the residuals F(dxi, xi, u, w, theta, t) can be read. Nothing is solved inside.
 * Models with events have ODE mode alone; "events.c" says what happens at one. One instance holds no global data, so several can run side by side.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

#ifndef CASADI_SYMBOL_EXPORT
#define CASADI_SYMBOL_EXPORT static
#endif
#include "model.c"
#include "model.h"

typedef int (*Evaluate)(const double **arg, double **res, casadi_int *iw, double *w, int mem);
typedef int (*Work)(casadi_int *sz_arg, casadi_int *sz_res, casadi_int *sz_iw, casadi_int *sz_w);
typedef struct {
    Evaluate evaluate, forward;
    Work work, forward_work;
    int in_dae_mode; /* arguments: 1 (dxi, xi, u, w, theta, t); 0 (x, u, v, w, theta, t) */
    int n_out;
} Function;

#define FUNCTION(NAME, DAE, N) {NAME, fwd1_##NAME, NAME##_work, fwd1_##NAME##_work, DAE, N}
static const Function RHS = FUNCTION(model_rhs, 0, N_X);
static const Function VARIABLES = FUNCTION(model_variables, 0, N_XI);
static const Function DERIVATIVES = FUNCTION(model_derivatives, 0, N_DXI);
static const Function OUTPUTS = FUNCTION(model_outputs, 0, N_Y);
static const Function RESIDUAL = FUNCTION(model_residual, 1, N_XI);
static const Function DAE_OUTPUTS = FUNCTION(model_dae_outputs, 1, N_Y);
static const Function DERIVED = FUNCTION(model_derived, 0, N_DERIVED);
static const Function *const FUNCTIONS[] = {&RHS,      &VARIABLES,   &DERIVATIVES, &OUTPUTS,
                                            &RESIDUAL, &DAE_OUTPUTS, &DERIVED};
#define N_FUNCTIONS (sizeof FUNCTIONS / sizeof *FUNCTIONS)
#define N_ARGUMENTS 6

typedef enum { INSTANTIATED, CONFIGURATION, INITIALIZATION, EVENT, RECONFIGURATION, CONTINUOUS, TERMINATED } Phase;

/* What an FMU state (fmi3GetFMUState) has to keep. */
typedef struct {
    Phase phase;
    int dae_mode;
    double time;
    double x[N_X + 1], u[N_U + 1], v[N_V + 1], w[N_W + 1], theta[N_THETA + 1], xi[N_XI + 1], dxi[N_DXI + 1];
#if HAS_EVENTS
    double ticks_done[N_TICKS + 1], due; /* how often each sample was taken; the next instant that time decides */
    unsigned char conditions[N_CONDITIONS + 1]; /* of when-clauses, at the last event */
#endif
} State;

/* Everything that can be calculated, or a tangent of it. */
typedef struct {
    double rhs[N_X + 1], xi[N_XI + 1], dxi[N_DXI + 1], y[N_Y + 1], residual[N_XI + 1], derived[N_DERIVED + 1];
} Results;

typedef struct {
    State state;
    Results results;
    int is_current; /* `results` belong to `state` */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    const double **arg;
    double **res;
    casadi_int *iw;
    double *work;
} Model;

/* ---------------------------------------------------------------------------------------------- messages */

static fmi3Status fail(Model *m, const char *format, const char *name, unsigned number) {
    char text[512];
    snprintf(text, sizeof text, format, name, number);
    if (m && m->log) m->log(m->environment, fmi3Error, "logStatusError", text);
    return fmi3Error;
}

static int inside(fmi3ValueReference vr, unsigned base, unsigned n) { return vr >= base && vr - base < n; }

/* -------------------------------------------------------------------------------------------- evaluation */

static void set_arguments(const Function *f, const State *s, const double *dxi, const double *xi, const double **arg) {
    arg[0] = f->in_dae_mode ? dxi : s->x;
    arg[1] = f->in_dae_mode ? xi : s->u;
    arg[2] = f->in_dae_mode ? s->u : s->v;
    arg[3] = s->w;
    arg[4] = s->theta;
    arg[5] = &s->time;
}

static int evaluate(Model *m, const Function *f, const double *dxi, const double *xi, double *result) {
    set_arguments(f, &m->state, dxi, xi, m->arg);
    m->res[0] = result;
    return f->n_out ? f->evaluate(m->arg, m->res, m->iw, m->work, 0) : 0;
}

/* The tangent of `f` at the current point in the direction `seed`; f's nominal result is not needed. */
static int forward(Model *m, const Function *f, const State *seed, double *result) {
    const Results *now = &m->results;
    const double *dxi = m->state.dae_mode ? m->state.dxi : now->dxi;
    const double *xi = m->state.dae_mode ? m->state.xi : now->xi;
    set_arguments(f, &m->state, dxi, xi, m->arg);
    m->arg[N_ARGUMENTS] = NULL;
    set_arguments(f, seed, seed->dxi, seed->xi, m->arg + N_ARGUMENTS + 1);
    m->res[0] = result;
    return f->n_out ? f->forward(m->arg, m->res, m->iw, m->work, 0) : 0;
}

/* A derivative of an unknown is at the same time the rate of a state, or a state: those values are exact. */
static void join_states(const State *s, const double *rhs, double *dxi) {
    for (unsigned i = 0; i < N_X; i++) {
        if (inside(STATE_RATE[i], VR_DXI, N_DXI)) dxi[STATE_RATE[i] - VR_DXI] = rhs[i];
        if (inside(STATE[i], VR_DXI, N_DXI)) dxi[STATE[i] - VR_DXI] = s->x[i];
    }
}

static fmi3Status update_ode(Model *m) {
    Results *r = &m->results;
    int bad = evaluate(m, &RHS, NULL, NULL, r->rhs);
    bad |= evaluate(m, &VARIABLES, NULL, NULL, r->xi);
    bad |= evaluate(m, &DERIVATIVES, NULL, NULL, r->dxi);
    bad |= evaluate(m, &OUTPUTS, NULL, NULL, r->y);
    join_states(&m->state, r->rhs, r->dxi);
    bad |= evaluate(m, &RESIDUAL, r->dxi, r->xi, r->residual);
    return bad ? fmi3Error : fmi3OK;
}

static fmi3Status update_dae(Model *m) {
    Results *r = &m->results;
    const State *s = &m->state;
    memcpy(r->xi, s->xi, sizeof r->xi);
    memcpy(r->dxi, s->dxi, sizeof r->dxi);
    for (unsigned i = 0; i < N_X; i++)
        r->rhs[i] = inside(STATE_RATE[i], VR_DXI, N_DXI) ? s->dxi[STATE_RATE[i] - VR_DXI] : 0.0;
    int bad = evaluate(m, &RESIDUAL, s->dxi, s->xi, r->residual);
    bad |= evaluate(m, &DAE_OUTPUTS, s->dxi, s->xi, r->y);
    return bad ? fmi3Error : fmi3OK;
}

static fmi3Status update(Model *m) {
    if (m->is_current) return fmi3OK;
    fmi3Status status = m->state.dae_mode ? update_dae(m) : update_ode(m);
    if (evaluate(m, &DERIVED, NULL, NULL, m->results.derived)) status = fmi3Error;
    if (status != fmi3OK) return fail(m, "%s could not be evaluated at this point (%u).", "The model", 0);
    m->is_current = 1;
    return fmi3OK;
}

#if HAS_EVENTS
#include "events.c"
#endif

static void set_start_values(Model *m) {
    State *s = &m->state;
    memset(s, 0, sizeof *s);
    memcpy(s->x, STATE_START, N_X * sizeof(double));
    memcpy(s->u, INPUT_START, N_U * sizeof(double));
    memcpy(s->theta, PARAMETER_START, N_THETA * sizeof(double));
    m->is_current = 0;
}

/* DAE mode starts from the point that ODE mode has reached; what ODE mode cannot tell starts from zero. */
static fmi3Status switch_mode(Model *m, int dae_mode) {
    State *s = &m->state;
    if (dae_mode == s->dae_mode) return fmi3OK;
    if (update(m) != fmi3OK) return fmi3Error;
    if (dae_mode) {
        for (unsigned i = 0; i < N_XI; i++) s->xi[i] = isfinite(m->results.xi[i]) ? m->results.xi[i] : 0.0;
        for (unsigned i = 0; i < N_DXI; i++) s->dxi[i] = isfinite(m->results.dxi[i]) ? m->results.dxi[i] : 0.0;
    } else {
        for (unsigned i = 0; i < N_X; i++) {
            if (inside(STATE[i], VR_XI, N_XI)) s->x[i] = s->xi[STATE[i] - VR_XI];
            if (inside(STATE[i], VR_DXI, N_DXI)) s->x[i] = s->dxi[STATE[i] - VR_DXI];
        }
    }
    s->dae_mode = dae_mode;
    m->is_current = 0;
    return fmi3OK;
}

/* ------------------------------------------------------------------------------------- value references */

/* Where a settable variable is kept; NULL if it cannot be set in the current mode. */
static double *knob(State *s, int dae_mode, fmi3ValueReference vr) {
    if (inside(vr, VR_U, N_U)) return &s->u[vr - VR_U];
    if (inside(vr, VR_V, N_V)) return &s->v[vr - VR_V];
    if (inside(vr, VR_W, N_W)) return &s->w[vr - VR_W];
    if (inside(vr, VR_THETA, N_THETA)) return IS_MEMORY[vr - VR_THETA] ? NULL : &s->theta[vr - VR_THETA];
    if (dae_mode && inside(vr, VR_XI, N_XI)) return &s->xi[vr - VR_XI];
    if (dae_mode && inside(vr, VR_DXI, N_DXI)) return &s->dxi[vr - VR_DXI];
    for (unsigned i = 0; i < N_X; i++)
        if (STATE[i] == vr) return &s->x[i];
    return NULL;
}

/* Where a calculated variable is kept; NULL if there is none of that value reference. */
static const double *dial(const Results *r, fmi3ValueReference vr) {
    if (inside(vr, VR_XI, N_XI)) return &r->xi[vr - VR_XI];
    if (inside(vr, VR_DXI, N_DXI)) return &r->dxi[vr - VR_DXI];
    if (inside(vr, VR_Y, N_Y)) return &r->y[vr - VR_Y];
    if (inside(vr, VR_RESIDUAL, N_XI)) return &r->residual[vr - VR_RESIDUAL];
    if (inside(vr, VR_DERIVED, N_DERIVED)) return &r->derived[vr - VR_DERIVED];
    for (unsigned i = 0; i < N_X; i++)
        if (STATE_RATE[i] == vr) return &r->rhs[i];
    return NULL;
}

static fmi3Status get_one(Model *m, fmi3ValueReference vr, double *value) {
    const double *found = vr == VR_TIME ? &m->state.time : knob(&m->state, m->state.dae_mode, vr);
    if (!found && inside(vr, VR_THETA, N_THETA)) found = &m->state.theta[vr - VR_THETA];
#if HAS_EVENTS
    if (inside(vr, VR_INDICATOR, N_ROOTS)) {
        double g[N_ROOTS + 1];
        if (indicators(m, g)) return fail(m, "%s could not be evaluated at this point (%u).", "The model", 0);
        *value = g[vr - VR_INDICATOR];
        return fmi3OK;
    }
#endif
    if (!found) {
        if (update(m) != fmi3OK) return fmi3Error;
        found = dial(&m->results, vr);
    }
    if (!found) return fail(m, "%s: there is no Float64 variable with value reference %u.", "fmi3GetFloat64", vr);
    *value = *found;
    return fmi3OK;
}

/* ---------------------------------------------------------------------------- directional derivatives */

/* The tangent is filled only for the functions that the asked unknowns come from. */
static fmi3Status tangent(Model *m, const State *seed, const fmi3ValueReference vrs[], size_t n, Results *out) {
    int rhs = 0, xi = 0, dxi = 0, y = 0, residual = 0, derived = 0, bad = 0;
    for (size_t i = 0; i < n; i++) {
        if (inside(vrs[i], VR_XI, N_XI)) xi = 1;
        else if (inside(vrs[i], VR_DXI, N_DXI)) dxi = 1;
        else if (inside(vrs[i], VR_Y, N_Y)) y = 1;
        else if (inside(vrs[i], VR_RESIDUAL, N_XI)) residual = 1;
        else if (inside(vrs[i], VR_DERIVED, N_DERIVED)) derived = 1;
        else rhs = 1;
    }
    if (m->state.dae_mode) {
        memcpy(out->xi, seed->xi, sizeof out->xi);
        memcpy(out->dxi, seed->dxi, sizeof out->dxi);
        if (residual) bad |= forward(m, &RESIDUAL, seed, out->residual);
        if (y) bad |= forward(m, &DAE_OUTPUTS, seed, out->y);
    } else {
        if (rhs || dxi) bad |= forward(m, &RHS, seed, out->rhs);
        if (xi) bad |= forward(m, &VARIABLES, seed, out->xi);
        if (dxi) bad |= forward(m, &DERIVATIVES, seed, out->dxi);
        if (dxi) join_states(seed, out->rhs, out->dxi);
        if (y) bad |= forward(m, &OUTPUTS, seed, out->y);
        /* in ODE mode the residuals are zero along every solution, and so are their derivatives */
    }
    if (derived) bad |= forward(m, &DERIVED, seed, out->derived);
    return bad ? fail(m, "%s could not be differentiated at this point (%u).", "The model", 0) : fmi3OK;
}

FMI3_Export fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                                    size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                                    const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                                    size_t nSensitivity) {
    static const char *name = "fmi3GetDirectionalDerivative";
    Model *m = (Model *)instance;
    State direction;
    Results result;
    if (nSeed != nKnowns || nSensitivity != nUnknowns)
        return fail(m, "%s: seeds and knowns, or sensitivities and unknowns, differ in number (%u).", name, 0);
    memset(&direction, 0, sizeof direction);
    memset(&result, 0, sizeof result);
    for (size_t i = 0; i < nKnowns; i++) {
        double *entry = knowns[i] == VR_TIME ? &direction.time : knob(&direction, m->state.dae_mode, knowns[i]);
        if (!entry) return fail(m, "%s: value reference %u is no known in the current mode.", name, knowns[i]);
        *entry += seed[i];
    }
    if (update(m) != fmi3OK || tangent(m, &direction, unknowns, nUnknowns, &result) != fmi3OK) return fmi3Error;
    for (size_t i = 0; i < nUnknowns; i++) {
        const double *entry = knob(&direction, m->state.dae_mode, unknowns[i]);
        if (!entry) entry = dial(&result, unknowns[i]);
        if (!entry) return fail(m, "%s: value reference %u is no unknown.", name, unknowns[i]);
        sensitivity[i] = *entry;
    }
    return fmi3OK;
}

/* ------------------------------------------------------------------------------------ life of an instance */

FMI3_Export const char *fmi3GetVersion(void) { return fmi3Version; }

FMI3_Export fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                                           const fmi3String categories[]) {
    (void)instance, (void)loggingOn, (void)nCategories, (void)categories;
    return fmi3OK; /* only errors are ever told */
}

FMI3_Export void fmi3FreeInstance(fmi3Instance instance) {
    Model *m = (Model *)instance;
    if (!m) return;
    free((void *)m->arg);
    free(m->res);
    free(m->iw);
    free(m->work);
    free(m);
}

/* The largest work arrays that any function needs, one spare element each so that none has size zero. */
static int allocate_work(Model *m) {
    casadi_int size[4] = {2 * N_ARGUMENTS + 1, 1, 0, 0}, need[4];
    for (size_t i = 0; i < 2 * N_FUNCTIONS; i++) {
        Work work = i % 2 ? FUNCTIONS[i / 2]->forward_work : FUNCTIONS[i / 2]->work;
        if (work(&need[0], &need[1], &need[2], &need[3])) return 0;
        for (int k = 0; k < 4; k++)
            if (need[k] > size[k]) size[k] = need[k];
    }
#if HAS_EVENTS
    static const Work events[] = {model_at_work, model_roots_work, model_clock_work};
    for (size_t i = 0; i < sizeof events / sizeof *events; i++) {
        if (events[i](&need[0], &need[1], &need[2], &need[3])) return 0;
        for (int k = 0; k < 4; k++)
            if (need[k] > size[k]) size[k] = need[k];
    }
#endif
    m->arg = (const double **)calloc((size_t)size[0] + 1, sizeof(double *));
    m->res = (double **)calloc((size_t)size[1] + 1, sizeof(double *));
    m->iw = (casadi_int *)calloc((size_t)size[2] + 1, sizeof(casadi_int));
    m->work = (double *)calloc((size_t)size[3] + 1, sizeof(double));
    return m->arg && m->res && m->iw && m->work;
}

FMI3_Export fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                                      fmi3String resourcePath, fmi3Boolean visible,
                                                      fmi3Boolean loggingOn, fmi3InstanceEnvironment environment,
                                                      fmi3LogMessageCallback logMessage) {
    Model *m = (Model *)calloc(1, sizeof(Model));
    (void)instanceName, (void)resourcePath, (void)visible, (void)loggingOn;
    if (!m) return NULL;
    m->environment = environment;
    m->log = logMessage;
    if (!instantiationToken || strcmp(instantiationToken, INSTANTIATION_TOKEN) != 0)
        fail(m, "%s: the token is not the one of this FMU (%u).", "fmi3InstantiateModelExchange", 0);
    else if (allocate_work(m)) {
        set_start_values(m);
        return m;
    }
    fmi3FreeInstance(m);
    return NULL;
}

static fmi3Status move(fmi3Instance instance, unsigned allowed, Phase next, const char *name) {
    Model *m = (Model *)instance;
    if (!(allowed & (1u << m->state.phase))) return fail(m, "%s is not allowed in the current phase (%u).", name, m->state.phase);
    m->state.phase = next;
    return fmi3OK;
}

#define IN(PHASE) (1u << PHASE)
#define ANY (~0u)

FMI3_Export fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
    Phase now = ((Model *)instance)->state.phase;
    return move(instance, IN(INSTANTIATED) | IN(EVENT), now == EVENT ? RECONFIGURATION : CONFIGURATION,
                "fmi3EnterConfigurationMode");
}

FMI3_Export fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
    Phase now = ((Model *)instance)->state.phase;
    return move(instance, IN(CONFIGURATION) | IN(RECONFIGURATION), now == RECONFIGURATION ? EVENT : INSTANTIATED,
                "fmi3ExitConfigurationMode");
}

FMI3_Export fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                                   fmi3Float64 tolerance, fmi3Float64 startTime,
                                                   fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    Model *m = (Model *)instance;
    (void)toleranceDefined, (void)tolerance, (void)stopTimeDefined, (void)stopTime;
    m->state.time = startTime;
    m->is_current = 0;
    return move(instance, IN(INSTANTIATED), INITIALIZATION, "fmi3EnterInitializationMode");
}

FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
#if HAS_EVENTS
    Model *m = (Model *)instance;
    if (m->state.phase == INITIALIZATION && !start_mode(m))
        return fail(m, "%s: the switches of the model find no common state (%u).", "fmi3ExitInitializationMode", 0);
#endif
    return move(instance, IN(INITIALIZATION), EVENT, "fmi3ExitInitializationMode");
}

FMI3_Export fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    return move(instance, IN(CONTINUOUS) | IN(EVENT), EVENT, "fmi3EnterEventMode");
}

FMI3_Export fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
    return move(instance, IN(EVENT) | IN(CONTINUOUS), CONTINUOUS, "fmi3EnterContinuousTimeMode");
}

FMI3_Export fmi3Status fmi3Terminate(fmi3Instance instance) {
    return move(instance, ANY, TERMINATED, "fmi3Terminate");
}

FMI3_Export fmi3Status fmi3Reset(fmi3Instance instance) {
    set_start_values((Model *)instance);
    return fmi3OK;
}

/* ---------------------------------------------------------------------------------------------- variables */

FMI3_Export fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vrs[], size_t nVrs,
                                      fmi3Float64 values[], size_t nValues) {
    Model *m = (Model *)instance;
    if (nVrs != nValues) return fail(m, "%s: all variables are scalar, %u values expected.", "fmi3GetFloat64", (unsigned)nVrs);
    for (size_t i = 0; i < nVrs; i++)
        if (get_one(m, vrs[i], &values[i]) != fmi3OK) return fmi3Error;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vrs[], size_t nVrs,
                                      const fmi3Float64 values[], size_t nValues) {
    Model *m = (Model *)instance;
    if (nVrs != nValues) return fail(m, "%s: all variables are scalar, %u values expected.", "fmi3SetFloat64", (unsigned)nVrs);
    for (size_t i = 0; i < nVrs; i++) {
        double *place = knob(&m->state, m->state.dae_mode, vrs[i]);
        if (!place) return fail(m, "%s: the variable with value reference %u cannot be set in this mode.", "fmi3SetFloat64", vrs[i]);
        *place = values[i];
    }
    m->is_current = 0;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference vrs[], size_t nVrs,
                                      fmi3Boolean values[], size_t nValues) {
    Model *m = (Model *)instance;
    for (size_t i = 0; i < nVrs && i < nValues; i++) {
        if (vrs[i] != VR_DAE_MODE) return fail(m, "%s: there is no Boolean with value reference %u.", "fmi3GetBoolean", vrs[i]);
        values[i] = m->state.dae_mode ? fmi3True : fmi3False;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference vrs[], size_t nVrs,
                                      const fmi3Boolean values[], size_t nValues) {
    Model *m = (Model *)instance;
    if (m->state.phase != CONFIGURATION && m->state.phase != RECONFIGURATION)
        return fail(m, "%s: structural parameters can be set in configuration mode only (%u).", "fmi3SetBoolean", 0);
    for (size_t i = 0; i < nVrs && i < nValues; i++) {
        if (vrs[i] != VR_DAE_MODE) return fail(m, "%s: there is no Boolean with value reference %u.", "fmi3SetBoolean", vrs[i]);
        if (switch_mode(m, values[i] ? 1 : 0) != fmi3OK) return fmi3Error;
    }
    return fmi3OK;
}

/* ---------------------------------------------------------------------------------------- model exchange */

FMI3_Export fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
    Model *m = (Model *)instance;
    m->state.time = time;
    m->is_current = 0;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 x[], size_t n) {
    if (n != N_X) return fail((Model *)instance, "%s: this model has %u states.", "fmi3SetContinuousStates", N_X);
    return fmi3SetFloat64(instance, STATE, n, x, n);
}

FMI3_Export fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 x[], size_t n) {
    if (n != N_X) return fail((Model *)instance, "%s: this model has %u states.", "fmi3GetContinuousStates", N_X);
    return fmi3GetFloat64(instance, STATE, n, x, n);
}

FMI3_Export fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 rates[], size_t n) {
    Model *m = (Model *)instance;
    if (n != N_X) return fail(m, "%s: this model has %u states.", "fmi3GetContinuousStateDerivatives", N_X);
    if (m->state.dae_mode) return fmi3GetFloat64(instance, STATE_RATE, n, rates, n);
    if (evaluate(m, &RHS, NULL, NULL, rates)) return fail(m, "%s could not be evaluated at this point (%u).", "The model", 0);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t n) {
    if (n != N_X) return fail((Model *)instance, "%s: this model has %u states.", "fmi3GetNominalsOfContinuousStates", N_X);
    memcpy(nominals, STATE_NOMINAL, N_X * sizeof(double));
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *n) {
    (void)instance;
    *n = N_X;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *n) {
    (void)instance;
    *n = N_ROOTS;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 values[], size_t n) {
    Model *m = (Model *)instance;
    if (n != N_ROOTS) return fail(m, "%s: this model has %u event indicators.", "fmi3GetEventIndicators", N_ROOTS);
#if HAS_EVENTS
    if (indicators(m, values)) return fail(m, "%s could not be evaluated at this point (%u).", "The model", 0);
#endif
    (void)values;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUState,
                                                   fmi3Boolean *enterEventMode, fmi3Boolean *terminate) {
    (void)instance, (void)noSetFMUState;
    *enterEventMode = fmi3False;
    *terminate = fmi3False;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
    (void)instance;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *needUpdate, fmi3Boolean *terminate,
                                                fmi3Boolean *nominalsChanged, fmi3Boolean *valuesChanged,
                                                fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime) {
    *needUpdate = *terminate = *nominalsChanged = *valuesChanged = *nextEventTimeDefined = fmi3False;
    *nextEventTime = 0.0;
#if HAS_EVENTS
    Model *m = (Model *)instance;
    int is_moved = 0;
    if (!happen(m, &is_moved))
        return fail(m, "%s: the switches of the model find no common state (%u).", "fmi3UpdateDiscreteStates", 0);
    *valuesChanged = is_moved ? fmi3True : fmi3False;
    if (isfinite(m->state.due)) {
        *nextEventTimeDefined = fmi3True;
        *nextEventTime = m->state.due;
    }
#endif
    (void)instance;
    return fmi3OK;
}

/* -------------------------------------------------------------------------------- what all FMUs share */

static State *state_of(fmi3Instance instance) { return &((Model *)instance)->state; }
static void state_was_set(fmi3Instance instance) { ((Model *)instance)->is_current = 0; }
static fmi3Status refuse(fmi3Instance instance, const char *name, const char *why) {
    char text[256];
    snprintf(text, sizeof text, "%s: %s.", name, why);
    return fail((Model *)instance, "%s", text, 0);
}

#include "fmi3_shared.h"

NOT_SUPPORTED(fmi3DoStep, fmi3Float64 a, fmi3Float64 b, fmi3Boolean c, fmi3Boolean *d, fmi3Boolean *e, fmi3Boolean *f,
              fmi3Float64 *g)

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d, fmi3Boolean e,
                                                     fmi3Boolean f, fmi3Boolean g, const fmi3ValueReference h[], size_t i,
                                                     fmi3InstanceEnvironment j, fmi3LogMessageCallback k,
                                                     fmi3IntermediateUpdateCallback l) {
    (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g, (void)h, (void)i, (void)j, (void)k, (void)l;
    return NULL;
}

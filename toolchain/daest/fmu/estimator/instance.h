/* What the FMI 2 and FMI 3 interfaces of an estimator share: an instance, and where its variables are kept.
 *
 * The inputs of a communication point are one sample: fmi.DoStep(t, h) takes the inputs that were set at t, and the
 * outputs are the estimates at t, with everything measured up to then. The step h may be of any length.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "estimator.c"
#include "estimator_model.c"
#include "estimator_fmu.h"

typedef struct {
    Estimator e;
    double time, u[EST_ARRAY(EST_NU)], y[EST_ARRAY(EST_NY)];
    double start[EST_ARRAY(EST_NX)], start_std[EST_ARRAY(EST_NX)];
    int valid[EST_ARRAY(EST_NY)], start_known, phase, is_tuned;
} State;

enum { INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED };

static int inside(unsigned vr, unsigned base, int n) { return vr >= base && vr - base < (unsigned)n; }

static void begin(State *s) {
    memset(s, 0, sizeof *s);
    estimator_init(&s->e);
    for (int v = 0; v < EST_NV; ++v) s->e.value[v] = NAN, s->e.std[v] = INFINITY;
    for (int j = 0; j < EST_NY; ++j) s->valid[j] = 1, s->e.innovation[j] = NAN;
    for (int i = 0; i < EST_NX; ++i) s->start_std[i] = estimator_scale[i];
    s->e.nis = s->e.log_likelihood = s->e.time = NAN;
}

/* A number that can be set; NULL for anything else. */
static double *knob(State *s, unsigned vr) {
    if (inside(vr, VR_U, EST_NU)) return &s->u[vr - VR_U];
    if (inside(vr, VR_Y, EST_NY)) return &s->y[vr - VR_Y];
    if (inside(vr, VR_THETA, EST_NTHETA)) return &s->e.theta[vr - VR_THETA];
    if (inside(vr, VR_INTENSITY, EST_NW)) return &s->e.intensity[vr - VR_INTENSITY];
    if (inside(vr, VR_NOISE_STD, EST_NY)) return &s->e.noise_std[vr - VR_NOISE_STD];
    if (inside(vr, VR_START, EST_NX)) return &s->start[vr - VR_START];
    if (inside(vr, VR_START_STD, EST_NX)) return &s->start_std[vr - VR_START_STD];
    return NULL;
}

/* Whether the estimator has to take over changed parameters. */
static int is_tuning(unsigned vr) {
    return inside(vr, VR_THETA, EST_NTHETA) || inside(vr, VR_INTENSITY, EST_NW) || inside(vr, VR_NOISE_STD, EST_NY);
}

static int *flag(State *s, unsigned vr) {
    if (inside(vr, VR_VALID, EST_NY)) return &s->valid[vr - VR_VALID];
    return vr == VR_START_KNOWN ? &s->start_known : NULL;
}

static const double *dial(const State *s, unsigned vr) {
    if (vr == VR_TIME) return &s->time;
    if (inside(vr, VR_VALUE, EST_NV)) return &s->e.value[vr - VR_VALUE];
    if (inside(vr, VR_STD, EST_NV)) return &s->e.std[vr - VR_STD];
    if (inside(vr, VR_INNOVATION, EST_NY)) return &s->e.innovation[vr - VR_INNOVATION];
    if (vr == VR_NIS) return &s->e.nis;
    if (vr == VR_LOG_LIKELIHOOD) return &s->e.log_likelihood;
    if (vr == VR_SAMPLE_TIME) return &s->e.time;
    return NULL;
}

/* One communication step; the reason why not, or NULL. */
static const char *do_step(State *s, double t, double h) {
    if (!(h > 0)) return "the communication step is not above zero";
    if (s->is_tuned && estimator_tuned(&s->e)) return "the parameters give no finite model";
    s->is_tuned = 0;
    if (s->start_known && !s->e.has_sample) {
        est_real cov[EST_ARRAY(EST_NX * EST_NX)];
        memset(cov, 0, sizeof cov);
        for (int i = 0; i < EST_NX; ++i) cov[i * EST_NX + i] = s->start_std[i] * s->start_std[i];
        estimator_set_state(&s->e, s->start, cov);
    }
    switch (estimator_step(&s->e, t, s->u, s->y, s->valid)) {
    case EST_OK: break;
    case EST_SINGULAR: return "an output can be predicted without error: give it a noise above zero";
    case EST_BAD_TIME: return "the time does not increase";
    default: return "the model is not finite over this step";
    }
    s->time = t + h;
    return NULL;
}

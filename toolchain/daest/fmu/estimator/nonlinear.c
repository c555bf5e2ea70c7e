/* The extended or the unscented Kalman filter of a nonlinear model for any steps and missing outputs, with an implicit
 * exponential step: the filter of local_filter.c, sample by sample.
 */
#include "estimator.h"

#define real est_real
#define casadi_int long long int
#define NX EST_NX
#define NU EST_NUB
#define NW EST_NW
#define NY EST_NY
#define NG EST_NG
#define NP EST_NTHETA
#include "substep.c"
#if EST_NG > 0
#include "project.c"
#endif
#include "local_filter.c"

enum { NS = NX + NW };

/* Memory of the generated functions, for the length of one call of estimator_step. */
typedef struct {
    Model m;
    real r[AT_LEAST_ONE(NY)], w[EST_SZ_W + 1];
    casadi_int iw[EST_SZ_IW + 1];
    const real *arg[EST_SZ_ARG + 10];
    real *res[EST_SZ_RES + 5];
} Work;

static void begin_work(Work *k, const Estimator *e) {
    const Model m = {e->theta, e->intensity, k->r, estimator_nominal, 0, k->iw, k->w, k->arg, k->res};
    k->m = m;
    for (int j = 0; j < NY; ++j) k->r[j] = e->noise_std[j] * e->noise_std[j];
}

/* Values and standard deviations of the internal variables. */
static int tell(Estimator *e, Work *k) {
    static const real quiet[AT_LEAST_ONE(NW)] = {0};
    real slopes[AT_LEAST_ONE(EST_NV * NS)], t = (real)e->time;
    k->arg[0] = e->mean;
    k->arg[1] = e->ubar;
    k->arg[2] = e->ubar + EST_NU;
    k->arg[3] = quiet;
    k->arg[4] = e->theta;
    k->arg[5] = &t;
    k->res[0] = e->value;
    k->res[1] = slopes;
    if (daest_inside(k->arg, k->res, k->iw, k->w, 0)) return NOT_FINITE;
    for (int v = 0; v < EST_NV; ++v) {
        const real *row = slopes + v * NS;
        real variance = 0;
        for (int i = 0; i < NX; ++i)
            for (int j = 0; j < NX; ++j) variance += row[i] * e->cov[i * NX + j] * row[j];
        for (int j = 0; j < NW; ++j) variance += row[NX + j] * row[NX + j] * e->intensity[j] / e->step;
        e->std[v] = sqrt(variance > 0 ? variance : 0);
    }
    return DONE;
}

/* The outputs (NaN: missing) change mean and covariance; innovations and what follows from them are told. */
static int observe(Estimator *e, Work *k, const real *y) {
    int status, dof = 0;
    real nis = 0, density = 0;
    if (EST_UKF) {
        static const Weights weights = EST_WEIGHTS;
        real S[AT_LEAST_ONE(NY * NY)];
        status = unscented_update(&k->m, &weights, e->mean, e->cov, e->ubar, (real)e->time, y, e->innovation, S,
                                  &density, &nis);
    } else {
        real white[AT_LEAST_ONE(NY)], log_variance[AT_LEAST_ONE(NY)];
        status = update(&k->m, e->mean, e->cov, e->ubar, (real)e->time, y, white, log_variance, 0, 0, e->innovation, 0,
                        0, 0);
        for (int j = 0; j < NY && !status; ++j)
            if (isfinite(y[j])) {
                nis += white[j] * white[j];
                density -= (real)0.5 * (white[j] * white[j] + log_variance[j] + LOG_2PI);
            }
    }
    for (int j = 0; j < NY; ++j) dof += isfinite(y[j]) != 0;
    e->nis_dof = dof;
    e->nis = dof ? nis : (real)NAN;
    e->log_likelihood = e->log_density += density;
    return status;
}

#if EST_NG > 0
static int onto_constraints(Estimator *e, Work *k) {
    real T[XX];
    return project_estimate(&k->m, e->mean, e->cov, T, e->ubar, (real)e->time, 0);
}
#else
static int onto_constraints(const Estimator *e, const Work *k) {
    (void)e, (void)k;
    return DONE;
}
#endif

/* Mean and covariance from the last sample to the inputs u at `time`. */
static int advance_to(Estimator *e, Work *k, double time, const real *u) {
    static const int sources[EST_ARRAY(EST_NUB - EST_NU)] = EST_SLOPES;
    static const unsigned char kept[EST_ARRAY(EST_NU)] = EST_KEPT;
    const real step = (real)(time - e->time);
    real u0[AT_LEAST_ONE(NU)], u1[AT_LEAST_ONE(NU)];
    Substep work[2];
    const Interval s = {u0, u1, (real)e->time, step, (real)EST_LONGEST, !EST_UKF};
    int status;
    for (int j = 0; j < EST_NU; ++j) {
        u0[j] = e->ubar[j];
        u1[j] = kept[j] ? u0[j] : u[j];
    }
    for (int j = EST_NU; j < NU; ++j) u0[j] = u1[j] = e->ubar[j] = (u[sources[j - EST_NU]] - u0[sources[j - EST_NU]]) / step;
    if (EST_UKF) {
        static const Weights weights = EST_WEIGHTS;
        real filtered[XX], cross[XX];
        status = unscented_advance(work, &k->m, &weights, &s, e->mean, e->cov, filtered, cross, 0);
    } else
        status = advance(work, &k->m, &s, e->mean, e->cov, 0, 0, 0);
    e->step = step;
    return status;
}

int estimator_step(Estimator *e, double time, const est_real *u, const est_real *y, const int *valid) {
    Work k;
    real seen[AT_LEAST_ONE(NY)];
    int status = DONE;
    if (e->has_sample ? !(time > e->time && time - e->time < HUGE_VAL) : !isfinite(time)) return EST_BAD_TIME;
    begin_work(&k, e);
    if (e->has_sample)
        status = advance_to(e, &k, time, u);
    else
        e->step = e->period;
    for (int j = 0; j < EST_NU; ++j) e->ubar[j] = u[j];
    for (int j = 0; j < NY; ++j) seen[j] = valid[j] && isfinite(y[j]) ? y[j] : (real)NAN;
    e->time = time;
    if (!status && !e->has_sample) status = onto_constraints(e, &k);
    e->has_sample = 1;
    if (!status) status = observe(e, &k, seen);
    if (!status) status = onto_constraints(e, &k);
    if (!status) status = tell(e, &k);
    if (!status && !(all_finite(e->mean, NX) && all_finite(e->cov, XX))) status = NOT_FINITE;
    return status == DONE ? EST_OK : status == SINGULAR_INNOVATION ? EST_SINGULAR : EST_NOT_FINITE;
}

int estimator_tuned(Estimator *e) {
    (void)e;
    return EST_OK;
}

void estimator_init(Estimator *e) {
    memset(e, 0, sizeof *e);
    estimator_start(e);
}

void estimator_set_state(Estimator *e, const est_real *mean, const est_real *cov) {
    memcpy(e->mean, mean, sizeof e->mean);
    memcpy(e->cov, cov, sizeof e->cov);
}

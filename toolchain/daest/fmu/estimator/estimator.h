/* The estimator: one call a sample, no allocation, no global data, C99.
 *
 *   Estimator e;
 *   estimator_init(&e);                                  unknown start; or then estimator_set_state
 *   estimator_step(&e, time, u, y, valid);               once for every sample
 *   e.value[i], e.std[i], e.innovation[j], e.nis, e.log_likelihood
 *
 * All arrays are in the order of the names in estimator_model.c. valid[j] is 0 where output j is missing. A value
 * that the outputs so far do not determine has std = infinity and value = NaN, as has an innovation that could not
 * be predicted.
 */
#ifndef ESTIMATOR_H
#define ESTIMATOR_H

#include "estimator_sizes.h"

#ifdef ESTIMATOR_FLOAT
typedef float est_real;
#else
typedef double est_real;
#endif

#define EST_ARRAY(n) ((n) > 0 ? (n) : 1) /* C has no arrays of size zero */

enum { EST_OK = 0, EST_SINGULAR = 1, EST_BAD_TIME = 2, EST_NOT_FINITE = 3 };

#ifndef EST_NONLINEAR
/* x' = A x + B ubar + G w + b, y = C x + D ubar + H w + d + e, value = V (x, w, ubar, 1); ubar = (u, slopes of u).
 * Row by row. */
typedef struct {
    est_real A[EST_ARRAY(EST_NX * EST_NX)], B[EST_ARRAY(EST_NX * EST_NUB)], G[EST_ARRAY(EST_NX * EST_NW)];
    est_real b[EST_ARRAY(EST_NX)], C[EST_ARRAY(EST_NY * EST_NX)], D[EST_ARRAY(EST_NY * EST_NUB)];
    est_real H[EST_ARRAY(EST_NY * EST_NW)], d[EST_ARRAY(EST_NY)];
    est_real V[EST_ARRAY(EST_NV * (EST_NX + EST_NW + EST_NUB + 1))];
} EstMatrices;

/* The same over a step. */
typedef struct {
    est_real step;
    int is_known;
    est_real Phi[EST_ARRAY(EST_NX * EST_NX)], now[EST_ARRAY(EST_NX * EST_NUB)], next[EST_ARRAY(EST_NX * EST_NUB)];
    est_real drift[EST_ARRAY(EST_NX)], Q[EST_ARRAY(EST_NX * EST_NX)], R[EST_ARRAY(EST_NY * EST_NY)];
    est_real S12[EST_ARRAY(EST_NX * EST_NY)], N[EST_ARRAY(EST_NW * EST_NY)], noise[EST_ARRAY(EST_NW)];
} EstSampled;

/* What the outputs of the last sample change. */
typedef struct {
    est_real innovation[EST_ARRAY(EST_NY)], slope[EST_ARRAY(EST_NY * EST_NQ)], white[EST_ARRAY(EST_NY * EST_NY)];
    est_real C[EST_ARRAY(EST_NY * EST_NX)], root[EST_ARRAY(EST_NP * (EST_NP + 1))], log_density;
} EstUpdate;
#endif

typedef struct {
    /* Results of the last sample. */
    double time; /* in double precision always: a float loses the steps of a long run */
    est_real value[EST_ARRAY(EST_NV)], std[EST_ARRAY(EST_NV)], innovation[EST_ARRAY(EST_NY)];
    est_real nis, log_likelihood;
    int nis_dof;
    /* Knobs: call estimator_tuned after a change. */
    est_real theta[EST_ARRAY(EST_NTHETA)];
    est_real intensity[EST_ARRAY(EST_NW)]; /* two-sided spectral densities of the white noises */
    est_real noise_std[EST_ARRAY(EST_NY)]; /* of one sample of each output */
    est_real period;                       /* s, the step that is expected */
    /* Memory. */
    int has_sample;
    est_real step, ubar[EST_ARRAY(EST_NUB)], mean[EST_ARRAY(EST_NX)], cov[EST_ARRAY(EST_NX * EST_NX)];
    est_real log_density; /* of the samples that are done */
#ifndef EST_NONLINEAR
    int n_known, n_open; /* n_known: columns of sens with information root; n_open: those without any */
    int valid[EST_ARRAY(EST_NY)];
    est_real y[EST_ARRAY(EST_NY)], sens[EST_ARRAY(EST_NX * EST_NQ)];
    est_real root[EST_ARRAY(EST_NP * (EST_NP + 1))];
    EstMatrices m;
    EstSampled s;
    EstUpdate up;
#endif
} Estimator;

extern const char *const estimator_inputs[], *const estimator_outputs[], *const estimator_values[];
extern const char *const estimator_noises[], *const estimator_parameters[];

void estimator_init(Estimator *e);
/* Start from a mean (EST_NX) and a covariance (EST_NX x EST_NX), before the first sample. */
void estimator_set_state(Estimator *e, const est_real *mean, const est_real *cov);
/* Take over changed parameters and noise levels. Returns EST_OK or EST_NOT_FINITE. */
int estimator_tuned(Estimator *e);
/* One sample; `time` must be later than that of the sample before. After an error begin anew with estimator_init. */
int estimator_step(Estimator *e, double time, const est_real *u, const est_real *y, const int *valid);

/* In estimator_model.c, generated. */
void estimator_start(Estimator *e);
extern const est_real estimator_scale[]; /* size of each state, against which an open direction counts */
#ifdef EST_NONLINEAR
typedef int EstFunction(const est_real **arg, est_real **res, long long int *iw, est_real *w, int mem);
EstFunction daest_flow, daest_see, daest_inside;
#if EST_NG > 0
EstFunction daest_hold;
#endif
extern const est_real estimator_nominal[]; /* size of each state, by which it is pulled onto constraints */
#else
int estimator_matrices(const est_real *theta, EstMatrices *m);
#endif

#endif

/* Loops over the samples of a recording, and over particles, with the filters of local_filter.c, whose text comes
 * before this one. Besides what that needs:
 *   daest_inside (x, u, theta, t)             -> internal variables (n_v)                    (#ifdef INSIDE)
 * and NV, and the largest work sizes SZ_ARG, SZ_RES, SZ_IW, SZ_W.
 */
#include <stdlib.h>

static int make_model(Model *m, const double *theta, const double *q, const double *r, const double *scale) {
  m->theta = theta;
  m->q = q;
  m->r = r;
  m->scale = scale;
  m->iw = malloc(sizeof(casadi_int) * (SZ_IW + 1));
  m->w = malloc(sizeof(double) * (SZ_W + 1));
  m->arg = malloc(sizeof(double *) * (SZ_ARG + 10));
  m->res = malloc(sizeof(double *) * (SZ_RES + 5));
  return m->iw && m->w && m->arg && m->res;
}

static void free_model(Model *m) {
  free(m->iw);
  free(m->w);
  free((void *)m->arg);
  free(m->res);
}

/* n samples; u0, u1: inputs at the ends of the interval that follows each sample, n x NU (last: at the sample);
 * y n x NY, NaN where missing; x, P: state before the first measurement, overwritten. white, log_variance n x NY.
 * `dp` (directions x NP), `dq`, `dr`, `dx`, `dP` (overwritten) and dwhite, dlog (n x directions x NY) when
 * directions > 0. Details per sample, all or none null: predicted, filtered (NX) with covariances (XX); innovations and
 * variances (NY), each given the outputs before it in the sample; sight (NY x NX), dh/dx; transition (XX) to the
 * next sample; noise (NX x NW), covariance of the next state with the mean of the noise; turn (XX), projection of
 * the filtered estimate onto the invariants. info: sample reached. */
int daest_ekf(long n, const double *time, const double *u0, const double *u1, const double *y, double longest,
              const double *theta, const double *q, const double *r, const double *scale, double *x, double *P,
              double *white, double *log_variance, int directions, const double *dp, const double *dq,
              const double *dr, double *dx, double *dP, double *dwhite, double *dlog, double *predicted,
              double *predicted_cov, double *filtered, double *filtered_cov, double *innovations, double *variances,
              double *sight, double *transition, double *noise, double *turn, long *info) {
  Model m;
  Substep *work = malloc(2 * sizeof(Substep));
  Directions along = {
      directions, dp, dq, dr, dx, dP, malloc(sizeof(double) * (directions * XX + 1)),
      malloc(sizeof(double) * (directions * NX + 1)), malloc(sizeof(Sight) * (directions + 1)),
  };
  int has_memory = make_model(&m, theta, q, r, scale);
  int status = has_memory && work && along.dT && along.dstart && along.dsee ? DONE : NO_MEMORY;
#if NG > 0
  double T[XX];
  if (!status) status = project_estimate(&m, x, P, T, u0, time[0], &along);
#endif
  for (long i = 0; i < n && !status; ++i) {
    info[0] = i;
    if (predicted) memcpy(predicted + i * NX, x, sizeof(double) * NX);
    if (predicted_cov) memcpy(predicted_cov + i * XX, P, sizeof(double) * XX);
    status = update(&m, x, P, u0 + i * NU, time[i], y + i * NY, white + i * NY, log_variance + i * NY,
                    directions ? dwhite + i * directions * NY : 0, directions ? dlog + i * directions * NY : 0,
                    innovations ? innovations + i * NY : 0, variances ? variances + i * NY : 0,
                    sight ? sight + i * NY * NX : 0, &along);
    if (turn) {
      memset(turn + i * XX, 0, sizeof(double) * XX);
      for (int k = 0; k < NX; ++k) turn[i * XX + k * NX + k] = 1.0;
    }
#if NG > 0
    if (!status) status = project_estimate(&m, x, P, T, u0 + i * NU, time[i], &along);
    if (turn) memcpy(turn + i * XX, T, sizeof T);
#endif
    if (filtered) memcpy(filtered + i * NX, x, sizeof(double) * NX);
    if (filtered_cov) memcpy(filtered_cov + i * XX, P, sizeof(double) * XX);
    if (transition) {
      memset(transition + i * XX, 0, sizeof(double) * XX);
      for (int k = 0; k < NX; ++k) transition[i * XX + k * NX + k] = 1.0;
    }
    if (noise) memset(noise + i * NX * NW, 0, sizeof(double) * NX * NW);
    if (status || i + 1 == n) break;
    Interval s = {u0 + i * NU, u1 + i * NU, time[i], time[i + 1] - time[i], longest, 1};
    status = advance(work, &m, &s, x, P, transition ? transition + i * XX : 0, noise ? noise + i * NX * NW : 0,
                     &along);
  }
  free(along.dT);
  free(along.dstart);
  free(along.dsee);
  free(work);
  free_model(&m);
  return status;
}

/* As daest_ekf; cross (n x XX): covariance of the filtered state with the next predicted one; S n x NY x NY; log
 * densities and normalised squares per sample. weights: spread, mean0, cov0, each. */
int daest_ukf(long n, const double *time, const double *u0, const double *u1, const double *y, double longest,
              const double *theta, const double *q, const double *r, const double *scale, double *x, double *P,
              const double *weights, double *predicted, double *predicted_cov, double *filtered,
              double *filtered_cov, double *innovations, double *S, double *log_density, double *nis, double *cross,
              double *noise, long *info) {
  Model m;
  Substep *work = malloc(2 * sizeof(Substep));
  const Weights w = {weights[0], weights[1], weights[2], weights[3]};
  int status = make_model(&m, theta, q, r, scale) && work ? DONE : NO_MEMORY;
#if NG > 0
  double T[XX];
  if (!status) status = project_estimate(&m, x, P, T, u0, time[0], 0);
#endif
  for (long i = 0; i < n && !status; ++i) {
    info[0] = i;
    memcpy(predicted + i * NX, x, sizeof(double) * NX);
    memcpy(predicted_cov + i * XX, P, sizeof(double) * XX);
    status = unscented_update(&m, &w, x, P, u0 + i * NU, time[i], y + i * NY, innovations + i * NY,
                              S + i * NY * NY, log_density + i, nis + i);
#if NG > 0
    if (!status) status = project_estimate(&m, x, P, T, u0 + i * NU, time[i], 0);
#endif
    memcpy(filtered + i * NX, x, sizeof(double) * NX);
    memcpy(filtered_cov + i * XX, P, sizeof(double) * XX);
    memset(cross + i * XX, 0, sizeof(double) * XX);
    memset(noise + i * NX * NW, 0, sizeof(double) * NX * NW);
    if (status || i + 1 == n) break;
    Interval s = {u0 + i * NU, u1 + i * NU, time[i], time[i + 1] - time[i], longest, 0};
    status = unscented_advance(work, &m, &w, &s, x, P, filtered_cov + i * XX, cross + i * XX, noise + i * NX * NW);
  }
  free(work);
  free_model(&m);
  return status;
}

/* ---- many points at once, for particles ---- */

/* Mean (n x NX) and a lower root (n x XX) of the covariance of the state after one interval from each of n points; x
 * is overwritten. A point whose flow is not finite becomes NaN. */
int daest_points_advance(long n, double *x, double *root, const double *u0, const double *u1, double t, double dt,
                         double longest, const double *theta, const double *q, const double *scale) {
  Model m;
  Substep *work = malloc(2 * sizeof(Substep));
  const Interval s = {u0, u1, t, dt, longest, 1};
  int status = make_model(&m, theta, q, 0, scale) && work ? DONE : NO_MEMORY;
  for (long i = 0; i < n && !status; ++i) {
    double cov[XX] = {0};
    if (advance(work, &m, &s, x + i * NX, cov, 0, 0, 0))
      for (int k = 0; k < NX; ++k) x[i * NX + k] = NAN;
    root_of(cov, root + i * XX, NX);
  }
  free(work);
  free_model(&m);
  return status;
}

/* h (n x NY) and dh/dx (n x NY x NX) of n points. */
int daest_points_see(long n, const double *x, const double *u, double t, const double *theta, double *h, double *C) {
  Model m;
  int status = make_model(&m, theta, 0, 0, 0) ? DONE : NO_MEMORY;
  for (long i = 0; i < n && !status; ++i)
    if (call_at(daest_see, &m, x + i * NX, u, t, 0, 0, h + i * NY, C + i * NY * NX))
      for (int k = 0; k < NY; ++k) h[i * NY + k] = NAN;
  free_model(&m);
  return status;
}

#if NG > 0
/* Pull n points onto the invariants; a point that does not arrive becomes NaN. */
int daest_points_hold(long n, double *x, const double *u, double t, const double *theta, const double *scale) {
  Model m;
  double T[XX];
  int status = make_model(&m, theta, 0, 0, scale) ? DONE : NO_MEMORY;
  for (long i = 0; i < n && !status; ++i)
    if (project(&m, x + i * NX, T, u, t, 0))
      for (int k = 0; k < NX; ++k) x[i * NX + k] = NAN;
  free_model(&m);
  return status;
}
#endif

#ifdef INSIDE
/* Mean and standard deviation (NV) of the internal variables over n weighted points. */
int daest_points_inside(long n, const double *x, const double *weight, const double *u, double t,
                        const double *theta, double *mean, double *std) {
  Model m;
  double value[AT_LEAST_ONE(NV)], sum = 0.0;
  int status = make_model(&m, theta, 0, 0, 0) ? DONE : NO_MEMORY;
  memset(mean, 0, sizeof(double) * NV);
  memset(std, 0, sizeof(double) * NV);
  for (long i = 0; i < n && !status; ++i) {
    if (!(weight[i] > 0.0)) continue;
    if (call_at(daest_inside, &m, x + i * NX, u, t, 0, 0, value, 0)) status = NOT_FINITE;
    sum += weight[i];
    for (int k = 0; k < NV; ++k) {
      /* West's update: no cancellation where the mean is large. */
      double change = value[k] - mean[k], part = weight[i] / sum;
      mean[k] += part * change;
      std[k] += weight[i] * change * (value[k] - mean[k]);
    }
  }
  for (int k = 0; k < NV; ++k) std[k] = sqrt(fmax(std[k] / sum, 0.0));
  free_model(&m);
  return status;
}
#endif

/* A particle filter over the samples of a recording, LANES particles at a time; lanes.c, the functions of the model
 * and substep.c (with lanes) stand before this text.
 *
 *   model_flow  (x, u, u', theta, t, P, f, A, ramp, G), model_point_flow without P: see local_filter.c
 *   model_see   (x, u, theta, t, h, C)        outputs and their slopes
 *   model_look  (x, u, theta, t, h)           outputs
 * Compile-time constants: NX, NU, NW, NY.
 */

/* All arrays are row by row. The filter reads time (n), u0 and u1 (n x NU: inputs at the ends of the interval after
 * each sample), y (n x NY, NaN where missing), mean (NX) and root (NX x NX) of the start, z (m x NX: standard normal
 * numbers of this sample), and fills, per sample: points (m x NX), weights (m), innovations (NY) and their
 * covariances (NY x NY). Between samples it keeps ancestors and log_weights (m each); seen (m x NY: outputs of the
 * predicted means) and sight (m x NY x NX: their slopes by z) are work. */
typedef struct {
  long m;
  const double *time, *u0, *u1, *y, *theta, *q, *r, *mean, *root;
  double longest;
  int is_guided; /* z is drawn given the measurement, linearised around each particle's mean */
  const double *z;
  double *points, *weights;
  int *ancestors;
  double *innovations, *covariances, *log_weights, *seen, *sight;
  double log_likelihood, effective;
} Particles;

static const double LOG_OF_2PI = 1.8378770664093454836;

/* The particle in lane l of a block; lanes after the last particle repeat it. */
static inline long row_of(long first, long l, long m) { return first + l < m ? first + l : m - 1; }

static int all_numbers(const double *v, int n) {
  for (int i = 0; i < n; ++i)
    if (!isfinite(v[i])) return 0;
  return 1;
}

static void flow_at(const lanes_t *x, const double *u, const double *slope, const double *theta, const double *t,
                    const lanes_t *P, Slopes *out) {
  if (P)
    model_flow(x, u, slope, theta, t, P, out->f, out->A, out->ramp, out->G);
  else
    model_point_flow(x, u, slope, theta, t, out->f, out->A, out->ramp, out->G);
}

/* Slopes that are not finite become 0, so that a lost lane does not disturb the others. Returns the finite lanes. */
static bits_t clean(Slopes *at) {
  lanes_t sum = {0};
  for (int i = 0; i < NX; ++i) sum += (at->f[i] - at->f[i]) + (at->ramp[i] - at->ramp[i]);
  for (int i = 0; i < XX; ++i) sum += at->A[i] - at->A[i];
  for (int i = 0; i < NX * NW; ++i) sum += at->G[i] - at->G[i];
  const bits_t sound = (bits_t)(sum == (lanes_t){0});
  if (lanes_finite(sum)) return sound;
  for (int i = 0; i < NX; ++i) {
    at->f[i] = WHERE(sound, at->f[i], (lanes_t){0});
    at->ramp[i] = WHERE(sound, at->ramp[i], (lanes_t){0});
  }
  for (int i = 0; i < XX; ++i) at->A[i] = WHERE(sound, at->A[i], (lanes_t){0});
  for (int i = 0; i < NX * NW; ++i) at->G[i] = WHERE(sound, at->G[i], (lanes_t){0});
  return sound;
}

/* x, P (zero before) over the interval after sample k; lanes without finite slopes become NaN, with P zero. */
static void advance(const Particles *s, Substep *work, long k, lanes_t *x, lanes_t *P) {
  Substep *mean = work, *spread = work + 1;
  const double dt = s->time[k + 1] - s->time[k], *u0 = s->u0 + k * NU, *u1 = s->u1 + k * NU;
  const double wanted = ceil(dt / s->longest * (1.0 - 1e-9));
  const int n = wanted < 1.0 ? 1 : wanted > 1e6 ? 1000000 : (int)wanted;
  const double h = dt / n;
  double slope[AT_LEAST_ONE(NU)], ua[AT_LEAST_ONE(NU)], ub[AT_LEAST_ONE(NU)];
  bits_t sound = ~(bits_t){0};
  mean->with_Q = mean->with_phi = spread->with_mean = 0;
  mean->with_mean = spread->with_Q = 1;
  for (int i = 0; i < NU; ++i) slope[i] = (u1[i] - u0[i]) / dt;
  for (int part = 0; part < n; ++part) {
    lanes_t end[NX], half[XX];
    Slopes last;
    const double t = s->time[k] + part * h, after = t + h;
    for (int i = 0; i < NU; ++i) {
      ua[i] = u0[i] + (u1[i] - u0[i]) * part / n;
      ub[i] = u0[i] + (u1[i] - u0[i]) * (part + 1) / n;
    }
    flow_at(x, ua, slope, s->theta, &t, part ? P : 0, &mean->at);
    sound &= clean(&mean->at);
    solve_substep(mean, s->q, h);
    const Solution *moved = LEVEL(mean, mean->doublings), *whole;
    for (int i = 0; i < NX; ++i) end[i] = x[i] + moved->from_f[i] + moved->from_ramp[i];
    flow_at(end, ub, slope, s->theta, &after, part ? P : 0, &last);
    sound &= clean(&last);
    average(&mean->at, &last, &spread->at);
    spread->with_phi = part > 0;
    solve_substep(spread, s->q, h);
    whole = LEVEL(spread, spread->doublings);
    if (part) {
      multiply(whole->phi, P, half);
      memcpy(P, whole->Q, sizeof whole->Q);
      add_symmetric(half, whole->phi, P);
    } else
      memcpy(P, whole->Q, sizeof whole->Q);
    memcpy(x, end, sizeof end);
  }
  for (int i = 0; i < NX; ++i) sound &= (bits_t)(x[i] - x[i] == (lanes_t){0});
  for (int i = 0; i < NX; ++i) x[i] = WHERE(sound, x[i], SPREAD(NAN));
  for (int i = 0; i < XX; ++i) P[i] = WHERE(sound, P[i], (lanes_t){0});
}

#if NY > 0
/* z drawn given the outputs y of this sample, h(mean + root z) = h + H z; returns log p(z) - log q(z). */
static lanes_t guide(const Particles *s, const double *y, const lanes_t *h, const lanes_t *H, lanes_t *z) {
  lanes_t precision[XX] = {{0}}, L[XX], centre[NX] = {{0}}, log_ratio = {0}, volume = SPREAD(1.0);
  for (int i = 0; i < NX; ++i) precision[i * NX + i] += 1.0;
  for (int o = 0; o < NY; ++o) {
    if (!isfinite(y[o])) continue;
    const lanes_t *row = H + o * NX, error = y[o] - h[o];
    for (int i = 0; i < NX; ++i) {
      const lanes_t weighted = row[i] / s->r[o];
      for (int j = 0; j <= i; ++j) precision[i * NX + j] += weighted * row[j];
      centre[i] += weighted * error;
    }
  }
  root_of(precision, L, NX);
  /* L L' c = centre, and L' (z - c) = the given numbers: L' z = L^-1 centre + those. */
  for (int i = 0; i < NX; ++i) {
    for (int j = 0; j < i; ++j) centre[i] -= L[i * NX + j] * centre[j];
    centre[i] /= L[i * NX + i];
    volume *= L[i * NX + i];
    log_ratio += 0.5 * z[i] * z[i];
  }
  for (int i = NX - 1; i >= 0; --i) {
    z[i] += centre[i];
    for (int j = i + 1; j < NX; ++j) z[i] -= L[j * NX + i] * z[j];
    z[i] /= L[i * NX + i];
    log_ratio -= 0.5 * z[i] * z[i];
  }
  return log_ratio - EACH(log(volume[i]));
}
#endif

/* log p(y | x) but for a constant; -inf where the model has no value. */
static lanes_t log_density(const Particles *s, long k, const lanes_t *x) {
  const double *y = s->y + k * NY;
  lanes_t seen[AT_LEAST_ONE(NY)], value = {0};
  int any = 0;
  for (int o = 0; o < NY; ++o) any |= isfinite(y[o]);
  if (any) {
    model_look(x, s->u0 + k * NU, s->theta, s->time + k, seen);
    for (int o = 0; o < NY; ++o) {
      if (!isfinite(y[o])) continue;
      const lanes_t error = y[o] - seen[o];
      value -= error * error * (0.5 / s->r[o]);
    }
  } else
    for (int i = 0; i < NX; ++i) value += x[i] - x[i];
  return WHERE(value - value == (lanes_t){0}, value, SPREAD(-INFINITY));
}

typedef struct {
  Substep substeps[2];
  lanes_t P[XX], root[XX];
} Work;

static void draw(const Particles *s, Work *work, long k, long first) {
  const long m = s->m;
  lanes_t x[NX], z[NX], h[AT_LEAST_ONE(NY)], C[AT_LEAST_ONE(NY * NX)], H[AT_LEAST_ONE(NY * NX)];
  lanes_t log_weight = {0}, *root = work->root;
  if (k) {
    const double *before = s->points + (k - 1) * m * NX;
    for (long l = 0; l < LANES; ++l) {
      const double *old = before + s->ancestors[row_of(first, l, m)] * (long)NX;
      for (int i = 0; i < NX; ++i) x[i][l] = old[i];
    }
    advance(s, work->substeps, k - 1, x, work->P);
    root_of(work->P, root, NX);
  } else {
    for (int i = 0; i < NX; ++i) x[i] = SPREAD(s->mean[i]);
    for (int i = 0; i < XX; ++i) root[i] = SPREAD(s->root[i]);
  }
  for (long l = 0; l < LANES; ++l) {
    const long row = row_of(first, l, m);
    for (int i = 0; i < NX; ++i) z[i][l] = s->z[row * NX + i];
    log_weight[l] = s->log_weights[row];
  }
#if NY > 0
  model_see(x, s->u0 + k * NU, s->theta, s->time + k, h, C);
  bits_t sound = ~(bits_t){0};
  for (int o = 0; o < NY; ++o) sound &= (bits_t)(h[o] - h[o] == (lanes_t){0});
  for (int o = 0; o < NY; ++o)
    for (int i = 0; i < NX; ++i) {
      lanes_t sum = {0};
      for (int j = i; j < NX; ++j) sum += C[o * NX + j] * root[j * NX + i];
      H[o * NX + i] = WHERE(sound, sum, (lanes_t){0});
    }
  for (long l = 0; l < LANES && first + l < m; ++l) {
    for (int o = 0; o < NY; ++o) s->seen[(first + l) * NY + o] = h[o][l];
    for (int i = 0; i < NY * NX; ++i) s->sight[(first + l) * NY * NX + i] = H[i][l];
  }
  if (s->is_guided) {
    for (int o = 0; o < NY; ++o) h[o] = WHERE(sound, h[o], (lanes_t){0});
    log_weight += guide(s, s->y + k * NY, h, H, z);
  }
#endif
  for (int i = 0; i < NX; ++i)
    for (int j = 0; j <= i; ++j) x[i] += root[i * NX + j] * z[j];
  log_weight += log_density(s, k, x);
  double *points = s->points + k * m * NX;
  for (long l = 0; l < LANES && first + l < m; ++l) {
    for (int i = 0; i < NX; ++i) points[(first + l) * NX + i] = x[i][l];
    s->log_weights[first + l] = log_weight[l];
  }
}

/* Particles first … last - 1 of sample k: predicted, drawn, and weighed by the measurement; log weights are not yet
 * normalised. `first` is a multiple of LANES, so that the division among threads changes nothing. */
int daest_particles_draw(const Particles *s, long k, long first, long last) {
  void *memory = malloc(sizeof(Work) + sizeof(lanes_t));
  if (!memory) return NO_MEMORY;
  Work *work = (Work *)(((uintptr_t)memory + sizeof(lanes_t) - 1) / sizeof(lanes_t) * sizeof(lanes_t));
  for (long at = first; at < last; at += LANES) draw(s, work, k, at);
  free(memory);
  return DONE;
}

/* Innovation of sample k and its covariance, linearised around every predicted mean; `weights` (m) or null: alike. */
static void predict_output(const Particles *s, long k, const double *weights) {
  double total = 0.0, mean[AT_LEAST_ONE(NY)] = {0}, S[AT_LEAST_ONE(NY * NY)] = {0};
  for (long i = 0; i < s->m; ++i) {
    const double *h = s->seen + i * NY, weight = weights ? weights[i] : 1.0;
    if (!all_numbers(h, NY)) continue;
    total += weight;
    for (int o = 0; o < NY; ++o) mean[o] += weight * h[o];
  }
  if (!(total > 0.0)) return;
  for (int o = 0; o < NY; ++o) mean[o] /= total;
  for (long i = 0; i < s->m; ++i) {
    const double *h = s->seen + i * NY, *H = s->sight + i * NY * NX, weight = weights ? weights[i] : 1.0;
    if (!all_numbers(h, NY)) continue;
    for (int o = 0; o < NY; ++o)
      for (int q = 0; q <= o; ++q) {
        double sum = (h[o] - mean[o]) * (h[q] - mean[q]);
        for (int j = 0; j < NX; ++j) sum += H[o * NX + j] * H[q * NX + j];
        S[o * NY + q] += weight * sum;
      }
  }
  for (int o = 0; o < NY; ++o) {
    s->innovations[k * NY + o] = s->y[k * NY + o] - mean[o];
    for (int q = 0; q <= o; ++q) {
      const double value = S[o * NY + q] / total + (o == q ? s->r[o] : 0.0);
      s->covariances[(k * NY + o) * NY + q] = s->covariances[(k * NY + q) * NY + o] = value;
    }
  }
}

/* After all particles of sample k were drawn: normalised weights, the effective number of particles, log p(y | past)
 * and the innovation. `alike`: before this sample all weights were alike. Returns NOT_FINITE where no particle
 * explains the measurement. */
int daest_particles_weigh(Particles *s, long k, int alike) {
  const long m = s->m;
  const double *y = s->y + k * NY;
  double *weights = s->weights + k * m, top = -INFINITY, sum = 0.0, squares = 0.0, constant = 0.0;
  predict_output(s, k, alike ? 0 : weights - m);
  for (long i = 0; i < m; ++i) top = s->log_weights[i] > top ? s->log_weights[i] : top;
  if (!isfinite(top)) return NOT_FINITE;
  for (long i = 0; i < m; i += LANES) {
    lanes_t value;
    for (long l = 0; l < LANES; ++l) value[l] = s->log_weights[row_of(i, l, m)];
    value = lanes_exp(value - top);
    for (long l = 0; l < LANES && i + l < m; ++l) {
      weights[i + l] = value[l];
      sum += value[l];
      squares += value[l] * value[l];
    }
  }
  for (int o = 0; o < NY; ++o)
    if (isfinite(y[o])) constant -= 0.5 * (LOG_OF_2PI + log(s->r[o]));
  for (long i = 0; i < m; ++i) {
    weights[i] /= sum;
    s->log_weights[i] -= top + log(sum);
  }
  s->log_likelihood += top + log(sum) + constant;
  s->effective = sum * sum / squares;
  return DONE;
}

/* Systematic resampling of sample k with the uniform number `offset` in 0 … 1: `ancestors` (m) of the next sample. */
void daest_particles_resample(Particles *s, long k, double offset) {
  const double *weights = s->weights + k * s->m, share = 1.0 / (double)s->m, log_weight = -log((double)s->m);
  double reached = weights[0];
  long from = 0;
  for (long i = 0; i < s->m; ++i) {
    const double place = (offset + (double)i) * share;
    while (reached < place && from < s->m - 1) reached += weights[++from];
    s->ancestors[i] = (int)from;
    s->log_weights[i] = log_weight;
  }
}

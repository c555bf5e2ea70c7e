/* Linear recursions and products along a recording, for many right-hand sides at once. Matrices are row-major; `stride`
 * is the distance from the matrix of one sample to that of the next, 0 where one serves all. The loop over samples is the
 * outer one: the matrix of a sample is turned round once for all right-hand sides. With STATES, the slopes of gains alone
 * are compiled, for that many states (0: for any number), and with LARGE those of matrices of more than 8 rows: all sizes
 * beside each other take a compiler seconds. */

enum { MOST = 16 }; /* rows and columns of a matrix */

static inline __attribute__((always_inline)) void turned(const double *A, int rows, int columns, double *out) {
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < columns; ++j) out[j * rows + i] = A[i * columns + j];
}

#ifndef STATES

#ifdef LARGE
#define SIZES OF(9) OF(10) OF(11) OF(12) OF(13) OF(14) OF(15) OF(16)
#else
#define SIZES OF(1) OF(2) OF(3) OF(4) OF(5) OF(6) OF(7) OF(8)
#endif

static inline __attribute__((always_inline)) void recursion(long m, long steps, int n, const double *A, long stride,
                                                            const double *drive, double *states) {
  double back[MOST * MOST];
  for (long k = 0; k < steps; ++k) {
    if (k == 0 || stride) turned(A + k * stride, n, n, back);
    for (long r = 0; r < m; ++r) {
      const double *x = states + (r * (steps + 1) + k) * n, *d = drive + (r * steps + k) * n;
      double next[MOST];
      for (int i = 0; i < n; ++i) next[i] = 0.0;
      for (int j = 0; j < n; ++j)
        for (int i = 0; i < n; ++i) next[i] += back[j * n + i] * x[j];
      for (int i = 0; i < n; ++i) states[(r * (steps + 1) + k + 1) * n + i] = next[i] + d[i];
    }
  }
}

/* x[k+1] = A[k] x[k] + drive[k] of m right-hand sides: drive m x steps x n, states m x (steps + 1) x n, of which the first of
 * each is given. */
void daest_recursion(long m, long steps, long n, const double *A, long stride, const double *drive, double *states) {
  switch (n) {
#define OF(size) case size: recursion(m, steps, size, A, stride, drive, states); return;
    SIZES
#undef OF
  }
}

static inline __attribute__((always_inline)) void products(long m, long samples, int n, int p, const double *rows,
                                                           const double *A, long stride, double *out) {
  double back[MOST * MOST];
  for (long k = 0; k < samples; ++k) {
    if (k == 0 || stride) turned(A + k * stride, p, n, back);
    for (long r = 0; r < m; ++r) {
      const double *x = rows + (r * samples + k) * n;
      double value[MOST];
      for (int i = 0; i < p; ++i) value[i] = 0.0;
      for (int j = 0; j < n; ++j)
        for (int i = 0; i < p; ++i) value[i] += back[j * p + i] * x[j];
      for (int i = 0; i < p; ++i) out[(r * samples + k) * p + i] = value[i];
    }
  }
}

/* out = A[k] row for every row: rows m x samples x n, A samples x p x n, out m x samples x p. */
void daest_products(long m, long samples, long n, long p, const double *rows, const double *A, long stride, double *out) {
  if (p != n) {
    products(m, samples, (int)n, (int)p, rows, A, stride, out);
    return;
  }
  switch (n) {
#define OF(size) case size: products(m, samples, size, size, rows, A, stride, out); return;
    SIZES
#undef OF
  }
}

#else

/* out (rows x columns) = or += a (rows x inner) b (inner x columns). */
static inline __attribute__((always_inline)) void times(const double *a, const double *b, int rows, int inner, int columns,
                                                        double *out, int add) {
  for (int i = 0; i < rows; ++i) {
    double *row = out + i * columns;
    if (!add)
      for (int j = 0; j < columns; ++j) row[j] = 0.0;
    for (int l = 0; l < inner; ++l)
      for (int j = 0; j < columns; ++j) row[j] += a[i * inner + l] * b[l * columns + j];
  }
}

/* Matrices of a step: an axis of steps beside each other, or one that serves all. */
static inline __attribute__((always_inline)) const double *at(const double *all, long direction, long step, long steps,
                                                              long size, int varies) {
  return all + (varies ? direction * steps + step : direction) * size;
}

static inline __attribute__((always_inline)) void gain_slopes(
    long p, long samples, int n, int m, const double *Phi, const double *C, const double *dPhi, const double *dC,
    const double *dQ, const double *dR, const double *dS12, const long *varies, const unsigned char *seen, const double *K,
    const double *inverse, const double *P, double *dP, double *dS, double *dK) {
  const long steps = samples - 1, nn = (long)n * n, nm = (long)n * m, mm = (long)m * m;
  double closed[MOST * MOST], back[MOST * MOST], Kback[MOST * MOST], out[MOST * MOST], Cback[MOST * MOST];
  double PC[MOST * MOST], PF[MOST * MOST], left[MOST * MOST], half[MOST * MOST], d[MOST * MOST], dback[MOST * MOST];
  double dPC[MOST * MOST], r[MOST * MOST], x[MOST * MOST], y[MOST * MOST];
  for (long k = 0; k < samples; ++k) {
    const long step = k < steps ? k : steps - 1; /* nothing depends on the step behind the last sample */
    const double *F = at(Phi, 0, step, steps, nn, (int)varies[0]), *gain = K + k * nm, *cov = P + k * nn;
    const unsigned char *mask = seen + k * m;
    for (int i = 0; i < m; ++i)
      for (int j = 0; j < n; ++j) out[i * n + j] = mask[i] ? C[i * n + j] : 0.0;
    turned(out, m, n, Cback);
    turned(gain, n, m, Kback);
    times(gain, out, n, m, n, closed, 0);
    for (int i = 0; i < nn; ++i) closed[i] = F[i] - closed[i];
    turned(closed, n, n, back);
    times(cov, Cback, n, n, m, PC, 0);
    times(cov, back, n, n, n, PF, 0);
    for (long q = 0; q < p; ++q) {
      const double *dF = at(dPhi, q, step, steps, nn, (int)varies[1]), *noise = at(dQ, q, step, steps, nn, (int)varies[2]);
      const double *cross = at(dS12, q, step, steps, nm, (int)varies[3]);
      const double *now = dP + (q * samples + k) * nn;
      double *change = dS + (q * samples + k) * mm, *moved = dK + (q * samples + k) * nm;
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < n; ++j) d[i * n + j] = mask[i] ? dC[q * nm + i * n + j] : 0.0;
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) r[i * m + j] = mask[i] && mask[j] ? dR[q * mm + i * m + j] : 0.0;
      turned(d, m, n, dback);
      times(now, Cback, n, n, m, dPC, 0);
      times(cov, dback, n, n, m, dPC, 1);
      for (int i = 0; i < mm; ++i) change[i] = r[i];
      times(d, PC, m, n, m, change, 1);
      times(out, dPC, m, n, m, change, 1);
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < m; ++j) x[i * m + j] = mask[j] ? cross[i * m + j] : 0.0;
      times(dF, PC, n, n, m, x, 1);
      times(F, dPC, n, n, m, x, 1);
      times(gain, change, n, m, m, y, 0);
      for (int i = 0; i < nm; ++i) x[i] -= y[i];
      times(x, inverse + k * mm, n, m, m, moved, 0);
      if (k == steps) continue;
      times(gain, d, n, m, n, left, 0);
      for (int i = 0; i < nn; ++i) left[i] = dF[i] - left[i];
      times(left, PF, n, n, n, half, 0);
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < m; ++j) y[i * m + j] = mask[j] ? -cross[i * m + j] : 0.0;
      times(y, Kback, n, m, n, half, 1);
      double *next = dP + (q * samples + k + 1) * nn;
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) next[i * n + j] = half[i * n + j] + half[j * n + i] + noise[i * n + j];
      times(gain, r, n, m, m, y, 0);
      times(y, Kback, n, m, n, next, 1);
      times(closed, now, n, n, n, left, 0);
      times(left, back, n, n, n, next, 1);
    }
  }
}

/* What the time-varying gain changes by in p directions, with m outputs of which `seen` (samples x m) were measured: Phi (steps
 * x) n x n, C m x n and slopes with p in front, those of Phi, Q and S12 with an axis of steps = samples - 1 where `varies` says
 * so; K, the inverse of S and P of every sample. Of dP (p x samples x n x n) the first of each is given. */
void daest_gain_slopes(long p, long samples, long n, long m, const double *Phi, const double *C, const double *dPhi,
                       const double *dC, const double *dQ, const double *dR, const double *dS12, const long *varies,
                       const unsigned char *seen, const double *K, const double *inverse, const double *P, double *dP,
                       double *dS, double *dK) {
  const int states = STATES ? STATES : (int)n;
  if (m == 1) /* a loop of known length */
    gain_slopes(p, samples, states, 1, Phi, C, dPhi, dC, dQ, dR, dS12, varies, seen, K, inverse, P, dP, dS, dK);
  else
    gain_slopes(p, samples, states, (int)m, Phi, C, dPhi, dC, dQ, dR, dS12, varies, seen, K, inverse, P, dP, dS, dK);
}

#endif

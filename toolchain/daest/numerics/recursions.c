/* Linear recursions and products along a recording, for many right-hand sides at once. Matrices are row-major; `stride`
 * is the distance from the matrix of one sample to that of the next, 0 where one serves all. The loop over samples is the
 * outer one: the matrix of a sample is turned round once for all right-hand sides. */

enum { MOST = 16 }; /* rows and columns of a matrix */

static inline __attribute__((always_inline)) void turned(const double *A, int rows, int columns, double *out) {
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < columns; ++j) out[j * rows + i] = A[i * columns + j];
}

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
    OF(1) OF(2) OF(3) OF(4) OF(5) OF(6) OF(7) OF(8) OF(9) OF(10) OF(11) OF(12) OF(13) OF(14) OF(15) OF(16)
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
    OF(1) OF(2) OF(3) OF(4) OF(5) OF(6) OF(7) OF(8) OF(9) OF(10) OF(11) OF(12) OF(13) OF(14) OF(15) OF(16)
#undef OF
  }
}

static inline __attribute__((always_inline)) void congruences(long m, long steps, int n, const double *A,
                                                              const double *drive, double *states) {
  double back[MOST * MOST], left[MOST * MOST];
  const long size = (long)n * n;
  for (long k = 0; k < steps; ++k) {
    const double *F = A + k * size;
    turned(F, n, n, back);
    for (long r = 0; r < m; ++r) {
      const double *X = states + (r * (steps + 1) + k) * size, *M = drive + (r * steps + k) * size;
      double *next = states + (r * (steps + 1) + k + 1) * size;
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) left[i * n + j] = 0.0;
        for (int l = 0; l < n; ++l)
          for (int j = 0; j < n; ++j) left[i * n + j] += F[i * n + l] * X[l * n + j];
      }
      for (int i = 0; i < n; ++i) {
        double row[MOST];
        for (int j = 0; j < n; ++j) row[j] = M[i * n + j];
        for (int l = 0; l < n; ++l)
          for (int j = 0; j < n; ++j) row[j] += left[i * n + l] * back[l * n + j];
        for (int j = 0; j < n; ++j) next[i * n + j] = row[j];
      }
    }
  }
}

/* X[k+1] = A[k] X[k] A[k]' + drive[k] of m right-hand sides: A steps x n x n, drive m x steps x n x n, states m x (steps + 1)
 * x n x n, of which the first of each is given. */
void daest_congruences(long m, long steps, long n, const double *A, const double *drive, double *states) {
  switch (n) {
#define OF(size) case size: congruences(m, steps, size, A, drive, states); return;
    OF(1) OF(2) OF(3) OF(4) OF(5) OF(6) OF(7) OF(8) OF(9) OF(10) OF(11) OF(12) OF(13) OF(14) OF(15) OF(16)
#undef OF
  }
}

/* One Gauss-Newton step that pulls a state x (NX) onto invariants g(x) = 0 (NG): the shortest one, states measured
 * by `scale`. R = dg/dx (NG x NX, row-major). K = W R' (R W R')^-1 (NX x NG) with W = diag(scale^2) is left for the
 * projection of tangents, T = I - K R, and L (NG x NG) with L L' = R W R'; *moved is the largest step relative to the
 * scale. Returns 0 where R has dependent rows. */
#ifdef ESTIMATOR_FLOAT
#include <tgmath.h>
#else
#include <math.h>
#endif

#ifndef real
#define real double
#endif

enum { PROJECTIONS = 8 };

/* row (NG) := row (L L')^-1 */
static void solve_row(const real *L, real *row) {
  for (int i = 0; i < NG; ++i) {
    for (int j = 0; j < i; ++j) row[i] -= L[i * NG + j] * row[j];
    row[i] /= L[i * NG + i];
  }
  for (int i = NG - 1; i >= 0; --i) {
    for (int j = i + 1; j < NG; ++j) row[i] -= L[j * NG + i] * row[j];
    row[i] /= L[i * NG + i];
  }
}

static int projection_step(real *x, const real *g, const real *R, const real *scale, real *K, real *L,
                           real *moved) {
  for (int i = 0; i < NG; ++i)
    for (int j = 0; j < NG; ++j) {
      real sum = 0.0;
      for (int k = 0; k < NX; ++k) sum += R[i * NX + k] * scale[k] * scale[k] * R[j * NX + k];
      L[i * NG + j] = sum;
    }
  for (int i = 0; i < NG; ++i)
    for (int j = 0; j <= i; ++j) {
      real rest = L[i * NG + j];
      for (int k = 0; k < j; ++k) rest -= L[i * NG + k] * L[j * NG + k];
      /* 1e-20: two rows that differ by less than 1e-10 of their size count as dependent */
      if (i == j && !(rest > 1e-20 * L[i * NG + i])) return 0;
      L[i * NG + j] = i == j ? sqrt(rest) : rest / L[j * NG + j];
    }
  *moved = 0.0;
  for (int k = 0; k < NX; ++k) {
    real *row = K + k * NG, shift = 0.0;
    for (int i = 0; i < NG; ++i) row[i] = R[i * NX + k] * scale[k] * scale[k];
    solve_row(L, row);
    for (int i = 0; i < NG; ++i) shift += row[i] * g[i];
    x[k] -= shift;
    *moved = fmax(*moved, fabs(shift) / scale[k]);
    if (!isfinite(shift)) return 0;
  }
  return 1;
}

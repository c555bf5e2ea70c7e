/* One substep of x' = f + ramp s + A (x - x0) + G w: mean and covariance by Taylor series over h / 2^d and d doublings.
 *
 * Matrices are row-major, NX x NX. `real` is one number, or a vector of numbers (lanes) that hold one particle each;
 * `scalar` is one number for all lanes. An includer with lanes defines them, and LARGEST, IS_FINITE, WHERE, MAGNITUDE,
 * GREATER and ROOT, before this text. EVERY_LEVEL: all terms and doublings are kept, as derivatives need them again.
 * SLOPES: NX x NX ones and zeros, zero where A is always zero; without it A is taken for full.
 */
#ifdef ESTIMATOR_FLOAT
#include <tgmath.h>
#else
#include <math.h>
#endif
#include <string.h>

#ifndef real
#define real double
#endif
#ifndef scalar
#define scalar real
#define LARGEST(v) (v)
#define IS_FINITE(v) isfinite(v)
#define WHERE(condition, a, b) ((condition) ? (a) : (b))
#define MAGNITUDE(v) fabs(v)
#define GREATER(a, b) fmax(a, b)
#define ROOT(v) sqrt(v)
#endif

#ifdef SLOPES
static const unsigned char HAS_SLOPE[] = {SLOPES};
#define HAS(i, k) HAS_SLOPE[(i) * NX + (k)]
#else
#define HAS(i, k) 1
#endif
/* Before a loop over few states: it is written out, so that slopes which are zero cost nothing. */
#if defined(__GNUC__) && NX <= 8
#define WRITTEN_OUT _Pragma("GCC unroll 8")
#else
#define WRITTEN_OUT
#endif

/* Small products are part of what calls them, so that their numbers stay in registers. */
#if defined(__GNUC__) && NX <= 8
#define WHOLE inline __attribute__((always_inline))
#else
#define WHOLE
#endif

enum { DONE = 0, NOT_FINITE = 3, NO_MEMORY = 4, SINGULAR_INNOVATION = 5 };
enum { ORDER = 12, MOST_DOUBLINGS = 60 };
#ifdef EVERY_LEVEL
enum { LEVELS = MOST_DOUBLINGS + 1 };
#else
enum { LEVELS = 2 };
#endif
/* A term of a series, which the next one is made of: all are kept, or two at a time, in registers if these suffice. */
#ifdef EVERY_LEVEL
#define ROOM(term, n)
#define NEW(term, k) s->term[k]
#define OLD(term, k) s->term[k]
#define AGE(term, n)
#define HAS_RAMP(s) 1
#else
#define HAS_RAMP(s) (s)->with_ramp
#define ROOM(term, n) real new_##term[n], old_##term[n]
#define NEW(term, k) new_##term
#define OLD(term, k) old_##term
#define AGE(term, n) \
  for (int i = 0; i < (n); ++i) old_##term[i] = new_##term[i]
#endif
static const scalar RADIUS = 0.25; /* |A| s stays below: ORDER terms leave out less than 1e-13 */
/* Terms of a series below this share of the first are left out. */
#ifndef LEFT_OUT
#define LEFT_OUT 1e-16
#endif
#ifdef ESTIMATOR_FLOAT
static const scalar ROUNDED = 1e-6f; /* pivots below this share of their diagonal are rounding */
#else
static const scalar ROUNDED = 1e-14;
#endif

#define XX (NX * NX)
#define AT_LEAST_ONE(n) ((n) > 0 ? (n) : 1)

typedef struct {
  real f[NX], A[XX], ramp[NX], G[AT_LEAST_ONE(NX * NW)];
} Slopes;

static int all_finite(const real *v, int n) {
  for (int i = 0; i < n; ++i)
    if (!IS_FINITE(v[i])) return 0;
  return 1;
}

/* ---- small dense algebra, NX x NX ---- */

static WHOLE void multiply(const real *a, const real *b, real *c) {
  for (int i = 0; i < NX; ++i) {
    real row[NX] = {0};
    for (int k = 0; k < NX; ++k)
      for (int j = 0; j < NX; ++j) row[j] += a[i * NX + k] * b[k * NX + j];
    for (int j = 0; j < NX; ++j) c[i * NX + j] = row[j];
  }
}

/* c = factor A b with the slopes A */
static WHOLE void multiply_slopes(const real *A, const real *b, scalar factor, real *c) {
  WRITTEN_OUT
  for (int i = 0; i < NX; ++i) {
    real row[NX] = {0};
    WRITTEN_OUT
    for (int k = 0; k < NX; ++k)
      if (HAS(i, k))
        for (int j = 0; j < NX; ++j) row[j] += A[i * NX + k] * b[k * NX + j];
    for (int j = 0; j < NX; ++j) c[i * NX + j] = factor * row[j];
  }
}

static WHOLE void apply_slopes(const real *A, const real *v, real *out) {
  WRITTEN_OUT
  for (int i = 0; i < NX; ++i) {
    real sum = {0};
    WRITTEN_OUT
    for (int k = 0; k < NX; ++k)
      if (HAS(i, k)) sum += A[i * NX + k] * v[k];
    out[i] = sum;
  }
}

#ifdef EVERY_LEVEL
static void add_product(const real *a, const real *b, real *c) {
  for (int i = 0; i < NX; ++i)
    for (int k = 0; k < NX; ++k)
      for (int j = 0; j < NX; ++j) c[i * NX + j] += a[i * NX + k] * b[k * NX + j];
}
#endif

/* c += a b', which is symmetric */
static WHOLE void add_symmetric(const real *a, const real *b, real *c) {
  WRITTEN_OUT
  for (int i = 0; i < NX; ++i)
    for (int j = 0; j <= i; ++j) {
      real sum = c[i * NX + j];
      for (int k = 0; k < NX; ++k) sum += a[i * NX + k] * b[j * NX + k];
      c[j * NX + i] = sum;
      c[i * NX + j] = c[j * NX + i];
    }
}

static void apply(const real *a, const real *v, real *out) {
  for (int i = 0; i < NX; ++i) {
    real sum = {0};
    for (int k = 0; k < NX; ++k) sum += a[i * NX + k] * v[k];
    out[i] = sum;
  }
}

static WHOLE void add_applied(const real *a, const real *v, real *out) {
  for (int i = 0; i < NX; ++i) {
    real sum = out[i];
    for (int k = 0; k < NX; ++k) sum += a[i * NX + k] * v[k];
    out[i] = sum;
  }
}

static void symmetric(real *a) {
  for (int i = 0; i < NX; ++i)
    for (int j = 0; j < i; ++j) {
      const real mean = (scalar)0.5 * (a[i * NX + j] + a[j * NX + i]);
      a[i * NX + j] = mean;
      a[j * NX + i] = mean;
    }
}

/* ---- one substep of the linearised model ---- */

/* Solution over s of x' = A x + f + ramp tau + G w: phi = exp(A s), from_f = psi f, psi = int exp(A tau) dtau,
 * from_ramp, ramp_rate = psi ramp, and Q = int exp(A tau) D exp(A tau)' dtau. */
typedef struct {
  real phi[XX], from_f[NX], from_ramp[NX], ramp_rate[NX], Q[XX], psi[XX];
} Solution;

/* Everything that the differential of a substep needs again. */
typedef struct {
  Slopes at;
#ifdef EVERY_LEVEL
  real horner[ORDER + 1][XX], f_term[ORDER + 1][NX], ramp_term[ORDER + 1][NX];
  real nested[ORDER + 1][XX]; /* Q = step nested[1] */
#endif
  int with_Q, with_mean; /* what is wanted: the covariance, the mean */
  int with_phi; /* the transition is wanted also where no doubling needs it */
#ifndef EVERY_LEVEL
  int with_ramp; /* the right-hand side changes with time by itself, or by inputs between samples */
#endif
  int order; /* terms of the series */
  scalar length[MOST_DOUBLINGS + 1];
  Solution level[LEVELS];
  int doublings;
} Substep;

/* Solution after d doublings. */
#define LEVEL(s, d) (&(s)->level[(d) % LEVELS])

/* The smaller of the largest sums of a row and of a column: either bounds all terms of the series. */
static scalar norm(const real *A) {
  real rows = {0}, columns = {0};
  WRITTEN_OUT
  for (int i = 0; i < NX; ++i) {
    real row = {0}, column = {0};
    WRITTEN_OUT
    for (int j = 0; j < NX; ++j) {
      if (HAS(i, j)) row += MAGNITUDE(A[i * NX + j]);
      if (HAS(j, i)) column += MAGNITUDE(A[j * NX + i]);
    }
    rows = GREATER(rows, row);
    columns = GREATER(columns, column);
  }
  const scalar most = LARGEST(rows), most_of_columns = LARGEST(columns);
  return most < most_of_columns ? most : most_of_columns;
}

#ifndef EVERY_LEVEL
/* Whether the ramp changes anything; differentials of the series need its terms in any case. */
static int moves(const real *ramp) {
  real largest = {0};
  for (int i = 0; i < NX; ++i) largest = GREATER(largest, MAGNITUDE(ramp[i]));
  return LARGEST(largest) > 0;
}
#endif

static void diffusion(const real *G, const scalar *q, real *D) {
  for (int i = 0; i < NX; ++i)
    for (int j = 0; j < NX; ++j) {
      real sum = {0};
      for (int k = 0; k < NW; ++k) sum += G[i * NW + k] * q[k] * G[j * NW + k];
      D[i * NX + j] = sum;
    }
}

/* exp(A step) */
static WHOLE void series_of_phi(Substep *s, scalar step, real *phi) {
  const real *A = s->at.A;
  ROOM(horner, XX);
  for (int i = 0; i < XX; ++i) NEW(horner, s->order)[i] = A[i] * (step / (scalar)s->order);
  for (int i = 0; i < NX; ++i) NEW(horner, s->order)[i * NX + i] += (scalar)1;
  AGE(horner, XX);
  for (int k = s->order - 1; k > 0; --k) {
    multiply_slopes(A, OLD(horner, k + 1), step / (scalar)k, NEW(horner, k));
    for (int i = 0; i < NX; ++i) NEW(horner, k)[i * NX + i] += (scalar)1;
    AGE(horner, XX);
  }
  memcpy(phi, OLD(horner, 1), sizeof(real) * XX);
}

static WHOLE void series_of_mean(Substep *s, scalar step, Solution *out) {
  const real *A = s->at.A;
  ROOM(f_term, NX);
  ROOM(ramp_term, NX);
  for (int i = 0; i < NX; ++i) {
    out->from_f[i] = NEW(f_term, 1)[i] = step * s->at.f[i];
    out->ramp_rate[i] = NEW(ramp_term, 1)[i] = step * s->at.ramp[i];
    out->from_ramp[i] = (scalar)0.5 * step * NEW(ramp_term, 1)[i];
  }
  AGE(f_term, NX);
  AGE(ramp_term, NX);
  for (int k = 2; k <= s->order; ++k) {
    apply_slopes(A, OLD(f_term, k - 1), NEW(f_term, k));
    if (HAS_RAMP(s)) apply_slopes(A, OLD(ramp_term, k - 1), NEW(ramp_term, k));
    for (int i = 0; i < NX; ++i) out->from_f[i] += NEW(f_term, k)[i] *= step / (scalar)k;
    AGE(f_term, NX);
    if (!HAS_RAMP(s)) continue;
    for (int i = 0; i < NX; ++i) {
      out->ramp_rate[i] += NEW(ramp_term, k)[i] *= step / (scalar)k;
      out->from_ramp[i] += NEW(ramp_term, k)[i] * (step / (scalar)(k + 1));
    }
    AGE(ramp_term, NX);
  }
}

static WHOLE void series_of_Q(Substep *s, scalar step, const real *D, real *Q) {
  const real *A = s->at.A;
  real product[XX];
  ROOM(nested, XX);
  for (int i = 0; i < XX; ++i) NEW(nested, s->order)[i] = D[i];
  AGE(nested, XX);
  for (int k = s->order; k > 1; --k) {
    multiply_slopes(A, OLD(nested, k), step / (scalar)k, product);
    WRITTEN_OUT
    for (int i = 0; i < NX; ++i)
      for (int j = 0; j <= i; ++j) {
        NEW(nested, k - 1)[j * NX + i] = D[i * NX + j] + (product[i * NX + j] + product[j * NX + i]);
        NEW(nested, k - 1)[i * NX + j] = NEW(nested, k - 1)[j * NX + i];
      }
    AGE(nested, XX);
  }
  for (int i = 0; i < XX; ++i) Q[i] = step * OLD(nested, 1)[i];
}

static void series(Substep *s, scalar step, const real *D) {
  Solution *out = &s->level[0];
  if (s->with_phi || s->doublings) series_of_phi(s, step, out->phi);
  if (s->with_mean) series_of_mean(s, step, out);
  if (s->with_Q) series_of_Q(s, step, D, out->Q);
}

static void twice(const Substep *s, const Solution *a, scalar length, int with_phi, Solution *b) {
  if (with_phi) multiply(a->phi, a->phi, b->phi);
  if (s->with_Q) {
    real half[XX];
    multiply(a->phi, a->Q, half);
    memcpy(b->Q, a->Q, sizeof b->Q);
    add_symmetric(half, a->phi, b->Q);
  }
  if (!s->with_mean) return;
  for (int i = 0; i < NX; ++i) {
    b->from_f[i] = a->from_f[i];
    b->ramp_rate[i] = a->ramp_rate[i];
    b->from_ramp[i] = a->from_ramp[i] + length * a->ramp_rate[i];
  }
  add_applied(a->phi, a->from_f, b->from_f);
  if (!HAS_RAMP(s)) return;
  add_applied(a->phi, a->ramp_rate, b->ramp_rate);
  add_applied(a->phi, a->from_ramp, b->from_ramp);
}

/* Terms after which those of a series with growth `size` are negligible; that of Q grows from both sides. */
static int order_of(scalar size) {
  scalar term = 1.0;
  for (int k = 1; k < ORDER; ++k)
    if ((term *= size / (scalar)(k + 1)) < LEFT_OUT) return k;
  return ORDER;
}

/* With the slopes `at`; intensities q. */
static int solve_substep(Substep *s, const scalar *q, scalar h) {
  real D[XX];
  scalar size = norm(s->at.A) * h, step = h;
  if (!isfinite(size) || !all_finite(s->at.f, NX)) return NOT_FINITE;
  s->doublings = 0;
  while (size > RADIUS && s->doublings < MOST_DOUBLINGS) {
    size *= 0.5;
    step *= 0.5;
    ++s->doublings;
  }
  if (s->with_Q) diffusion(s->at.G, q, D);
#ifndef EVERY_LEVEL
  s->with_ramp = moves(s->at.ramp);
#endif
  s->order = order_of(s->with_Q ? 2.0 * size : size);
  s->length[0] = step;
  series(s, step, D);
  for (int d = 0; d < s->doublings; ++d) {
    twice(s, LEVEL(s, d), s->length[d], s->with_phi || d + 1 < s->doublings, LEVEL(s, d + 1));
    s->length[d + 1] = 2.0 * s->length[d];
  }
  return DONE;
}

/* Slopes of the covariance: A and G halfway between two ends, nothing that moves the mean. */
static void average(const Slopes *a, const Slopes *b, Slopes *out) {
  memset(out->f, 0, sizeof out->f);
  memset(out->ramp, 0, sizeof out->ramp);
  for (int i = 0; i < XX; ++i) out->A[i] = (scalar)0.5 * (a->A[i] + b->A[i]);
  for (int i = 0; i < NX * NW; ++i) out->G[i] = (scalar)0.5 * (a->G[i] + b->G[i]);
}

/* Lower triangular L with L L' = a (rows x rows), which may be singular: pivots below the rounding of their
 * diagonal give a column of zeros. */
static void root_of(const real *a, real *L, int rows) {
  const real none = {0};
  for (int j = 0; j < rows; ++j) {
    real pivot = a[j * rows + j];
    for (int k = 0; k < j; ++k) pivot -= L[j * rows + k] * L[j * rows + k];
    const real least = ROUNDED * a[j * rows + j], diagonal = WHERE(pivot > least, ROOT(pivot), none);
    for (int i = 0; i < rows; ++i) {
      real rest = a[i * rows + j];
      for (int k = 0; k < j; ++k) rest -= L[i * rows + k] * L[j * rows + k];
      L[i * rows + j] = i < j ? none : i == j ? diagonal : WHERE(pivot > least, rest / diagonal, none);
    }
  }
}

/* Time-varying Kalman filter of (47) over many samples, for `numerics/kalman_pass.py`. Matrices are row by row.

   One step, with the covariance P of the prediction and [m A], its mean and sensitivity to an unknown start:
   S = C P C' + R = L L', K = (Phi P C' + S12) S^-1, [m A] <- Phi [m A] + K ([z 0] - C [m A]) + [drive 0], and in
   Joseph form P <- F P F' + Q - K S12' - S12 K' + K R K' with F = Phi - K C. With CONSTANT states the loops have
   constant lengths; from TILES_FROM on products go tile by tile through the registers of the processor. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define UNROLLED _Pragma("GCC unroll 8") /* before a loop of constant length */
#else
#define INLINE static inline
#define UNROLLED
#endif

#if defined(__AVX512F__)
enum { LANES = 8, TILE_ROWS = 8 };
#elif defined(__AVX__)
enum { LANES = 4, TILE_ROWS = 4 };
#else
enum { LANES = 2, TILE_ROWS = 4 };
#endif
enum { TILES_FROM = 10, WINDOW = 16, TILE_VECTORS = 3 };

typedef struct {
    long n_y, n_w, columns; /* columns of [m A] */
    const double *Phi, *C, *Q, *S12, *R, *Qw, *Ne; /* one of each per mode; Qw (n_w, n_w), Ne (n_w, n_y) */
} model_t;

/* out (m, n) = A (m, k) B (k, n) */
INLINE void product(long m, long k, long n, const double *restrict A, const double *restrict B, double *restrict out)
{
    for (long i = 0; i < m; i++) {
        double *row = out + i * n;
        for (long j = 0; j < n; j++) row[j] = 0.0;
        for (long l = 0; l < k; l++) {
            const double a = A[i * k + l];
            for (long j = 0; j < n; j++) row[j] += a * B[l * n + j];
        }
    }
}

/* out (n, n) += sign A' B of A, B (k, n), from the diagonal on if `upper` */
INLINE void add_outer(long k, long n, double sign, int upper, const double *restrict A, const double *restrict B,
                      double *restrict out)
{
    for (long i = 0; i < n; i++)
        for (long l = 0; l < k; l++) {
            const double a = sign * A[l * n + i];
            for (long j = upper ? i : 0; j < n; j++) out[i * n + j] += a * B[l * n + j];
        }
}

/* out (m, n) = A (n, m)' */
INLINE void transposed(long m, long n, const double *A, double *out)
{
    for (long i = 0; i < m; i++)
        for (long j = 0; j < n; j++) out[i * n + j] = A[j * m + i];
}

#if defined(__GNUC__)
/* Vectors of the processor; in memory they begin at any number. */
typedef double lanes_t __attribute__((vector_size(LANES * 8)));
typedef double anywhere_t __attribute__((vector_size(LANES * 8), aligned(8), may_alias));

/* A tile of out = base + A B: `rows` rows by `vectors` vectors of columns, kept in registers; A[i, l] stands at
   i * down + l * across. */
INLINE void tile(const int rows, const int vectors, long k, long n, const double *A, long down, long across,
                 const double *B, const double *base, double *out)
{
    lanes_t sum[TILE_ROWS][TILE_VECTORS];
    UNROLLED for (int i = 0; i < rows; i++)
        UNROLLED for (int v = 0; v < vectors; v++) {
            if (base)
                sum[i][v] = *(const anywhere_t *)(base + i * n + v * LANES);
            else
                sum[i][v] = (lanes_t){0};
        }
    for (long l = 0; l < k; l++) {
        lanes_t b[TILE_VECTORS];
        UNROLLED for (int v = 0; v < vectors; v++) b[v] = *(const anywhere_t *)(B + l * n + v * LANES);
        UNROLLED for (int i = 0; i < rows; i++)
            UNROLLED for (int v = 0; v < vectors; v++) sum[i][v] += A[i * down + l * across] * b[v];
    }
    UNROLLED for (int i = 0; i < rows; i++)
        UNROLLED for (int v = 0; v < vectors; v++) *(anywhere_t *)(out + i * n + v * LANES) = sum[i][v];
}

/* Tiles over the columns `from` … n - 1 >= LANES; the last vectors reach back over columns that are done. */
INLINE void strip(const int rows, long k, long n, const double *A, long down, long across, const double *B,
                  const double *base, double *out, long from)
{
#define TILE(vectors, j) tile(rows, vectors, k, n, A, down, across, B + (j), base ? base + (j) : NULL, out + (j))
    long j = from;
    for (; j + TILE_VECTORS * LANES <= n; j += TILE_VECTORS * LANES) TILE(TILE_VECTORS, j);
    const long left = n - j;
    if (left > 2 * LANES && n >= 3 * LANES) {
        TILE(3, n - 3 * LANES);
    } else if (left > LANES && n >= 2 * LANES) {
        if (left > 2 * LANES) TILE(1, j);
        TILE(2, n - 2 * LANES);
    } else if (left > 0) {
        if (left > LANES) TILE(1, j);
        TILE(1, n - LANES);
    }
#undef TILE
}

/* See `times`. */
INLINE void tiled(long m, long k, long n, const double *A, long down, long across, const double *B,
                  const double *base, double *out, int upper)
{
    long i = 0;
#define STRIP(rows)                                                                                               \
    strip(rows, k, n, A + i * down, down, across, B, base ? base + i * n : NULL, out + i * n,                      \
          upper ? i / LANES * LANES : 0)
    for (; i + TILE_ROWS <= m; i += TILE_ROWS) STRIP(TILE_ROWS);
    for (; i + 2 <= m; i += 2) STRIP(2);
    if (i < m) STRIP(1);
#undef STRIP
}

static void tiled_product(long m, long k, long n, const double *A, const double *B, double *out)
{
    tiled(m, k, n, A, k, 1, B, NULL, out, 0);
}

static void tiled_upper(long n, const double *A, const double *B, const double *base, double *out)
{
    tiled(n, n, n, A, n, 1, B, base, out, 1);
}

static void tiled_outer(long k, long n, const double *A, const double *B, const double *base, double *out, int upper)
{
    tiled(n, k, n, A, 1, n, B, base, out, upper);
}
#define HAS_TILES(n) ((n) >= TILES_FROM)
#else
#define HAS_TILES(n) 0
#define tiled_product product
#define tiled_upper(n, A, B, base, out) (void)0
#define tiled_outer(k, n, A, B, base, out, upper) (void)0
#endif

/* out (m, n) = A (m, k) B (k, n) */
INLINE void times(long m, long k, long n, const double *A, const double *B, double *out)
{
    if (HAS_TILES(n))
        tiled_product(m, k, n, A, B, out);
    else
        product(m, k, n, A, B, out);
}

/* out (n, n) = base + A' B of A, B (k, n), from the diagonal on if `upper`; base and out are two matrices. */
INLINE void plus_outer(long k, long n, int upper, const double *A, const double *B, const double *base, double *out)
{
    if (HAS_TILES(n)) {
        tiled_outer(k, n, A, B, base, out, upper);
        return;
    }
    for (long i = 0; i < n; i++)
        for (long j = upper ? i : 0; j < n; j++) out[i * n + j] = base[i * n + j];
    add_outer(k, n, 1.0, upper, A, B, out);
}

/* out = Q + F P F' for symmetric P, Q, from the diagonal on; Ft = F'; `work` holds a matrix. */
INLINE void congruence(long n, const double *F, const double *Ft, const double *P, const double *Q, double *out,
                       double *work)
{
    times(n, n, n, F, P, work);
    if (HAS_TILES(n)) {
        tiled_upper(n, work, Ft, Q, out);
        return;
    }
    for (long i = 0; i < n; i++) {
        double *row = out + i * n;
        for (long j = i; j < n; j++) row[j] = Q[i * n + j];
        for (long l = 0; l < n; l++) {
            const double a = work[i * n + l];
            for (long j = i; j < n; j++) row[j] += a * Ft[l * n + j];
        }
    }
}

/* The symmetric matrix out, rows `apart` apart, of the upper triangle A (n, n), block by block. */
INLINE void mirrored(long n, const double *A, double *out, long apart)
{
    enum { SIDE = 8 };
    for (long i = 0; i < n; i++) memcpy(out + i * apart + i, A + i * n + i, (n - i) * sizeof(double));
    for (long j = 0; j < n; j += SIDE)
        for (long i = j; i < n; i++)
            for (long l = j; l < j + SIDE && l < i; l++) out[i * apart + l] = A[l * n + i];
}

/* W = L^-1 of S = L L' and inverse = W' W; 1 where S is not positive definite. */
INLINE int whitening(long n, const double *S, double *W, double *inverse, double *L)
{
    for (long i = 0; i < n; i++)
        for (long j = 0; j <= i; j++) {
            double rest = S[i * n + j];
            for (long k = 0; k < j; k++) rest -= L[i * n + k] * L[j * n + k];
            if (i == j && !(rest > 0.0)) return 1;
            L[i * n + j] = i == j ? sqrt(rest) : rest / L[j * n + j];
        }
    for (long j = 0; j < n; j++)
        for (long i = 0; i < n; i++) {
            double rest = i == j ? 1.0 : 0.0;
            for (long k = j; k < i; k++) rest -= L[i * n + k] * W[k * n + j];
            W[i * n + j] = i < j ? 0.0 : rest / L[i * n + i];
        }
    for (long i = 0; i < n; i++)
        for (long j = 0; j < n; j++) {
            double sum = 0.0;
            for (long k = i > j ? i : j; k < n; k++) sum += W[k * n + i] * W[k * n + j];
            inverse[i * n + j] = sum;
        }
    return 0;
}

/* Gain and covariance of (x, w) after the outputs, `estimation.kalman`; PCt = C P (n_y, n). That of x in Joseph
   form, (I - K C) P (I - K C)' + K R K', by products with K and C alone. */
INLINE void filtered(long n, const model_t *g, long mode, const double *P, const double *PCt, const double *S,
                     const double *inverse, double *gain, double *cov, double *work)
{
    const long n_y = g->n_y, n_w = g->n_w, size = n + n_w;
    const double *R = g->R + mode * n_y * n_y, *Ne = g->Ne + mode * n_w * n_y, *Qw = g->Qw + mode * n_w * n_w;
    double *Kt = work, *rest = Kt + n_y * n, *minus = rest + n_y * n, *D = minus + n_y * n, *other = D + n * n;
    times(n_y, n_y, n, inverse, PCt, Kt);
    transposed(n, n_y, Kt, gain);
    product(n_w, n_y, n_y, Ne, inverse, gain + n * n_y);
    for (long y = 0; y < n_y; y++) /* (K R)' - ((I - K C) P C')' */
        for (long i = 0; i < n; i++) {
            double sum = -PCt[y * n + i];
            for (long v = 0; v < n_y; v++)
                sum += Kt[v * n + i] * (R[v * n_y + y] + (S[v * n_y + y] - R[v * n_y + y]));
            rest[y * n + i] = sum;
        }
    for (long i = 0; i < n_y * n; i++) minus[i] = -PCt[i];
    plus_outer(n_y, n, 1, Kt, minus, P, other);
    plus_outer(n_y, n, 1, rest, Kt, other, D);
    mirrored(n, D, cov, size);
    for (long i = 0; i < size; i++)
        for (long j = n; j < size; j++) {
            double sum = i < n ? 0.0 : Qw[(i - n) * n_w + j - n];
            for (long y = 0; y < n_y; y++) sum -= gain[i * n_y + y] * Ne[(j - n) * n_y + y];
            cov[i * size + j] = cov[j * size + i] = sum;
        }
}

/* Largest |one - other| in standard deviations of the larger of both; `size` holds 2 n numbers. */
INLINE double distance(long n, const double *one, const double *other, double *size)
{
    double worst = 0.0, *largest = size + n; /* of each column, so that vectors of the processor do it */
    for (long i = 0; i < n; i++) {
        const double larger = fmax(one[i * n + i], other[i * n + i]);
        size[i] = larger > 0.0 ? 1.0 / sqrt(larger) : 0.0;
        largest[i] = 0.0;
    }
    for (long i = 0; i < n; i++) {
        const double *restrict now = one + i * n, *restrict before = other + i * n, root = size[i];
        if (!(root > 0.0)) { /* without any variance: nothing may differ */
            for (long j = 0; j < n; j++)
                if (now[j] != before[j]) return INFINITY;
            continue;
        }
        for (long j = 0; j <= i; j++) {
            const double share = fabs(now[j] - before[j]) * (root * size[j]);
            largest[j] = share > largest[j] ? share : largest[j];
        }
    }
    for (long j = 0; j < n; j++) worst = largest[j] > worst ? largest[j] : worst;
    return worst;
}

/* Whether a sequence whose changes are told has come to within `limit` of its end: the largest changes of two
   windows tell how fast they die out, and what all further ones add up to at most. */
typedef struct {
    long count;
    double now, before;
} settling_t;

INLINE int settled(settling_t *s, double change, double limit)
{
    s->now = fmax(s->now, change);
    if (++s->count < WINDOW) return 0;
    const double ratio = s->before > 0.0 ? s->now / s->before : 1.0;
    const int is_settled = s->now == 0.0 || (ratio < 1.0 && WINDOW * s->now * ratio / (1.0 - ratio) <= limit);
    s->before = s->now;
    s->now = 0.0;
    s->count = 0;
    return is_settled;
}

/* See `daest_kalman`. */
INLINE long run(const long n, const model_t *g, long n_samples, const long long *mode, const long long *long_after,
                const double *z, const double *drive, const double *target, const char *has_target, double limit,
                double *M, double *P, double *predicted, double *nu, double *A, double *S, double *white,
                double *gain, double *cov, double *filter_gain, double *filtered_cov, double *work)
{
    const long n_y = g->n_y, columns = g->columns, size = n + g->n_w;
    double *Phit = work, *F = Phit + n * n, *Ft = F + n * n, *after = Ft + n * n, *rest = after + n * n;
    double *PCt = rest + 2 * n * n + 3 * n_y * n, *Gt = PCt + n_y * n, *Kt = Gt + n_y * n, *RKt = Kt + n_y * n;
    double *St = RKt + n_y * n, *Mt = St + n_y * n, *next = Mt + columns * n, *seen = next + columns * n;
    double *L = seen + columns * n_y, *inverse = L + n_y * n_y, *minus = inverse + n_y * n_y;
    settling_t settling = {0, 0.0, 0.0};
    const long asked = n_samples;
    long latest = -1;
    int has_cross = 0;
    transposed(columns, n, M, Mt);
    for (long k = 0; k < n_samples; k++) {
        const long m = (long)mode[k];
        const double *Phi = g->Phi + m * n * n, *C = g->C + m * n_y * n, *R = g->R + m * n_y * n_y;
        const double *Q = g->Q + m * n * n;
        double *Sk = S + k * n_y * n_y;
        if (m != latest) {
            transposed(n, n, Phi, Phit);
            transposed(n_y, n, g->S12 + m * n * n_y, St);
            has_cross = 0;
            for (long i = 0; i < n * n_y; i++) has_cross |= St[i] != 0.0;
            latest = m;
        }
        if (cov) memcpy(cov + k * n * n, P, n * n * sizeof(double));
        times(n_y, n, n, C, P, PCt);
        for (long y = 0; y < n_y; y++)
            for (long v = 0; v < n_y; v++) {
                double sum = R[y * n_y + v];
                for (long i = 0; i < n; i++) sum += PCt[y * n + i] * C[v * n + i];
                Sk[y * n_y + v] = sum;
            }
        if (whitening(n_y, Sk, white + k * n_y * n_y, inverse, L)) return -1 - k;
        times(n_y, n, n, PCt, Phit, Gt);
        for (long i = 0; i < n_y * n; i++) Gt[i] += St[i];
        times(n_y, n_y, n, inverse, Gt, Kt);
        transposed(n, n_y, Kt, gain + k * n * n_y);

        for (long c = 0; c < columns; c++)
            for (long y = 0; y < n_y; y++) {
                double sum = 0.0;
                for (long i = 0; i < n; i++) sum += Mt[c * n + i] * C[y * n + i];
                seen[c * n_y + y] = c ? -sum : z[k * n_y + y] - sum;
            }
        memcpy(nu + k * n_y, seen, n_y * sizeof(double));
        memcpy(predicted + k * n, Mt, n * sizeof(double));
        if (A) transposed(n, columns - 1, Mt + n, A + k * n * (columns - 1));
        times(columns, n, n, Mt, Phit, next);
        times(columns, n_y, n, seen, Kt, Mt);
        for (long i = 0; i < columns * n; i++) Mt[i] += next[i];
        for (long i = 0; i < n; i++) Mt[i] += drive[k * n + i];

        if (filtered_cov)
            filtered(n, g, m, P, PCt, Sk, inverse, filter_gain + k * size * n_y, filtered_cov + k * size * size, rest);
        for (long i = 0; i < n_y * n; i++) minus[i] = -Kt[i];
        plus_outer(n_y, n, 0, minus, C, Phi, F);
        plus_outer(n_y, n, 0, C, minus, Phit, Ft);
        congruence(n, F, Ft, P, Q, after, rest);
        times(n_y, n_y, n, R, Kt, RKt);
        for (long i = 0; i < n_y * n; i++) RKt[i] -= St[i]; /* K R K' - K S12' - S12 K' = K (R K' - S12') - S12 K' */
        plus_outer(n_y, n, 1, Kt, RKt, after, rest);
        if (has_cross) {
            plus_outer(n_y, n, 1, St, minus, rest, after);
            mirrored(n, after, rest, n);
            memcpy(after, rest, n * n * sizeof(double));
        } else {
            mirrored(n, rest, after, n);
        }
        if (!isfinite(after[0])) return -1 - k;

        int is_steady = 0;
        if (k + 1 < n_samples && n_samples == asked && mode[k + 1] == m && long_after[k + 1]) {
            if (has_target[m])
                is_steady = distance(n, after, target + m * n * n, rest) <= limit;
            else
                is_steady = settled(&settling, distance(n, after, P, rest), limit);
        } else {
            settling.count = 0;
            settling.now = settling.before = 0.0;
        }
        memcpy(P, after, n * n * sizeof(double));
        if (is_steady) n_samples = k + 2;
    }
    transposed(n, columns, Mt, M);
    return n_samples;
}

/* The predictor with a constant gain K: x <- F x + K z + drive with F = Phi - K C; x is that after the samples. */
INLINE void constant(const long n, long n_y, long n_samples, const double *F, const double *K, const double *C,
                     const double *z, const double *drive, double *x, double *predicted, double *nu)
{
    for (long k = 0; k < n_samples; k++) {
        double *now = predicted + k * n;
        for (long i = 0; i < n; i++) now[i] = x[i];
        for (long y = 0; y < n_y; y++) {
            double sum = z[k * n_y + y];
            for (long i = 0; i < n; i++) sum -= C[y * n + i] * now[i];
            nu[k * n_y + y] = sum;
        }
        for (long i = 0; i < n; i++) {
            double sum = drive ? drive[k * n + i] : 0.0;
            for (long j = 0; j < n; j++) sum += F[i * n + j] * now[j];
            for (long y = 0; y < n_y; y++) sum += K[i * n_y + y] * z[k * n_y + y];
            x[i] = sum;
        }
    }
}

void daest_constant(long n, long n_y, long n_samples, const double *F, const double *K, const double *C, const double *z,
                    const double *drive, double *x, double *predicted, double *nu)
{
#define CONSTANT_GAIN(N, Y) constant(N, Y, n_samples, F, K, C, z, drive, x, predicted, nu)
#ifdef CONSTANT
    if (n == CONSTANT && n_y == 1) { CONSTANT_GAIN(CONSTANT, 1); return; }
    if (n == CONSTANT && n_y == 2) { CONSTANT_GAIN(CONSTANT, 2); return; }
#endif
    CONSTANT_GAIN(n, n_y);
}

/* Filter samples 0 … n_samples - 1 from [m A] (n, columns) and P, which are those after them in the end. Stops
   after the first sample whose covariance is stationary to `limit`, in standard deviations: that of `target` where the
   mode has one, else the limit of the sequence. `long_after`: samples that begin enough others of their mode.
   Results by sample: predicted (n), nu (n_y), A (n, columns - 1), S, white = L^-1, gain (n, n_y), and unless NULL
   cov, and filter_gain (n + n_w, n_y) and filtered_cov of (x, w). Returns the number of samples done, and -1 - k
   where S or P of sample k has no root. */
long daest_kalman(long n, long n_y, long n_w, long columns, long n_samples, const long long *mode,
                  const long long *long_after, const double *Phi, const double *C, const double *Q,
                  const double *S12, const double *R, const double *Qw, const double *Ne, const double *z,
                  const double *drive, const double *target, const char *has_target, double limit, double *M,
                  double *P, double *predicted, double *nu, double *A, double *S, double *white, double *gain,
                  double *cov, double *filter_gain, double *filtered_cov)
{
    const model_t g = {n_y, n_w, columns, Phi, C, Q, S12, R, Qw, Ne};
    double *work =
        malloc((6 * n * n + 9 * n * n_y + (2 * n + n_y) * columns + 2 * n_y * n_y) * sizeof(double));
    long done = 0;
    if (work == NULL) return 0;
#define RUN(N) run(N, &g, n_samples, mode, long_after, z, drive, target, has_target, limit, M, P, predicted, nu, A, S, \
                   white, gain, cov, filter_gain, filtered_cov, work)
    switch (n) {
#ifdef CONSTANT
    case CONSTANT: done = RUN(CONSTANT); break;
#endif
    default: done = RUN(n);
    }
    free(work);
    return done;
}

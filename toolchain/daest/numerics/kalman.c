/* Time-varying Kalman filter of (47) over many samples, for `numerics/kalman_pass.py`. Matrices are row by row.

   One step, with the covariance P of the prediction and [m A], its mean and sensitivity to an unknown start:
   S = C P C' + R = L L', K = (Phi P C' + S12) S^-1, [m A] <- Phi [m A] + K ([z 0] - C [m A]) + [drive 0], and in
   Joseph form P <- F P F' + Q - K S12' - S12 K' + K R K' with F = Phi - K C. Where S12 = 0 and the outputs tell little
   that P does not know (trace R^-1 S <= MILD), the same goes by way of the covariance after the outputs,
   P <- Phi (P + T Kf' + Kf T') Phi' + Q with Kf = P C' S^-1, T = Kf S / 2 - P C': second order in errors of Kf, too,
   and what rounding leaves is at most MILD times as large. With CONSTANT states the loops have constant lengths; from
   TILES_FROM on products go tile by tile through the registers of the processor. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define ONCE static __attribute__((noinline))
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
#define MILD 1e3

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

/* a' b */
INLINE double dot(long n, const double *a, const double *b)
{
    double sum = 0.0, other = 0.0, third = 0.0, fourth = 0.0;
    long i = 0;
    for (; i + 4 <= n; i += 4) {
        sum += a[i] * b[i];
        other += a[i + 1] * b[i + 1];
        third += a[i + 2] * b[i + 2];
        fourth += a[i + 3] * b[i + 3];
    }
    for (; i < n; i++) sum += a[i] * b[i];
    return sum + other + (third + fourth);
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
typedef long long mask_t __attribute__((vector_size(LANES * 8)));
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

typedef void strip_t(long k, long n, const double *A, long down, long across, const double *B, const double *base,
                     double *out, long from);
#define STRIP(rows)                                                                                               \
    ONCE void strip_##rows(long k, long n, const double *A, long down, long across, const double *B,              \
                           const double *base, double *out, long from)                                            \
    {                                                                                                             \
        strip(rows, k, n, A, down, across, B, base, out, from);                                                   \
    }
STRIP(1)
STRIP(2)
STRIP(3)
STRIP(4)
#if defined(__AVX512F__)
STRIP(8)
#endif
#undef STRIP

/* out = base + A B of A (m, k), B (k, n), from the diagonal on if `upper`. */
ONCE void tiled(long m, long k, long n, const double *A, long down, long across, const double *B, const double *base,
                double *out, int upper)
{
    long rows = TILE_ROWS;
    for (long i = 0; i < m; i += rows) {
        while (rows > m - i && rows > 3) rows /= 2;
        if (rows > m - i || (rows == 2 && m - i == 3)) rows = m - i;
        strip_t *const now = rows == 1 ? strip_1 : rows == 2 ? strip_2 : rows == 3 ? strip_3
#if defined(__AVX512F__)
                             : rows == 8 ? strip_8
#endif
                                         : strip_4;
        now(k, n, A + i * down, down, across, B, base ? base + i * n : NULL, out + i * n, upper ? i : 0);
    }
}

static void tiled_product(long m, long k, long n, const double *A, const double *B, double *out)
{
    tiled(m, k, n, A, k, 1, B, NULL, out, 0);
}

static void tiled_congruence(long n, const double *F, const double *Ft, const double *P, const double *Q, double *out,
                             double *work)
{
    tiled(n, n, n, F, n, 1, P, NULL, work, 0);
    tiled(n, n, n, work, n, 1, Ft, Q, out, 1);
}

static void tiled_outer(long k, long n, const double *A, const double *B, const double *base, double *out, int upper)
{
    tiled(n, k, n, A, 1, n, B, base, out, upper);
}
#define HAS_TILES(n) ((n) >= TILES_FROM)
#else
#define HAS_TILES(n) 0
#define tiled_product product
#define tiled_congruence(n, F, Ft, P, Q, out, work) (void)0
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
    if (HAS_TILES(n)) {
        tiled_congruence(n, F, Ft, P, Q, out, work);
        return;
    }
    product(n, n, n, F, P, work);
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
    for (long j = 0; j < n; j += SIDE) {
        const long end = j + SIDE < n ? j + SIDE : n;
        for (long l = j; l < end; l++)
            for (long i = l + 1; i < end; i++) out[i * apart + l] = A[l * n + i];
        for (long i = end; i < n; i++) /* then SIDE columns are left of the diagonal */
            UNROLLED for (long l = 0; l < SIDE; l++) out[i * apart + j + l] = A[(j + l) * n + i];
    }
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

/* Gain and covariance of (x, w) after the outputs, `estimation.kalman`, of Kt = Kf' (n_y, n) and the covariance of x
   after the outputs (n, n), from the diagonal on if `upper`. */
INLINE void filtered(long n, long n_y, const model_t *g, long mode, const double *Kt, const double *after, int upper,
                     const double *inverse, double *gain, double *cov)
{
    const long n_w = g->n_w, size = n + n_w;
    const double *Ne = g->Ne + mode * n_w * n_y, *Qw = g->Qw + mode * n_w * n_w;
    transposed(n, n_y, Kt, gain);
    product(n_w, n_y, n_y, Ne, inverse, gain + n * n_y);
    if (upper)
        mirrored(n, after, cov, size);
    else
        for (long i = 0; i < n; i++) memcpy(cov + i * size, after + i * n, n * sizeof(double));
    for (long i = 0; i < size; i++)
        for (long j = n; j < size; j++) {
            double sum = i < n ? 0.0 : Qw[(i - n) * n_w + j - n];
            for (long y = 0; y < n_y; y++) sum -= gain[i * n_y + y] * Ne[(j - n) * n_y + y];
            cov[i * size + j] = cov[j * size + i] = sum;
        }
}

/* D, from the diagonal on: the covariance of x after the outputs in Joseph form, (I - K C) P (I - K C)' + K R K', by
   products with K and C alone; PCt = C P, Kt = K' (n_y, n). `work` holds 2 n_y n + n n numbers. */
INLINE void joseph(long n, long n_y, const double *R, const double *P, const double *PCt, const double *S,
                   const double *Kt, double *D, double *work)
{
    double *rest = work, *minus = rest + n_y * n, *other = minus + n_y * n;
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
}

#if defined(__GNUC__)
/* `distance` of n >= LANES: row by row from the diagonal on, the last vector reaching back. */
ONCE double tiled_distance(long n, const double *one, const double *other, double *scale)
{
    lanes_t worst = {0};
    for (long i = 0; i < n; i++) {
        const double *now = one + i * n, *before = other + i * n, own = scale[i];
        for (long j = i; j < n; j += LANES) {
            const long at = j + LANES <= n ? j : n - LANES;
            const lanes_t apart = *(const anywhere_t *)(now + at) - *(const anywhere_t *)(before + at);
            const lanes_t share = own * apart * *(const anywhere_t *)(scale + at) * apart;
            const mask_t larger = share > worst;
            worst = (lanes_t)(((mask_t)share & larger) | ((mask_t)worst & ~larger));
        }
    }
    double largest = 0.0;
    for (int v = 0; v < LANES; v++) largest = worst[v] > largest ? worst[v] : largest;
    return sqrt(largest);
}
#else
#define tiled_distance(n, one, other, scale) 0.0
#endif

/* Largest |one - other| in standard deviations of the larger of both, whose upper triangles are read; `scale` holds n
   numbers. */
INLINE double distance(long n, const double *one, const double *other, double *scale)
{
    double worst = 0.0;
    for (long i = 0; i < n; i++) {
        const double larger = fmax(one[i * n + i], other[i * n + i]);
        scale[i] = larger > 0.0 ? 1.0 / larger : 0.0;
        if (larger > 0.0) continue; /* without any variance: nothing may differ */
        for (long j = i; j < n; j++)
            if (one[i * n + j] != other[i * n + j]) return INFINITY;
        for (long j = 0; j < i; j++)
            if (one[j * n + i] != other[j * n + i]) return INFINITY;
    }
    if (HAS_TILES(n)) return tiled_distance(n, one, other, scale);
    for (long i = 0; i < n; i++)
        for (long j = i; j < n; j++) {
            const double apart = one[i * n + j] - other[i * n + j];
            worst = fmax(worst, scale[i] * apart * scale[j] * apart);
        }
    return sqrt(worst);
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
INLINE long run(const long n, const long n_y, const model_t *g, long n_samples, const long long *mode,
                const char *long_after, const double *z, const double *drive, const double *target,
                const char *has_target, double limit, double *M, double *P, double *predicted, double *nu,
                double *A, double *S, double *white, double *gain, double *nis, double *cov, double *filter_gain,
                double *filtered_cov, double *work)
{
    const long columns = g->columns, size = n + g->n_w;
    double *Phit = work, *after = Phit + n * n, *rest = after + n * n, *F = rest + n * n, *Ft = F + n * n;
    double *spare = Ft + n * n, *PCt = spare + 2 * n_y * n + n * n, *Tt = PCt + n_y * n, *Kt = Tt + n_y * n;
    double *again = Kt + n_y * n, *St = again + n_y * n, *minus = St + n_y * n, *RGt = minus + n_y * n;
    double *now = RGt + n_y * n, *next = now + (n_y + columns) * n, *mean = next + (n_y + columns) * n;
    double *seen = mean + columns * n, *scale = seen + columns * n_y, *L = scale + n, *inverse = L + n_y * n_y;
    double *known = inverse + n_y * n_y, *root = known + n_y * n_y, *Gt = next;
    settling_t settling = {0, 0.0, 0.0};
    const long asked = n_samples;
    long latest = -1;
    int has_cross = 0, is_open = 0;
    transposed(columns, n, M, mean);
    memcpy(cov, P, n * n * sizeof(double));
    for (long k = 0; k < n_samples; k++) {
        const long m = (long)mode[k];
        const double *Phi = g->Phi + m * n * n, *C = g->C + m * n_y * n, *R = g->R + m * n_y * n_y;
        const double *Q = g->Q + m * n * n, *here = cov + k * n * n, *found = after;
        double *Sk = S + k * n_y * n_y, told = 0.0;
        if (m != latest) {
            transposed(n, n, Phi, Phit);
            transposed(n_y, n, g->S12 + m * n * n_y, St);
            has_cross = 0;
            for (long i = 0; i < n * n_y; i++) has_cross |= St[i] != 0.0;
            is_open = !has_cross && !whitening(n_y, R, root, known, L); /* known = R^-1 */
            latest = m;
        }
        times(n_y, n, n, C, here, PCt);
        for (long y = 0; y < n_y; y++)
            for (long v = 0; v < n_y; v++) {
                const double sum = R[y * n_y + v] + dot(n, PCt + y * n, C + v * n);
                Sk[y * n_y + v] = sum;
                told += known[v * n_y + y] * sum;
            }
        if (whitening(n_y, Sk, white + k * n_y * n_y, inverse, L)) return -1 - k;
        times(n_y, n_y, n, inverse, PCt, Kt);
        for (long c = 0; c < columns; c++)
            for (long y = 0; y < n_y; y++) {
                const double sum = dot(n, mean + c * n, C + y * n);
                seen[c * n_y + y] = c ? -sum : z[k * n_y + y] - sum;
            }
        memcpy(nu + k * n_y, seen, n_y * sizeof(double));
        nis[k] = 0.0;
        for (long y = 0; y < n_y; y++) {
            const double one = dot(n_y, white + (k * n_y + y) * n_y, seen);
            nis[k] += one * one;
        }
        memcpy(predicted + k * n, mean, n * sizeof(double));
        if (A) transposed(n, columns - 1, mean + n, A + k * n * (columns - 1));

        if (is_open && told <= MILD) {
            double *held = now + n_y * n; /* mean and sensitivity after the outputs */
            memcpy(now, Kt, n_y * n * sizeof(double));
            times(columns, n_y, n, seen, Kt, held);
            for (long i = 0; i < columns * n; i++) held[i] += mean[i];
            times(n_y + columns, n, n, now, Phit, next);
            memcpy(mean, next + n_y * n, columns * n * sizeof(double));
            times(n_y, n_y, n, Sk, Kt, Tt);
            for (long i = 0; i < n_y * n; i++) Tt[i] = again[i] = 0.5 * Tt[i] - PCt[i];
            plus_outer(2 * n_y, n, 0, Tt, Kt, here, rest); /* [T K] [K T]' */
            filtered(n, n_y, g, m, Kt, rest, 0, inverse, filter_gain + k * size * n_y,
                     filtered_cov + k * size * size);
            congruence(n, Phi, Phit, rest, Q, after, F);
        } else {
            times(n_y, n, n, PCt, Phit, minus);
            for (long i = 0; i < n_y * n; i++) minus[i] += St[i];
            times(n_y, n_y, n, inverse, minus, Gt);
            times(columns, n, n, mean, Phit, now);
            times(columns, n_y, n, seen, Gt, mean);
            for (long i = 0; i < columns * n; i++) mean[i] += now[i];
            joseph(n, n_y, R, here, PCt, Sk, Kt, rest, spare);
            filtered(n, n_y, g, m, Kt, rest, 1, inverse, filter_gain + k * size * n_y,
                     filtered_cov + k * size * size);
            for (long i = 0; i < n_y * n; i++) minus[i] = -Gt[i];
            plus_outer(n_y, n, 0, minus, C, Phi, F);
            plus_outer(n_y, n, 0, C, minus, Phit, Ft);
            congruence(n, F, Ft, here, Q, after, rest);
            times(n_y, n_y, n, R, Gt, RGt);
            for (long i = 0; i < n_y * n; i++) RGt[i] -= St[i]; /* K R K' - K S12' - S12 K' = K (R K' - S12') - S12 K' */
            plus_outer(n_y, n, 1, Gt, RGt, after, rest);
            found = rest;
            if (has_cross) {
                plus_outer(n_y, n, 1, St, minus, rest, after);
                found = after;
            }
        }
        transposed(n, n_y, Gt, gain + k * n * n_y);
        if (drive)
            for (long i = 0; i < n; i++) mean[i] += drive[k * n + i];
        if (!isfinite(found[0])) return -1 - k;

        int is_steady = 0;
        if (k + 1 < n_samples && n_samples == asked && mode[k + 1] == m && long_after[k + 1]) {
            if (has_target[m])
                is_steady = distance(n, found, target + m * n * n, scale) <= limit;
            else
                is_steady = settled(&settling, distance(n, found, here, scale), limit);
        } else {
            settling.count = 0;
            settling.now = settling.before = 0.0;
        }
        if (is_steady) n_samples = k + 2;
        mirrored(n, found, k + 1 < n_samples ? cov + (k + 1) * n * n : P, n);
    }
    transposed(n, columns, mean, M);
    return n_samples;
}

/* The predictor with a constant gain K: x <- F x + K z + drive with F = Phi - K C; x is that after the samples.
   nis = |white nu|^2, and filtered = [x; 0] + G nu of (x, w), with G (size, n_y). */
INLINE void constant(const long n, const long n_y, long size, long n_samples, const double *F, const double *K,
                     const double *C, const double *white, const double *G, const double *z, const double *drive,
                     double *restrict x, double *restrict predicted, double *restrict nu, double *restrict nis,
                     double *restrict filtered)
{
    for (long k = 0; k < n_samples; k++) {
        double *now = predicted + k * n, *error = nu + k * n_y, *after = filtered + k * size;
        for (long i = 0; i < n; i++) now[i] = x[i];
        for (long y = 0; y < n_y; y++) {
            double sum = z[k * n_y + y];
            for (long i = 0; i < n; i++) sum -= C[y * n + i] * now[i];
            error[y] = sum;
        }
        double squares = 0.0;
        for (long y = 0; y < n_y; y++) {
            double sum = 0.0;
            for (long v = 0; v <= y; v++) sum += white[y * n_y + v] * error[v];
            squares += sum * sum;
        }
        nis[k] = squares;
        for (long i = 0; i < size; i++) {
            double sum = i < n ? now[i] : 0.0;
            for (long y = 0; y < n_y; y++) sum += G[i * n_y + y] * error[y];
            after[i] = sum;
        }
        for (long i = 0; i < n; i++) {
            double sum = drive ? drive[k * n + i] : 0.0;
            for (long j = 0; j < n; j++) sum += F[i * n + j] * now[j];
            for (long y = 0; y < n_y; y++) sum += K[i * n_y + y] * z[k * n_y + y];
            x[i] = sum;
        }
    }
}

void daest_constant(long n, long n_y, long size, long n_samples, const double *F, const double *K, const double *C,
                    const double *white, const double *G, const double *z, const double *drive, double *x,
                    double *predicted, double *nu, double *nis, double *filtered)
{
#define CONSTANT_GAIN(N, Y) \
    constant(N, Y, size, n_samples, F, K, C, white, G, z, drive, x, predicted, nu, nis, filtered)
#ifdef CONSTANT
    if (n == CONSTANT && n_y == 1) { CONSTANT_GAIN(CONSTANT, 1); return; }
    if (n == CONSTANT && n_y == 2) { CONSTANT_GAIN(CONSTANT, 2); return; }
#endif
    CONSTANT_GAIN(n, n_y);
}

/* Filter samples 0 … n_samples - 1 from [m A] (n, columns) and P, which are those after them in the end. Stops
   after the first sample whose covariance is stationary to `limit`, in standard deviations: that of `target` where the
   mode has one, else the limit of the sequence. `long_after`: samples that begin enough others of their mode.
   Results by sample: predicted (n), nu (n_y), A (n, columns - 1) unless NULL, S, white = L^-1, gain (n, n_y),
   nis = nu' S^-1 nu, cov, and filter_gain (n + n_w, n_y) and filtered_cov of (x, w). Returns the number of samples
   done, and -1 - k where S or P of sample k has no root. */
long daest_kalman(long n, long n_y, long n_w, long columns, long n_samples, const long long *mode,
                  const char *long_after, const double *Phi, const double *C, const double *Q,
                  const double *S12, const double *R, const double *Qw, const double *Ne, const double *z,
                  const double *drive, const double *target, const char *has_target, double limit,
                  double *M, double *P, double *predicted, double *nu, double *A, double *S, double *white,
                  double *gain, double *nis, double *cov, double *filter_gain, double *filtered_cov)
{
    const model_t g = {n_y, n_w, columns, Phi, C, Q, S12, R, Qw, Ne};
    const long rows = 11 * n_y + 3 * columns + 1;
    double *work = calloc(6 * n * n + rows * n + (columns + 4 * n_y) * n_y, sizeof(double));
    long done = 0;
    if (work == NULL) return 0;
#define RUN(N, Y)                                                                                                 \
    done = run(N, Y, &g, n_samples, mode, long_after, z, drive, target, has_target, limit, M, P, predicted, nu, A, \
               S, white, gain, nis, cov, filter_gain, filtered_cov, work)
#ifdef CONSTANT
    if (n == CONSTANT && n_y == 1) RUN(CONSTANT, 1);
    else if (n == CONSTANT && n_y == 2) RUN(CONSTANT, 2);
    else
#endif
        RUN(n, n_y);
    free(work);
    return done;
}

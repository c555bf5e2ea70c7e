/* The Kalman filter of a linear model for any steps, missing outputs and an unknown start.
 *
 * The unknown part delta of the first state is carried along: the state is m + sens delta, the innovation
 * nu - slope delta. As soon as the outputs determine delta well, its estimate and covariance are put into mean and
 * cov, and from there the recursion is the ordinary one. The model is sampled exactly over every step, by series
 * over a short step and doublings.
 */
#include "estimator.h"

#include <math.h>
#include <string.h>

#ifdef ESTIMATOR_FLOAT
#define R_(x) x##f
#define SQRT sqrtf
#define FABS fabsf
#define LOG logf
static const est_real RANK = 1e-5f; /* of the regression on delta, relative to its largest singular value */
static const est_real FREE = 1e-4f;
static const est_real SAME_STEP = 1e-6f; /* steps that differ by less than this part share a sampled model */
#else
#define R_(x) x
#define SQRT sqrt
#define FABS fabs
#define LOG log
static const est_real RANK = 1e-9;
static const est_real FREE = 1e-8; /* part of its scale by which an open quantity moves */
static const est_real SAME_STEP = 5e-9;
#endif

enum { NX = EST_NX, NU = EST_NU, NUB = EST_NUB, NW = EST_NW, NY = EST_NY, NV = EST_NV, NQ = EST_NQ, NP = EST_NP };
enum { NZ = NX + NW, ORDER = 12, MOST_DOUBLINGS = 60, SWEEPS = 40 };
static const est_real RADIUS = R_(0.25);
static const est_real WELL_CONDITIONED = R_(1e3);
static const est_real LOG_2PI = R_(1.8378770664093454836);

/* c (n x p) = a (n x m) b (m x p) */
static void times(const est_real *a, const est_real *b, int n, int m, int p, est_real *c) {
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < p; ++j) {
            est_real sum = 0;
            for (int k = 0; k < m; ++k) sum += a[i * m + k] * b[k * p + j];
            c[i * p + j] = sum;
        }
}

/* c (n x p) = a (n x m) b' with b (p x m) */
static void times_t(const est_real *a, const est_real *b, int n, int m, int p, est_real *c) {
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < p; ++j) {
            est_real sum = 0;
            for (int k = 0; k < m; ++k) sum += a[i * m + k] * b[j * m + k];
            c[i * p + j] = sum;
        }
}

static void symmetric(est_real *a, int n) {
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < i; ++j) a[i * n + j] = a[j * n + i] = R_(0.5) * (a[i * n + j] + a[j * n + i]);
}

/* ------------------------------------------------------------------------------------------------ sampling */

/* Phi, first = int Phi, second = int int Phi, Q = int Phi W Phi' over the step h, for A and W. */
static int integrals(const est_real *A, const est_real *W, est_real h, est_real *Phi, est_real *first,
                     est_real *second, est_real *Q) {
    est_real size = 0, term[EST_ARRAY(EST_NX * EST_NX)], half[EST_ARRAY(EST_NX * EST_NX)];
    est_real wterm[EST_ARRAY(EST_NX * EST_NX)];
    int doublings = 0;
    for (int i = 0; i < NX; ++i) {
        est_real row = 0, column = 0;
        for (int j = 0; j < NX; ++j) row += FABS(A[i * NX + j]), column += FABS(A[j * NX + i]);
        size = row > size ? row : size;
        size = column > size ? column : size;
    }
    if (!(size * h < R_(1e30))) return EST_NOT_FINITE;
    while (size * h > RADIUS && doublings < MOST_DOUBLINGS) h *= R_(0.5), ++doublings;
    memset(term, 0, sizeof term);
    for (int i = 0; i < NX; ++i) term[i * NX + i] = 1;
    for (int i = 0; i < NX * NX; ++i) {
        Phi[i] = term[i];
        first[i] = h * term[i];
        second[i] = R_(0.5) * h * h * term[i];
        wterm[i] = Q[i] = h * W[i];
    }
    for (int k = 1; k <= ORDER; ++k) {
        times(A, term, NX, NX, NX, half);
        for (int i = 0; i < NX * NX; ++i) {
            term[i] = half[i] * h / (est_real)k;
            Phi[i] += term[i];
            first[i] += term[i] * h / (est_real)(k + 1);
            second[i] += term[i] * h * h / (est_real)((k + 1) * (k + 2));
        }
        times(A, wterm, NX, NX, NX, half);
        for (int i = 0; i < NX; ++i)
            for (int j = 0; j < NX; ++j) {
                wterm[i * NX + j] = (half[i * NX + j] + half[j * NX + i]) * h / (est_real)(k + 1);
                Q[i * NX + j] += wterm[i * NX + j];
            }
    }
    for (int d = 0; d < doublings; ++d, h *= 2) {
        times(Phi, second, NX, NX, NX, half);
        for (int i = 0; i < NX * NX; ++i) second[i] += h * first[i] + half[i];
        times(Phi, first, NX, NX, NX, half);
        for (int i = 0; i < NX * NX; ++i) first[i] += half[i];
        times(Phi, Q, NX, NX, NX, half);
        times_t(half, Phi, NX, NX, NX, wterm);
        for (int i = 0; i < NX * NX; ++i) Q[i] += wterm[i];
        symmetric(Q, NX);
        times(Phi, Phi, NX, NX, NX, half);
        memcpy(Phi, half, sizeof half);
    }
    return EST_OK;
}

/* W = a diag(q) b' with a (n x NW), b (m x NW) */
static void weighted(const est_real *a, const est_real *q, est_real scale, const est_real *b, int n, int m, est_real *W) {
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < m; ++j) {
            est_real sum = 0;
            for (int k = 0; k < NW; ++k) sum += a[i * NW + k] * q[k] * scale * b[j * NW + k];
            W[i * m + j] = sum;
        }
}

/* The model over a step; e->s keeps it while steps and knobs stay. */
static int sampled(Estimator *e, est_real h) {
    static const int sources[EST_ARRAY(EST_NUB - EST_NU)] = EST_SLOPES;
    static const unsigned char kept[EST_ARRAY(EST_NU)] = EST_KEPT; /* inputs that keep their value over a step */
    EstSampled *s = &e->s;
    EstMatrices *m = &e->m;
    est_real W[EST_ARRAY(EST_NX * EST_NX)], first[EST_ARRAY(EST_NX * EST_NX)], second[EST_ARRAY(EST_NX * EST_NX)];
    est_real ramp[EST_ARRAY(EST_NX * EST_NUB)], held[EST_ARRAY(EST_NX * EST_NW)];
    if (s->is_known && FABS(s->step - h) <= SAME_STEP * h) return EST_OK;
    s->is_known = 0;
    weighted(m->G, e->intensity, 1, m->G, NX, NX, W);
    if (integrals(m->A, W, h, s->Phi, first, second, s->Q)) return EST_NOT_FINITE;
    times(first, m->B, NX, NX, NUB, s->now);
    memset(s->next, 0, sizeof s->next);
    if (EST_FOH) {
        times(second, m->B, NX, NX, NUB, ramp);
        for (int i = 0; i < NX; ++i) {
            for (int j = 0; j < NUB; ++j) {
                const est_real whole = s->now[i * NUB + j], part = ramp[i * NUB + j] / h;
                if (j < NU) {
                    if (kept[j]) continue;
                    s->now[i * NUB + j] = whole - part;
                    s->next[i * NUB + j] = part;
                } else { /* the slope of an input over the whole step */
                    const int source = sources[j - NU];
                    s->now[i * NUB + source] -= whole / h;
                    s->next[i * NUB + source] += whole / h;
                    s->now[i * NUB + j] = 0;
                }
            }
        }
    }
    times(first, m->b, NX, NX, 1, s->drift);
    memset(s->S12, 0, sizeof s->S12);
    memset(s->N, 0, sizeof s->N);
    memset(s->R, 0, sizeof s->R);
    for (int k = 0; k < NW; ++k) s->noise[k] = e->intensity[k] / h;
    if (EST_HELD) { /* white noise reaches an output: it is held over the step */
        times(first, m->G, NX, NX, NW, held);
        weighted(held, e->intensity, 1 / h, held, NX, NX, s->Q);
        weighted(m->H, e->intensity, 1 / h, m->H, NY, NY, s->R);
        weighted(held, e->intensity, 1 / h, m->H, NX, NY, s->S12);
        for (int k = 0; k < NW; ++k)
            for (int j = 0; j < NY; ++j) s->N[k * NY + j] = s->noise[k] * m->H[j * NW + k];
    }
    for (int j = 0; j < NY; ++j) s->R[j * NY + j] += e->noise_std[j] * e->noise_std[j];
    s->step = h;
    s->is_known = 1;
    return EST_OK;
}

/* --------------------------------------------------------------------------------------- the unknown start */

/* The columns w of R V are orthogonal (one-sided Jacobi): R = W V', W = (w_1 ...) with |w_i| = size[i]. */
static void decomposed(const est_real *root, int p, est_real *W, est_real *V, est_real *size) {
    for (int i = 0; i < p; ++i)
        for (int j = 0; j < p; ++j) W[i * p + j] = root[i * (p + 1) + j], V[i * p + j] = i == j;
    for (int sweep = 0; NP > 1 && sweep < SWEEPS; ++sweep) {
        int rotated = 0;
        for (int a = 0; a < p; ++a)
            for (int b = a + 1; b < p; ++b) {
                est_real aa = 0, bb = 0, ab = 0;
                for (int i = 0; i < p; ++i) {
                    aa += W[i * p + a] * W[i * p + a];
                    bb += W[i * p + b] * W[i * p + b];
                    ab += W[i * p + a] * W[i * p + b];
                }
                if (!(FABS(ab) > R_(1e-16) * SQRT(aa * bb))) continue;
                rotated = 1;
                const est_real zeta = (bb - aa) / (2 * ab);
                const est_real t = (zeta >= 0 ? 1 : -1) / (FABS(zeta) + SQRT(1 + zeta * zeta));
                const est_real c = 1 / SQRT(1 + t * t), s = c * t;
                for (int i = 0; i < p; ++i) {
                    const est_real wa = W[i * p + a], va = V[i * p + a];
                    W[i * p + a] = c * wa - s * W[i * p + b];
                    W[i * p + b] = s * wa + c * W[i * p + b];
                    V[i * p + a] = c * va - s * V[i * p + b];
                    V[i * p + b] = s * va + c * V[i * p + b];
                }
            }
        if (!rotated) break;
    }
    for (int a = 0; a < p; ++a) {
        size[a] = 0;
        for (int i = 0; i < p; ++i) size[a] += W[i * p + a] * W[i * p + a];
        size[a] = SQRT(size[a]);
    }
}

/* What the information root (p x (p + 1)) says of the q = p + open parts of delta: mean (q), factor (q x q) of
 * the covariance, free directions (q x q). Returns whether all p parts are determined, 2 if well. */
static int known_start(const est_real *root, int p, int q, est_real *mean, est_real *factor, est_real *free) {
    est_real W[EST_ARRAY(EST_NP * EST_NP)], V[EST_ARRAY(EST_NP * EST_NP)], size[EST_ARRAY(EST_NP)];
    est_real largest = 0, smallest = 0;
    int all = 1;
    memset(mean, 0, sizeof(est_real) * (size_t)EST_ARRAY(EST_NQ));
    memset(factor, 0, sizeof(est_real) * (size_t)EST_ARRAY(EST_NQ * EST_NQ));
    memset(free, 0, sizeof(est_real) * (size_t)EST_ARRAY(EST_NQ * EST_NQ));
    for (int i = p; i < q; ++i) free[i * q + i] = 1;
    if (p == 0) return 2;
    decomposed(root, p, W, V, size);
    for (int a = 0; a < p; ++a) {
        largest = size[a] > largest ? size[a] : largest;
        smallest = a == 0 || size[a] < smallest ? size[a] : smallest;
    }
    for (int a = 0; a < p; ++a) {
        if (size[a] > RANK * largest) {
            est_real along = 0;
            for (int i = 0; i < p; ++i) along += W[i * p + a] * root[i * (p + 1) + p];
            along /= size[a] * size[a];
            for (int i = 0; i < p; ++i) {
                mean[i] += V[i * p + a] * along;
                factor[i * q + a] = V[i * p + a] / size[a];
            }
        } else {
            all = 0;
            for (int i = 0; i < p; ++i) free[i * q + a] = V[i * p + a];
        }
    }
    return all ? (largest <= WELL_CONDITIONED * smallest ? 2 : 1) : 0;
}

/* log of the integral of the likelihood over delta; NaN while delta is not determined. */
static est_real evidence(const est_real *root, int p, int is_known) {
    est_real sum = R_(0.5) * (est_real)p * LOG_2PI;
    if (p == 0) return 0;
    if (!is_known) return (est_real)NAN;
    for (int i = 0; i < p; ++i) {
        const est_real r = root[i * (p + 1) + p];
        sum += R_(0.5) * r * r - LOG(FABS(root[i * (p + 1) + i]));
    }
    return sum;
}

/* One more row of the regression, by Givens rotations. */
static void add_row(est_real *root, int p, est_real *row) {
    for (int j = 0; j < p; ++j) {
        est_real *own = root + j * (p + 1);
        const est_real length = SQRT(own[j] * own[j] + row[j] * row[j]);
        if (!(length > 0)) continue;
        const est_real c = own[j] / length, s = row[j] / length;
        for (int k = j; k <= p; ++k) {
            const est_real old = own[k];
            own[k] = c * old + s * row[k];
            row[k] = c * row[k] - s * old;
        }
    }
}

/* ---------------------------------------------------------------------------------------------- one sample */

/* white = L^-1 for S = L L'. Returns 0 where S is not positive. */
static int whitening(const est_real *S, est_real *white) {
    est_real L[EST_ARRAY(EST_NY * EST_NY)];
    memset(white, 0, sizeof L);
    for (int i = 0; i < NY; ++i)
        for (int j = 0; j <= i; ++j) {
            est_real sum = S[i * NY + j];
            for (int k = 0; k < j; ++k) sum -= L[i * NY + k] * L[j * NY + k];
            if (i > j)
                L[i * NY + j] = sum / L[j * NY + j];
            else if (sum > 0 && sum < (est_real)HUGE_VAL)
                L[i * NY + i] = SQRT(sum);
            else
                return 0;
        }
    for (int j = 0; j < NY; ++j)
        for (int i = j; i < NY; ++i) {
            est_real sum = i == j;
            for (int k = j; k < i; ++k) sum -= L[i * NY + k] * white[k * NY + j];
            white[i * NY + j] = sum / L[i * NY + i];
        }
    return 1;
}

static void masked(const est_real *R, const int *valid, est_real *out) {
    for (int i = 0; i < NY; ++i)
        for (int j = 0; j < NY; ++j) out[i * NY + j] = valid[i] && valid[j] ? R[i * NY + j] : (est_real)(i == j && !valid[i]);
}

/* e->up for the outputs of the last sample. */
static int update(Estimator *e) {
    EstUpdate *up = &e->up;
    const EstMatrices *m = &e->m;
    const int p = NP > 0 ? e->n_known : 0, q = NQ > 0 ? p + e->n_open : 0;
    est_real R[EST_ARRAY(EST_NY * EST_NY)], S[EST_ARRAY(EST_NY * EST_NY)], PC[EST_ARRAY(EST_NX * EST_NY)];
    est_real row[EST_NP + 1];
    int n_valid = 0;
    for (int j = 0; j < NY; ++j) {
        est_real known = m->d[j];
        n_valid += e->valid[j] != 0;
        for (int i = 0; i < NX; ++i) {
            known += m->C[j * NX + i] * e->mean[i];
            up->C[j * NX + i] = e->valid[j] ? m->C[j * NX + i] : 0;
        }
        for (int i = 0; i < NUB; ++i) known += m->D[j * NUB + i] * e->ubar[i];
        up->innovation[j] = e->valid[j] ? e->y[j] - known : 0;
    }
    masked(e->s.R, e->valid, R);
    times_t(e->cov, up->C, NX, NX, NY, PC);
    times(up->C, PC, NY, NX, NY, S);
    for (int i = 0; i < NY * NY; ++i) S[i] += R[i];
    if (!whitening(S, up->white)) return EST_SINGULAR;
    times(up->C, e->sens, NY, NX, q, up->slope);
    memcpy(up->root, e->root, sizeof up->root);
    up->log_density = R_(-0.5) * (est_real)n_valid * LOG_2PI;
    for (int i = 0; i < NY; ++i) {
        est_real z = 0;
        memset(row, 0, sizeof row);
        for (int k = 0; k <= i; ++k) {
            z += up->white[i * NY + k] * up->innovation[k];
            for (int a = 0; a < p; ++a) row[a] += up->white[i * NY + k] * up->slope[k * q + a];
        }
        up->log_density += LOG(up->white[i * NY + i]) - R_(0.5) * z * z;
        row[p] = z;
        add_row(up->root, p, row);
    }
    return EST_OK;
}

/* From the last sample to the next one, a step of e->s later, with the inputs there. */
static void predict(Estimator *e, const est_real *u) {
    const EstSampled *s = &e->s;
    const EstUpdate *up = &e->up;
    const int p = NP > 0 ? e->n_known : 0, q = NQ > 0 ? p + e->n_open : 0;
    est_real PC[EST_ARRAY(EST_NX * EST_NY)], reach[EST_ARRAY(EST_NX * EST_NY)], gain[EST_ARRAY(EST_NX * EST_NY)];
    est_real half[EST_ARRAY(EST_NX * EST_NX)], closed[EST_ARRAY(EST_NX * EST_NX)], R[EST_ARRAY(EST_NY * EST_NY)];
    est_real P[EST_ARRAY(EST_NX * EST_NX)], KR[EST_ARRAY(EST_NX * EST_NY)], KS[EST_ARRAY(EST_NX * EST_NX)];
    est_real S12[EST_ARRAY(EST_NX * EST_NY)], mean[EST_ARRAY(EST_NX)], sens[EST_ARRAY(EST_NX * EST_NQ)] = {0};
    times_t(e->cov, up->C, NX, NX, NY, PC);
    times(s->Phi, PC, NX, NX, NY, reach);
    for (int i = 0; i < NX; ++i)
        for (int j = 0; j < NY; ++j) {
            S12[i * NY + j] = e->valid[j] ? s->S12[i * NY + j] : 0;
            reach[i * NY + j] += S12[i * NY + j];
        }
    times_t(reach, up->white, NX, NY, NY, KR);
    times(KR, up->white, NX, NY, NY, gain);
    times(gain, up->C, NX, NY, NX, closed);
    for (int i = 0; i < NX * NX; ++i) closed[i] = s->Phi[i] - closed[i];
    masked(s->R, e->valid, R);
    times(closed, e->cov, NX, NX, NX, half);
    times_t(half, closed, NX, NX, NX, P);
    times(gain, R, NX, NY, NY, KR);
    times_t(KR, gain, NX, NY, NX, half);
    times_t(gain, S12, NX, NY, NX, KS);
    for (int i = 0; i < NX; ++i)
        for (int j = 0; j < NX; ++j)
            P[i * NX + j] += s->Q[i * NX + j] + half[i * NX + j] - KS[i * NX + j] - KS[j * NX + i];
    for (int i = 0; i < NX; ++i) {
        mean[i] = s->drift[i];
        for (int j = 0; j < NX; ++j) mean[i] += s->Phi[i * NX + j] * e->mean[j];
        for (int j = 0; j < NUB; ++j) mean[i] += s->now[i * NUB + j] * e->ubar[j];
        for (int j = 0; j < NU; ++j) mean[i] += s->next[i * NUB + j] * u[j];
        for (int j = 0; j < NY; ++j) mean[i] += gain[i * NY + j] * up->innovation[j];
        for (int a = 0; a < q; ++a) {
            sens[i * q + a] = 0;
            for (int j = 0; j < NX; ++j) sens[i * q + a] += s->Phi[i * NX + j] * e->sens[j * q + a];
            for (int j = 0; j < NY; ++j) sens[i * q + a] -= gain[i * NY + j] * up->slope[j * q + a];
        }
    }
    memcpy(e->cov, P, sizeof e->cov);
    symmetric(e->cov, NX);
    memcpy(e->mean, mean, sizeof e->mean);
    memcpy(e->sens, sens, sizeof e->sens);
    memcpy(e->root, up->root, sizeof e->root);
    e->log_density += up->log_density;
}

/* A well-determined delta goes into mean and cov. */
static void collapse(Estimator *e) {
    est_real delta[EST_ARRAY(EST_NQ)], factor[EST_ARRAY(EST_NQ * EST_NQ)], free[EST_ARRAY(EST_NQ * EST_NQ)];
    est_real spread[EST_ARRAY(EST_NX * EST_NQ)], more[EST_ARRAY(EST_NX * EST_NX)];
    const int p = e->n_known, open = e->n_open, q = p + open;
    if (p == 0 || known_start(e->root, p, q, delta, factor, free) < 2) return;
    times(e->sens, factor, NX, q, q, spread);
    times_t(spread, spread, NX, q, NX, more);
    for (int i = 0; i < NX * NX; ++i) e->cov[i] += more[i];
    for (int i = 0; i < NX; ++i)
        for (int a = 0; a < p; ++a) e->mean[i] += e->sens[i * q + a] * delta[a];
    for (int i = 0; i < NX; ++i)
        for (int a = 0; a < open; ++a) e->sens[i * open + a] = e->sens[i * q + p + a];
    e->log_density += evidence(e->root, p, 1);
    e->n_known = 0;
}

/* Innovations given what the past says of delta; how many of them there are. */
static void innovations(Estimator *e) {
    const EstUpdate *up = &e->up;
    const int p = NP > 0 ? e->n_known : 0, q = NQ > 0 ? p + e->n_open : 0;
    est_real delta[EST_ARRAY(EST_NQ)], factor[EST_ARRAY(EST_NQ * EST_NQ)], free[EST_ARRAY(EST_NQ * EST_NQ)];
    est_real spread[EST_ARRAY(EST_NY * EST_NQ)], S[EST_ARRAY(EST_NY * EST_NY)], PC[EST_ARRAY(EST_NX * EST_NY)];
    est_real R[EST_ARRAY(EST_NY * EST_NY)], white[EST_ARRAY(EST_NY * EST_NY)], more[EST_ARRAY(EST_NY * EST_NY)];
    int dof = 0, hidden = 0;
    known_start(e->root, p, q, delta, factor, free);
    times(up->slope, factor, NY, q, q, spread);
    masked(e->s.R, e->valid, R);
    times_t(e->cov, up->C, NX, NX, NY, PC);
    times(up->C, PC, NY, NX, NY, S);
    times_t(spread, spread, NY, q, NY, more);
    for (int i = 0; i < NY * NY; ++i) S[i] += R[i] + more[i];
    for (int j = 0; j < NY; ++j) {
        est_real along = 0, scale = 0;
        for (int a = 0; a < q; ++a) {
            est_real seen = 0;
            for (int k = 0; k < q; ++k) seen += up->slope[j * q + k] * free[k * q + a];
            along += seen * seen;
        }
        for (int i = 0; i < NX; ++i) scale += FABS(up->C[j * NX + i]) * estimator_scale[i];
        const int is_open = SQRT(along) > FREE * scale;
        e->innovation[j] = up->innovation[j];
        for (int a = 0; a < q; ++a) e->innovation[j] -= up->slope[j * q + a] * delta[a];
        dof += e->valid[j] != 0;
        hidden += is_open;
        S[j * NY + j] += (est_real)is_open; /* keeps S positive; nothing is told then */
        if (is_open || !e->valid[j]) e->innovation[j] = (est_real)NAN;
    }
    e->nis_dof = hidden ? 0 : dof;
    e->nis = (est_real)NAN;
    if (e->nis_dof == 0 || !whitening(S, white)) return;
    e->nis = 0;
    for (int i = 0; i < NY; ++i) {
        est_real z = 0;
        for (int k = 0; k <= i; ++k) z += e->valid[k] ? white[i * NY + k] * e->innovation[k] : 0;
        e->nis += e->valid[i] ? z * z : 0;
    }
}

/* Values and standard deviations of the internal variables after the outputs of the last sample. */
static void tell(Estimator *e) {
    const EstUpdate *up = &e->up;
    const EstSampled *s = &e->s;
    const EstMatrices *m = &e->m;
    const int p = NP > 0 ? e->n_known : 0, q = NQ > 0 ? p + e->n_open : 0;
    est_real reach[EST_ARRAY((EST_NX + EST_NW) * EST_NY)], half[EST_ARRAY((EST_NX + EST_NW) * EST_NY)];
    est_real mean[EST_ARRAY(EST_NX + EST_NW)], load[EST_ARRAY((EST_NX + EST_NW) * EST_NQ)];
    est_real delta[EST_ARRAY(EST_NQ)], factor[EST_ARRAY(EST_NQ * EST_NQ)], free[EST_ARRAY(EST_NQ * EST_NQ)];
    const int is_known = known_start(up->root, p, q, delta, factor, free);
    times_t(e->cov, up->C, NX, NX, NY, reach);
    for (int k = 0; k < NW; ++k)
        for (int j = 0; j < NY; ++j) reach[(NX + k) * NY + j] = e->valid[j] ? s->N[k * NY + j] : 0;
    times_t(reach, up->white, NZ, NY, NY, half); /* gain = half white, covariance = prior - half half' */
    for (int i = 0; i < NZ; ++i) {
        mean[i] = i < NX ? e->mean[i] : 0;
        for (int a = 0; a < q; ++a) load[i * q + a] = i < NX ? e->sens[i * q + a] : 0;
        for (int j = 0; j < NY; ++j) {
            est_real gain = 0;
            for (int k = j; k < NY; ++k) gain += half[i * NY + k] * up->white[k * NY + j];
            mean[i] += gain * up->innovation[j];
            for (int a = 0; a < q; ++a) load[i * q + a] -= gain * up->slope[j * q + a];
        }
        for (int a = 0; a < q; ++a) mean[i] += load[i * q + a] * delta[a];
    }
    for (int v = 0; v < NV; ++v) {
        const est_real *row = m->V + v * (NZ + NUB + 1);
        est_real value = row[NZ + NUB], variance = 0, open = 0, scale = 0;
        for (int i = 0; i < NZ; ++i) {
            est_real along = 0;
            value += row[i] * mean[i];
            if (i < NX) {
                for (int j = 0; j < NX; ++j) along += e->cov[i * NX + j] * row[j];
                scale += FABS(row[i]) * estimator_scale[i];
            } else {
                along = s->noise[i - NX] * row[i];
                scale += FABS(row[i]) * SQRT(s->noise[i - NX]);
            }
            variance += row[i] * along;
        }
        for (int j = 0; j < NY; ++j) {
            est_real along = 0;
            for (int i = 0; i < NZ; ++i) along += row[i] * half[i * NY + j];
            variance -= along * along;
        }
        for (int a = 0; a < q; ++a) {
            est_real spread = 0, seen = 0;
            for (int k = 0; k < q; ++k) {
                est_real along = 0;
                for (int i = 0; i < NZ; ++i) along += row[i] * load[i * q + k];
                spread += along * factor[k * q + a];
                seen += along * free[k * q + a];
            }
            variance += spread * spread;
            open += seen * seen;
        }
        for (int i = 0; i < NUB; ++i) value += row[NZ + i] * e->ubar[i];
        const int is_open = SQRT(open) > FREE * scale;
        e->value[v] = is_open ? (est_real)NAN : value;
        e->std[v] = is_open ? (est_real)INFINITY : SQRT(variance > 0 ? variance : 0);
    }
    e->log_likelihood = e->log_density + up->log_density + evidence(up->root, p, is_known);
    innovations(e);
}

int estimator_step(Estimator *e, double time, const est_real *u, const est_real *y, const int *valid) {
    static const int sources[EST_ARRAY(EST_NUB - EST_NU)] = EST_SLOPES;
    const est_real step = e->has_sample ? (est_real)(time - e->time) : e->period;
    if (!(step > 0 && step < (est_real)HUGE_VAL)) return EST_BAD_TIME;
    if (sampled(e, step)) return EST_NOT_FINITE;
    if (e->has_sample) {
        if (EST_HELD && update(e)) return EST_SINGULAR;
        predict(e, u);
        collapse(e);
    }
    for (int j = 0; j < NUB - NU; ++j)
        e->ubar[NU + j] = e->has_sample ? (u[sources[j]] - e->ubar[sources[j]]) / step : 0;
    for (int j = 0; j < NU; ++j) e->ubar[j] = u[j];
    for (int j = 0; j < NY; ++j) {
        e->valid[j] = valid[j] != 0 && isfinite(y[j]);
        e->y[j] = e->valid[j] ? y[j] : 0;
    }
    e->time = time;
    e->step = step;
    e->has_sample = 1;
    if (update(e)) return EST_SINGULAR;
    tell(e);
    return EST_OK;
}

int estimator_tuned(Estimator *e) {
    e->s.is_known = 0;
    return estimator_matrices(e->theta, &e->m);
}

void estimator_init(Estimator *e) {
    memset(e, 0, sizeof *e);
    estimator_start(e);
    (void)estimator_tuned(e);
}

void estimator_set_state(Estimator *e, const est_real *mean, const est_real *cov) {
    memcpy(e->mean, mean, sizeof(est_real) * (size_t)NX);
    memcpy(e->cov, cov, sizeof(est_real) * (size_t)(NX * NX));
    e->n_known = e->n_open = 0;
    e->log_density = 0;
}

/* Diagonal entries of the inverse of a sparse matrix, for `numerics/selected_inverse.py`. Indices are of 32 bits, a
   matrix is given by columns, each with its rows in increasing order.

   A = L U without pivoting, L with a unit diagonal; rows and columns are in the order of a factorisation that needed
   none. With Z = A^-1 and U = D V, Z = D^-1 L^-1 + (I - V) Z = V^-1 D^-1 + Z (I - L), so that the entries of Z at the
   places of (L + U)' follow from each other from the last column to the first (A. Erisman & W. Tinney, On computing
   certain elements of the inverse of a sparse matrix, Comm. ACM 18, 1975). */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef int32_t index_t;

typedef struct {
    int64_t *start;     /* of every column (of L) or row (of U), n + 1 */
    index_t *place;     /* rows (of L) or columns (of U), increasing, the diagonal left out */
    double *value, *z;  /* entries, and those of Z at the transposed places */
    int64_t room;
} part_t;

static int grown(part_t *part, int64_t needed)
{
    if (needed <= part->room) return 1;
    int64_t room = 2 * needed;
    index_t *place = realloc(part->place, room * sizeof *place);
    if (place) part->place = place;
    double *value = realloc(part->value, room * sizeof *value);
    if (value) part->value = value;
    if (!place || !value) return 0;
    part->room = room;
    return 1;
}

static int by_size(const void *a, const void *b)
{
    const index_t left = *(const index_t *)a, right = *(const index_t *)b;
    return (left > right) - (left < right);
}

/* The rows that column j of A reaches through the columns of L before it, in increasing order; their number. */
static index_t reach(const part_t *L, index_t j, const index_t *rows, index_t n_rows, index_t *mark, index_t *found,
                     index_t *stack)
{
    index_t count = 0, height = 0;
    for (index_t r = 0; r < n_rows; r++) {
        if (mark[rows[r]] == j) continue;
        mark[rows[r]] = j;
        stack[height++] = rows[r];
        while (height) {
            const index_t i = stack[--height];
            found[count++] = i;
            if (i >= j) continue;
            for (int64_t p = L->start[i]; p < L->start[i + 1]; p++)
                if (mark[L->place[p]] != j) {
                    mark[L->place[p]] = j;
                    stack[height++] = L->place[p];
                }
        }
    }
    qsort(found, count, sizeof *found, by_size);
    return count;
}

/* L and U by columns, and the diagonal d of U. 0: done, 1: a pivot is zero, 2: more than `most` entries or no room. */
static int factorise(index_t n, const int64_t *start, const index_t *place, const double *value, int64_t most,
                     part_t *L, part_t *U, double *d, double *x, index_t *mark, index_t *found, index_t *stack)
{
    for (index_t j = 0; j < n; j++) mark[j] = -1;
    L->start[0] = U->start[0] = 0;
    for (index_t j = 0; j < n; j++) {
        const index_t *rows = place + start[j], n_rows = (index_t)(start[j + 1] - start[j]);
        const index_t count = reach(L, j, rows, n_rows, mark, found, stack);
        int64_t l = L->start[j], u = U->start[j];
        if (l + u + count > most || !grown(L, l + count) || !grown(U, u + count)) return 2;
        for (index_t k = 0; k < count; k++) x[found[k]] = 0.0;
        for (index_t r = 0; r < n_rows; r++) x[rows[r]] = value[start[j] + r];
        d[j] = 0.0;
        for (index_t k = 0; k < count; k++) {
            const index_t i = found[k];
            const double xi = x[i];
            if (i < j) {
                U->place[u] = i, U->value[u++] = xi;
                if (xi != 0.0)
                    for (int64_t p = L->start[i]; p < L->start[i + 1]; p++) x[L->place[p]] -= xi * L->value[p];
            } else if (i == j) {
                d[j] = xi;
            } else {
                L->place[l] = i, L->value[l++] = xi;
            }
        }
        if (d[j] == 0.0) return 1;
        for (int64_t p = L->start[j]; p < l; p++) L->value[p] /= d[j];
        L->start[j + 1] = l, U->start[j + 1] = u;
    }
    return 0;
}

/* U by rows, divided by the diagonal. */
static int by_rows(index_t n, part_t *U, const double *d)
{
    const int64_t total = U->start[n];
    int64_t *start = calloc(n + 2, sizeof *start);
    index_t *place = malloc((total + 1) * sizeof *place);
    double *value = malloc((total + 1) * sizeof *value);
    if (start && place && value) {
        for (int64_t p = 0; p < total; p++) start[U->place[p] + 2]++;
        for (index_t i = 0; i < n; i++) start[i + 2] += start[i + 1];
        for (index_t j = 0; j < n; j++)
            for (int64_t p = U->start[j]; p < U->start[j + 1]; p++) {
                const index_t i = U->place[p];
                const int64_t q = start[i + 1]++;
                place[q] = j, value[q] = U->value[p] / d[i];
            }
        free(U->start), free(U->place), free(U->value);
        U->start = start, U->place = place, U->value = value;
        return 1;
    }
    free(start), free(place), free(value);
    return 0;
}

/* The entry of Z that stands at the transposed place (own, other) of a part; the place is there. */
static double at(const part_t *part, index_t own, index_t other)
{
    int64_t low = part->start[own], high = part->start[own + 1];
    while (high - low > 1) {
        const int64_t middle = low + (high - low) / 2;
        if (part->place[middle] > other) high = middle;
        else low = middle;
    }
    return part->z[low];
}

static void invert(index_t n, part_t *L, part_t *U, const double *d, double *z)
{
    for (index_t j = n - 1; j >= 0; j--) {
        const int64_t l0 = L->start[j], l1 = L->start[j + 1], u0 = U->start[j], u1 = U->start[j + 1];
        double own = 1.0 / d[j];
        for (int64_t q = l0; q < l1; q++) L->z[q] = 0.0;
        for (int64_t p = u0; p < u1; p++) {
            const index_t i = U->place[p];
            double sum = 0.0;
            for (int64_t q = l0; q < l1; q++) {
                const index_t k = L->place[q];
                const double entry = k == i ? z[i] : k > i ? at(L, i, k) : at(U, k, i); /* Z_ik */
                sum -= entry * L->value[q];
                L->z[q] -= U->value[p] * entry;
            }
            U->z[p] = sum;
            own -= U->value[p] * sum;
        }
        z[j] = own;
    }
}

/* Z at (columns[i], rows[i]), i < n_wanted, into `wanted`: places (rows[i], columns[i]) of A with an entry, or on the
   diagonal. 0: done, 1: a pivot is zero, 2: L and U have more than `most` entries, or memory ends. */
int daest_selected(long n_long, const int64_t *start, const index_t *place, const double *value, int64_t most,
                   long n_wanted, const index_t *rows, const index_t *columns, double *wanted)
{
    const index_t n = (index_t)n_long;
    part_t L = {0}, U = {0};
    L.start = malloc((n + 1) * sizeof *L.start), U.start = malloc((n + 1) * sizeof *U.start);
    double *d = malloc((n + 1) * sizeof *d), *x = malloc((n + 1) * sizeof *x);
    index_t *work = malloc((3 * (int64_t)n + 1) * sizeof *work);
    int state = L.start && U.start && d && x && work ? 0 : 2;
    if (!state)
        state = factorise(n, start, place, value, most, &L, &U, d, x, work, work + n, work + 2 * (int64_t)n);
    if (!state && !by_rows(n, &U, d)) state = 2;
    if (!state) {
        L.z = malloc((L.start[n] + 1) * sizeof *L.z), U.z = malloc((U.start[n] + 1) * sizeof *U.z);
        state = L.z && U.z ? 0 : 2;
    }
    if (!state) {
        invert(n, &L, &U, d, x);
        for (long i = 0; i < n_wanted; i++) {
            const index_t r = rows[i], c = columns[i];
            wanted[i] = r == c ? x[r] : r > c ? at(&L, c, r) : at(&U, r, c);
        }
    }
    free(L.start), free(L.place), free(L.value), free(L.z);
    free(U.start), free(U.place), free(U.value), free(U.z);
    free(d), free(x), free(work);
    return state;
}

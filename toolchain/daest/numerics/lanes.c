/* Vectors of numbers, one lane for each of several points, and the functions of them that models use. */
#include <math.h>
#include <stdint.h>

#if defined(__AVX512F__)
enum { LANES = 8 };
#elif defined(__AVX__)
enum { LANES = 4 };
#else
enum { LANES = 2 };
#endif

typedef double lanes_t __attribute__((vector_size(LANES * 8)));
typedef int64_t bits_t __attribute__((vector_size(LANES * 8)));

/* The number c in every lane. */
#define SPREAD(c) ((lanes_t){0} + (double)(c))
/* a where the lanes of `condition` are true (all bits set), else b. */
#define WHERE(condition, a, b) \
  ((lanes_t)(((bits_t)(condition) & (bits_t)(a)) | (~(bits_t)(condition) & (bits_t)(b))))
/* An expression of the lane i, for all lanes. */
#define EACH(expression)                                     \
  __extension__({                                            \
    lanes_t all;                                             \
    for (int i = 0; i < LANES; ++i) all[i] = (expression);   \
    all;                                                     \
  })

static inline lanes_t lanes_fabs(lanes_t x) { return (lanes_t)((bits_t)x & ((bits_t){0} + INT64_MAX)); }
static inline lanes_t lanes_fmax(lanes_t a, lanes_t b) { return WHERE(a < b, b, a); }
static inline lanes_t lanes_sqrt(lanes_t x) { return EACH(sqrt(x[i])); }

static inline double lanes_largest(lanes_t v) {
  double largest = v[0];
  for (int i = 1; i < LANES; ++i) largest = v[i] > largest ? v[i] : largest;
  return largest;
}

static inline int lanes_finite(lanes_t v) {
  for (int i = 0; i < LANES; ++i)
    if (!isfinite(v[i])) return 0;
  return 1;
}

/* exp(x) - 1 = scale (1 + rest) - 1 for -708 <= x <= 709; x outside gives the value at the end. By Taylor's series
 * over |r| < log(2) / 2, whose 14th term is below 1e-17 of the first, and a power of two in the exponent bits. */
static inline lanes_t lanes_power(lanes_t x, lanes_t *scale) {
  const double shift = 6755399441055744.0; /* 1.5 * 2^52: adding it rounds to integers */
  const lanes_t low = SPREAD(-708.0), high = SPREAD(709.0);
  x = WHERE(x < low, low, x);
  x = WHERE(x > high, high, x);
  const lanes_t shifted = x * 1.4426950408889634074 + shift, n = shifted - shift;
  const lanes_t r = (x - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10;
  *scale = (lanes_t)(((bits_t)shifted + 1023) << 52);
  lanes_t sum = SPREAD(1.0 / 6227020800.0);
  sum = sum * r + 1.0 / 479001600.0;
  sum = sum * r + 1.0 / 39916800.0;
  sum = sum * r + 1.0 / 3628800.0;
  sum = sum * r + 1.0 / 362880.0;
  sum = sum * r + 1.0 / 40320.0;
  sum = sum * r + 1.0 / 5040.0;
  sum = sum * r + 1.0 / 720.0;
  sum = sum * r + 1.0 / 120.0;
  sum = sum * r + 1.0 / 24.0;
  sum = sum * r + 1.0 / 6.0;
  sum = sum * r + 0.5;
  return r + r * r * sum;
}

/* 0 below exp(-708), infinite above exp(709). */
static inline lanes_t lanes_exp(lanes_t x) {
  lanes_t scale;
  const lanes_t rest = lanes_power(x, &scale), value = scale + scale * rest;
  const lanes_t finite = WHERE(x < SPREAD(-708.0), (lanes_t){0}, value);
  return WHERE(x > SPREAD(709.0), SPREAD(INFINITY), WHERE(x == x, finite, x));
}

/* m / (m + 2) with m = exp(2 |x|) - 1, which keeps all digits of small x. */
static inline lanes_t lanes_tanh(lanes_t x) {
  const lanes_t size = lanes_fabs(x);
  lanes_t scale;
  const lanes_t rest = lanes_power(2.0 * WHERE(size > SPREAD(20.0), SPREAD(20.0), size), &scale);
  const lanes_t m = scale * rest + (scale - 1.0), value = m / (m + 2.0);
  return WHERE(x == x, WHERE(x < (lanes_t){0}, -value, value), x);
}

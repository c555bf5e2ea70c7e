/* The functions that radau.c integrates, asked of the binary of an FMU; stands before radau.c.
 *
 * Instance 0 has the parameters of the solution; instances 1 + 2 i and 2 + 2 i those with the chosen parameter
 * i moved up and down by parameter_step[i]. Slopes are differences at a point: central ones where they enter
 * sensitivities, one-sided ones for the Newton iteration.
 * Constants: those of radau.c, and FMI (2 or 3).
 */
#include <stdbool.h>
#include <stddef.h>

#define casadi_int long long int
#define STEP 6.0554544523933395e-06 /* the cube root of the machine precision */
#define REFUSED(call) ((call) > 1)  /* FMI: 0 is ok, 1 a warning */

typedef int Time(void *, double);
typedef int States(void *, const double *, size_t);
typedef int Rates(void *, double *, size_t);
#if FMI == 3
typedef int Set(void *, const unsigned *, size_t, const double *, size_t);
typedef int Get(void *, const unsigned *, size_t, double *, size_t);
typedef int Completed(void *, bool, bool *, bool *);
#define LENGTH(n) , (n)
#else
typedef int Set(void *, const unsigned *, size_t, const double *);
typedef int Get(void *, const unsigned *, size_t, double *);
typedef int Completed(void *, int, int *, int *);
#define LENGTH(n)
#endif

static struct {
  Time *time;
  States *states;
  Rates *rates;
  Set *set;
  Get *get;
  Completed *completed; /* null where the FMU does not want to hear of steps */
} fmu;
static void *instance[1 + 2 * NP];
static unsigned inputs[NU + 1], outputs[NY + 1];
static double parameter_step[NP + 1], size_of_state[NX];
static double completed_at;
static int has_slopes, is_first, has_refused;

/* Time stands last too: in some tools what was read stays stale without. */
static int put(void *c, const double *x, const double *u, double t) {
  if (REFUSED(fmu.time(c, t))) return 1;
  if (NU && REFUSED(fmu.set(c, inputs, NU, u LENGTH(NU)))) return 1;
  return REFUSED(fmu.states(c, x, NX)) || REFUSED(fmu.time(c, t));
}

typedef int Asked(void *c, const double *x, const double *u, double t, double *values);

static int rates(void *c, const double *x, const double *u, double t, double *f) {
  return put(c, x, u, t) || REFUSED(fmu.rates(c, f, NX));
}

static int values(void *c, const double *x, const double *u, double t, double *h) {
  return put(c, x, u, t) || (NY && REFUSED(fmu.get(c, outputs, NY, h LENGTH(NY))));
}

static double step_of(const double *x, int i) {
  double size = x[i] < 0 ? -x[i] : x[i];
  return STEP * (size > size_of_state[i] ? size : size_of_state[i]);
}

/* d(asked)/dx (n x NX, column-major), central; or one-sided from the values `here` at x. */
static int by_states(Asked *asked, int n, const double *x, const double *u, double t, const double *here,
                     double *slopes) {
  double moved[NX], low[NX > NY ? NX : NY + 1];
  for (int i = 0; i < NX; ++i) moved[i] = x[i];
  for (int i = 0; i < NX; ++i) {
    double step = step_of(x, i), *column = slopes + i * n;
    moved[i] = x[i] + step;
    double high_end = moved[i];
    if (asked(instance[0], moved, u, t, column)) return 1;
    moved[i] = here ? x[i] : x[i] - step;
    double width = high_end - moved[i];
    if (!here && asked(instance[0], moved, u, t, low)) return 1;
    moved[i] = x[i];
    for (int q = 0; q < n; ++q) column[q] = (column[q] - (here ? here[q] : low[q])) / width;
  }
  return 0;
}

/* d(asked)/d(chosen parameters) (n x NP, column-major), central. */
static int by_parameters(Asked *asked, int n, const double *x, const double *u, double t, double *slopes) {
  double low[NX > NY ? NX : NY + 1];
  for (int i = 0; i < NP; ++i) {
    double *column = slopes + i * n;
    if (asked(instance[1 + 2 * i], x, u, t, column) || asked(instance[2 + 2 * i], x, u, t, low)) return 1;
    for (int q = 0; q < n; ++q) column[q] = (column[q] - low[q]) / (2 * parameter_step[i]);
  }
  return 0;
}

/* A step starts at x: the one before it is completed. */
static int complete(double t) {
  int none_before = is_first;
  if (!fmu.completed || (!none_before && t <= completed_at)) return 0;
  completed_at = t;
  is_first = 0;
  if (none_before) return 0;
#if FMI == 3
  bool event = false, end = false;
  if (REFUSED(fmu.completed(instance[0], true, &event, &end))) return 1;
#else
  int event = 0, end = 0;
  if (REFUSED(fmu.completed(instance[0], 1, &event, &end))) return 1;
#endif
  return event || end;
}

static int daest_rhs(const double **arg, double **res, casadi_int *iw, double *w, int memory) {
  (void)iw, (void)w, (void)memory;
  if (rates(instance[0], arg[0], arg[1], arg[3][0], res[0])) return 1;
  if (!res[1]) return 0;
  if (complete(arg[3][0])) return 1;
  return by_states(rates, NX, arg[0], arg[1], arg[3][0], res[0], res[1]);
}

/* radau.c takes for granted that the next two succeed: what was refused is told by daest_refused. */
static int daest_sens(const double **arg, double **res, casadi_int *iw, double *w, int memory) {
  (void)iw, (void)w, (void)memory;
  has_refused |= by_states(rates, NX, arg[0], arg[1], arg[3][0], 0, res[0]) ||
                 by_parameters(rates, NX, arg[0], arg[1], arg[3][0], res[1]);
  return has_refused;
}

static int daest_out(const double **arg, double **res, casadi_int *iw, double *w, int memory) {
  (void)iw, (void)w, (void)memory;
  has_refused |= values(instance[0], arg[0], arg[1], arg[3][0], res[0]);
  if (!has_slopes || has_refused) return has_refused;
  has_refused |= by_states(values, NY, arg[0], arg[1], arg[3][0], 0, res[1]) ||
                 by_parameters(values, NY, arg[0], arg[1], arg[3][0], res[2]);
  return has_refused;
}

int daest_refused(void) { return has_refused; }

/* What the next daest_simulate asks: functions in the order of `fmu`, instances, value references, steps. */
void daest_bind(void *const *functions, void *const *given, const unsigned *input_references,
                const unsigned *output_references, const double *steps, const double *sizes, int slopes) {
  fmu.time = (Time *)functions[0];
  fmu.states = (States *)functions[1];
  fmu.rates = (Rates *)functions[2];
  fmu.set = (Set *)functions[3];
  fmu.get = (Get *)functions[4];
  fmu.completed = (Completed *)functions[5];
  for (int i = 0; i < 1 + 2 * NP; ++i) instance[i] = given[i];
  for (int i = 0; i < NU; ++i) inputs[i] = input_references[i];
  for (int i = 0; i < NY; ++i) outputs[i] = output_references[i];
  for (int i = 0; i < NP; ++i) parameter_step[i] = steps[i];
  for (int i = 0; i < NX; ++i) size_of_state[i] = sizes[i];
  has_slopes = slopes;
  is_first = 1;
  has_refused = 0;
}

/* The functions that radau.c integrates, asked of the binary of an FMU; stands before radau.c.
 *
 * Instance 0 has the parameters of the solution; instances 1 + 2 i and 2 + 2 i those with the chosen parameter
 * i moved up and down by parameter_step[i]. Slopes are differences at a point: central ones where they enter
 * sensitivities, one-sided ones for the Newton iteration.
 * Laws add a function of one variable of the FMU, or of one of u, and of a size to an input; the last of the chosen
 * parameters may be sizes: every instance has its own.
 * Constants: those of radau.c, NP (chosen parameters), FMI (2 or 3), N_SET (the first of u, which the FMU is given) and NL (laws).
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>

#define casadi_int long long int
#define STEP 6.0554544523933395e-06 /* the cube root of the machine precision */
/* FMI: 0 is ok, 1 a warning. Calls that come back are counted: they tell that the FMU is alive. */
#define REFUSED(call) (came_back(call) > 1)

volatile long daest_calls;
static int came_back(int status) {
  ++daest_calls;
  return status;
}

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
static unsigned inputs[N_SET + 1], outputs[NY + 1];
static double parameter_step[NP + 1], size_of_state[NX];
static double completed_at;
static int has_slopes, is_first, has_refused;

#if NL > 0
/* In the order of fmu.laws.NAMES. */
enum {
  COPY, ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATE, SQUARE, TWICE, INVERT, POWER, ROOT, EXPONENTIAL, LOGARITHM, SINE,
  COSINE, TANGENT, ARCTANGENT, TANH, MAGNITUDE, SIGN, SMALLER, LARGER, BELOW, AT_MOST, NOT, WHERE, CONSTANT, VARIABLE,
  SIZE
};
enum { MOST_STEPS = 64 };
static struct {
  int input, column, n_steps; /* column: the entry of u that is read, or -1 */
  int reads_variable;
  unsigned reads;
  struct {
    int step, target, a, b;
    double number;
  } program[MOST_STEPS];
} law[NL];
static double law_size[1 + 2 * NP][NL];

static double step_value(int step, double a, double b) {
  switch (step) {
    case COPY: return a;
    case ADD: return a + b;
    case SUBTRACT: return a - b;
    case MULTIPLY: return a * b;
    case DIVIDE: return a / b;
    case NEGATE: return -a;
    case SQUARE: return a * a;
    case TWICE: return 2.0 * a;
    case INVERT: return 1.0 / a;
    case POWER: return pow(a, b);
    case ROOT: return sqrt(a);
    case EXPONENTIAL: return exp(a);
    case LOGARITHM: return log(a);
    case SINE: return sin(a);
    case COSINE: return cos(a);
    case TANGENT: return tan(a);
    case ARCTANGENT: return atan(a);
    case TANH: return tanh(a);
    case MAGNITUDE: return fabs(a);
    case SIGN: return (a > 0.0) - (a < 0.0);
    case SMALLER: return fmin(a, b);
    case LARGER: return fmax(a, b);
    case BELOW: return a < b;
    case AT_MOST: return a <= b;
    case NOT: return !a;
    default: return a ? b : 0.0; /* WHERE */
  }
}

static double law_value(int l, double variable, double size) {
  double registers[MOST_STEPS] = {0.0}, last = 0.0;
  for (int k = 0; k < law[l].n_steps; ++k) {
    int step = law[l].program[k].step;
    last = step == CONSTANT   ? law[l].program[k].number
           : step == VARIABLE ? variable
           : step == SIZE     ? size
                              : step_value(step, registers[law[l].program[k].a], registers[law[l].program[k].b]);
    registers[law[l].program[k].target] = last;
  }
  return last;
}

static int add_laws(int i, const double *u) {
  double whole[N_SET + 1];
  for (int k = 0; k < N_SET; ++k) whole[k] = u[k];
  for (int l = 0; l < NL; ++l) {
    double v = law[l].column < 0 ? 0.0 : u[law[l].column];
    if (law[l].reads_variable && REFUSED(fmu.get(instance[i], &law[l].reads, 1, &v LENGTH(1)))) return 1;
    whole[law[l].input] += law_value(l, v, law_size[i][l]);
  }
  return REFUSED(fmu.set(instance[i], inputs, N_SET, whole LENGTH(N_SET)));
}
#endif

/* Time stands last too: in some tools what was read stays stale without. */
static int put(int i, const double *x, const double *u, double t) {
  void *c = instance[i];
  if (REFUSED(fmu.time(c, t))) return 1;
  if (N_SET && REFUSED(fmu.set(c, inputs, N_SET, u LENGTH(N_SET)))) return 1;
  if (REFUSED(fmu.states(c, x, NX)) || REFUSED(fmu.time(c, t))) return 1;
#if NL > 0
  if (add_laws(i, u)) return 1;
#endif
  return 0;
}

/* Asked of instance i. */
typedef int Asked(int i, const double *x, const double *u, double t, double *values);

static int rates(int i, const double *x, const double *u, double t, double *f) {
  return put(i, x, u, t) || REFUSED(fmu.rates(instance[i], f, NX));
}

static int values(int i, const double *x, const double *u, double t, double *h) {
  return put(i, x, u, t) || (NY && REFUSED(fmu.get(instance[i], outputs, NY, h LENGTH(NY))));
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
    if (asked(0, moved, u, t, column)) return 1;
    moved[i] = here ? x[i] : x[i] - step;
    double width = high_end - moved[i];
    if (!here && asked(0, moved, u, t, low)) return 1;
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
    if (asked(1 + 2 * i, x, u, t, column) || asked(2 + 2 * i, x, u, t, low)) return 1;
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
  if (rates(0, arg[0], arg[1], arg[3][0], res[0])) return 1;
  if (!res[1]) return 0;
  if (complete(arg[3][0])) return 1;
  return by_states(rates, NX, arg[0], arg[1], arg[3][0], res[0], res[1]);
}

#define daest_rate daest_rhs /* it leaves out what is not asked for */
static const casadi_int daest_work[4], daest_n_chosen = NP;

/* radau.c takes for granted that the next two succeed: what was refused is told by daest_refused. */
static int daest_sens(const double **arg, double **res, casadi_int *iw, double *w, int memory) {
  (void)iw, (void)w, (void)memory;
  has_refused |= by_states(rates, NX, arg[0], arg[1], arg[3][0], 0, res[0]) ||
                 by_parameters(rates, NX, arg[0], arg[1], arg[3][0], res[1]);
  return has_refused;
}

static int daest_out(const double **arg, double **res, casadi_int *iw, double *w, int memory) {
  (void)iw, (void)w, (void)memory;
  has_refused |= values(0, arg[0], arg[1], arg[3][0], res[0]);
  if (!has_slopes || has_refused) return has_refused;
  has_refused |= by_states(values, NY, arg[0], arg[1], arg[3][0], 0, res[1]) ||
                 by_parameters(values, NY, arg[0], arg[1], arg[3][0], res[2]);
  return has_refused;
}

int daest_refused(void) { return has_refused; }

/* What the next daest_simulate asks: functions in the order of `fmu`, instances, value references, steps; of every
 * law its row of fmu.laws.law_table, and the sizes of each instance. */
void daest_bind(void *const *functions, void *const *given, const unsigned *input_references,
                const unsigned *output_references, const double *steps, const double *sizes, int slopes,
                const double *laws, const double *law_sizes) {
#if NL > 0
  for (int l = 0; l < NL; ++l, laws += 4 + 5 * MOST_STEPS) {
    law[l].input = (int)laws[0];
    law[l].column = (int)laws[1];
    law[l].reads_variable = laws[2] >= 0.0;
    law[l].reads = law[l].reads_variable ? (unsigned)laws[2] : 0;
    law[l].n_steps = (int)laws[3];
    for (int k = 0; k < law[l].n_steps; ++k) {
      const double *step = laws + 4 + 5 * k;
      law[l].program[k].step = (int)step[0];
      law[l].program[k].target = (int)step[1];
      law[l].program[k].a = (int)step[2];
      law[l].program[k].b = (int)step[3];
      law[l].program[k].number = step[4];
    }
  }
  for (int i = 0; i < 1 + 2 * NP; ++i)
    for (int l = 0; l < NL; ++l) law_size[i][l] = *law_sizes++;
#else
  (void)laws, (void)law_sizes;
#endif
  fmu.time = (Time *)functions[0];
  fmu.states = (States *)functions[1];
  fmu.rates = (Rates *)functions[2];
  fmu.set = (Set *)functions[3];
  fmu.get = (Get *)functions[4];
  fmu.completed = (Completed *)functions[5];
  for (int i = 0; i < 1 + 2 * NP; ++i) instance[i] = given[i];
  for (int i = 0; i < N_SET; ++i) inputs[i] = input_references[i];
  for (int i = 0; i < NY; ++i) outputs[i] = output_references[i];
  for (int i = 0; i < NP; ++i) parameter_step[i] = steps[i];
  for (int i = 0; i < NX; ++i) size_of_state[i] = sizes[i];
  has_slopes = slopes;
  is_first = 1;
  has_refused = 0;
}

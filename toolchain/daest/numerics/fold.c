/* The loop s[k+1], o[k] = step(s[k], d[k], c) over a recording, and its tangents, for a step that CasADi generated.
 *
 * step    (s, d, c) -> s_next, o
 * tangent (s, d, c, ds, dc) -> ds_next, do            (one direction)
 * Compile-time constants: NS, ND, NC, NO (lengths of s, d, c, o) and the work sizes STEP_*, TANGENT_*.
 */
#include <stdlib.h>
#include <string.h>

typedef struct {
  const double **arg;
  double **res;
  casadi_int *iw;
  double *w;
} Work;

static int make_work(Work *k) {
  casadi_int iw = STEP_IW > TANGENT_IW ? STEP_IW : TANGENT_IW, w = STEP_W > TANGENT_W ? STEP_W : TANGENT_W;
  casadi_int arg = STEP_ARG > TANGENT_ARG ? STEP_ARG : TANGENT_ARG;
  casadi_int res = STEP_RES > TANGENT_RES ? STEP_RES : TANGENT_RES;
  k->arg = malloc(sizeof(double *) * (arg + 5));
  k->res = malloc(sizeof(double *) * (res + 2));
  k->iw = malloc(sizeof(casadi_int) * (iw + 1));
  k->w = malloc(sizeof(double) * (w + 1));
  return k->arg && k->res && k->iw && k->w;
}

static void free_work(Work *k) {
  free((void *)k->arg);
  free(k->res);
  free(k->iw);
  free(k->w);
}

/* s (NS) enters as s[0] and leaves as s[n]; d n x ND; c NC; out n x NO. With directions > 0: ds directions x NS
 * in and out; dc directions x NC; dout n x directions x NO. Returns 0, or 1 when there is no memory, 2 when the
 * step refused. */
int daest_fold(long n, double *s, const double *d, const double *c, double *out, int directions, double *ds,
               const double *dc, double *dout) {
  Work k;
  double next[NS + 1];
  int status = make_work(&k) ? 0 : 1;
  for (long i = 0; i < n && !status; ++i) {
    k.arg[0] = s;
    k.arg[1] = d + i * ND;
    k.arg[2] = c;
    for (int j = 0; j < directions && !status; ++j) {
      k.arg[3] = ds + j * NS;
      k.arg[4] = dc + j * NC;
      k.res[0] = next;
      k.res[1] = dout + (i * directions + j) * NO;
      if (daest_tangent(k.arg, k.res, k.iw, k.w, 0)) status = 2;
      memcpy(ds + j * NS, next, sizeof(double) * NS);
    }
    k.res[0] = next;
    k.res[1] = out + i * NO;
    if (!status && daest_step(k.arg, k.res, k.iw, k.w, 0)) status = 2;
    memcpy(s, next, sizeof(double) * NS);
  }
  free_work(&k);
  return status;
}

/* Events of a model written by daest, included by fmi3.c: relations, discrete variables and restarted states that
 * agree with each other (Modelica Language Specification, Appendix B), as systems/events/event_update.py in daest.
 *
 * What keeps its value between events stands in `theta`. Relations change where an event indicator has gone a
 * little beyond zero, so that an importer that stops a little before or behind the root finds the same.
 */
#include <float.h>

#define MOST_ROUNDS 400
#define ALL_AT_ONCE 20
#define IN_TURN 80
#define MOST_AT_ONE_INSTANT 100
#define SAME_INSTANT 1e-12 /* of the time, at least of 1 s */
#define MARGIN 1e-10       /* how far beyond zero an indicator is when its event happens */
#define N_SWITCHES (N_RELATIONS + N_WHOLES)

typedef struct {
    double values[N_RELATIONS + 1], wholes[N_WHOLES + 1], conditions[N_CONDITIONS + 1], assigned[N_ASSIGNED + 1];
    double sources[N_MEMORIES + 1], restarted[2 * N_RESTARTS + 1], samples[2 * N_TICKS + 1], starts[N_STARTS + 1];
} Point;

/* An event: samples that are due, relations that change because their instant has come (to `forced`, when their
 * function has the value `at`), active branches. */
typedef struct {
    double active[N_ACTIVE + 1], ticks[N_TICKS + 1], forced[N_SWITCHES + 1], at[N_SWITCHES + 1];
    unsigned char is_forced[N_SWITCHES + 1];
} Event;

/* In which order relations change that are not what they should be. */
typedef struct {
    int rounds, last;
    unsigned long random;
} Order;

static double largest(double a, double b) { return a > b ? a : b; }

static void inputs_and_rates(const State *s, double *ubar) {
    memcpy(ubar, s->u, N_U * sizeof(double));
    memcpy(ubar + N_U, s->v, N_V * sizeof(double));
}

static int point_at(Model *m, const double *theta, const Event *e, Point *p) {
    double ubar[N_U + N_V + 1];
    inputs_and_rates(&m->state, ubar);
    m->arg[0] = m->state.x;
    m->arg[1] = ubar;
    m->arg[2] = theta;
    m->arg[3] = &m->state.time;
    m->arg[4] = e->active;
    m->arg[5] = e->ticks;
    double *into[] = {p->values, p->wholes, p->conditions, p->assigned, p->sources, p->restarted, p->samples, p->starts};
    memcpy(m->res, into, sizeof into);
    return model_at(m->arg, m->res, m->iw, m->work, 0);
}

static int indicators(Model *m, double *g) {
    double ubar[N_U + N_V + 1];
    inputs_and_rates(&m->state, ubar);
    m->arg[0] = m->state.x;
    m->arg[1] = ubar;
    m->arg[2] = m->state.theta;
    m->arg[3] = &m->state.time;
    m->res[0] = g;
    if (model_roots(m->arg, m->res, m->iw, m->work, 0)) return 1;
    for (unsigned i = 0; i < N_ROOTS; i++) {
        unsigned owner = ROOT_OWNER[i];
        int is_true = owner < N_RELATIONS && m->state.theta[RELATION_SLOT[owner]] > 0.5;
        g[i] += is_true ? MARGIN : -MARGIN;
    }
    return 0;
}

/* ------------------------------------------------------------------------------------------- one event */

static double truth(const Point *p, const Event *e, unsigned i) {
    if (e->is_forced[i] && fabs(p->values[i]) <= 2.0 * e->at[i] + DBL_MIN) return e->forced[i];
    return RELATION_IS_STRICT[i] ? p->values[i] > 0.0 : p->values[i] >= 0.0;
}

static int chosen(Order *o, const int *wrong, int n) {
    if (o->rounds <= IN_TURN) {
        for (int k = 0; k < n; k++)
            if (wrong[k] > o->last) return wrong[k];
        return wrong[0];
    }
    o->random = (o->random * 1103515245ul + 12345ul) & 0x7ffffffful;
    return wrong[(o->random >> 8) % (unsigned long)n];
}

static void switch_relations(double *theta, const Point *p, const Event *e, Order *o) {
    int wrong[N_RELATIONS + 1], n = 0;
    for (int i = 0; i < (int)N_RELATIONS; i++)
        if (theta[RELATION_SLOT[i]] != truth(p, e, (unsigned)i)) wrong[n++] = i;
    if (++o->rounds > ALL_AT_ONCE && n) {
        wrong[0] = o->last = chosen(o, wrong, n);
        n = 1;
    }
    for (int k = 0; k < n; k++) theta[RELATION_SLOT[wrong[k]]] = truth(p, e, (unsigned)wrong[k]);
    for (unsigned i = 0; i < N_WHOLES; i++) {
        unsigned k = N_RELATIONS + i;
        int is_near = e->is_forced[k] && fabs(p->wholes[i] - e->forced[k]) <= 0.5;
        theta[WHOLE_SLOT[i]] = is_near ? e->forced[k] : floor(p->wholes[i]);
    }
}

static void rising(const State *s, const Point *p, double *active) {
    for (unsigned i = 0; i < N_ACTIVE; i++) {
        int is_active = 0;
        for (unsigned k = ACTIVE_FIRST[i]; k < ACTIVE_LAST[i]; k++)
            is_active |= p->conditions[k] > 0.5 && !s->conditions[k];
        for (unsigned j = 0; j < i; j++)
            if (ACTIVE_BEFORE[i * N_ACTIVE + j] && active[j] > 0.5) is_active = 0;
        active[i] = is_active;
    }
}

/* State `state` such that the unknown has its value. */
static void give(const State *s, const double *xi, unsigned unknown, unsigned state, double share, double value, double *x) {
    if (xi[unknown] == value) return;
    x[state] = fabs(share) == 1.0 ? share * value : s->x[state] + (value - xi[unknown]) / share;
}

static int same(const double *a, const double *b, unsigned n) {
    for (unsigned i = 0; i < n; i++)
        if (a[i] != b[i] && !(isnan(a[i]) && isnan(b[i]))) return 0;
    return 1;
}

/* Relations, active branches and assigned variables that agree with each other; 0 where they find no end. */
static int consistent(Model *m, Event *e, Point *p) {
    State *s = &m->state;
    Order order = {0, -1, 1};
    double theta[N_THETA + 1], active[N_ACTIVE + 1], x[N_X + 1], xi[N_XI + 1];
    for (int round = 0; round < MOST_ROUNDS; round++) {
        if (point_at(m, s->theta, e, p)) return 0;
        memcpy(theta, s->theta, sizeof theta);
        memcpy(x, s->x, sizeof x);
        switch_relations(theta, p, e, &order);
        rising(s, p, active);
        if (N_ASSIGNED && evaluate(m, &VARIABLES, NULL, NULL, xi)) return 0;
        for (unsigned i = 0; i < N_ASSIGNED; i++) {
            if (ASSIGNED_SLOT[i] >= 0) theta[ASSIGNED_SLOT[i]] = p->assigned[i];
            if (ASSIGNED_UNKNOWN[i] >= 0)
                give(s, xi, (unsigned)ASSIGNED_UNKNOWN[i], ASSIGNED_STATE[i], ASSIGNED_SHARE[i], p->assigned[i], x);
        }
        if (same(theta, s->theta, N_THETA) && same(active, e->active, N_ACTIVE) && same(x, s->x, N_X)) return 1;
        memcpy(s->theta, theta, sizeof theta);
        memcpy(e->active, active, sizeof active);
        memcpy(s->x, x, sizeof x);
    }
    return 0;
}

static int restart(Model *m, const Point *p) {
    State *s = &m->state;
    int is_any = 0;
    double x[N_X + 1], xi[N_XI + 1];
    memcpy(x, s->x, sizeof x);
    for (unsigned i = 0; i < N_RESTARTS; i++) {
        if (!(p->restarted[i] > 0.5)) continue;
        if (!is_any && evaluate(m, &VARIABLES, NULL, NULL, xi)) return 0;
        give(s, xi, RESTART_UNKNOWN[i], RESTART_STATE[i], RESTART_SHARE[i], p->restarted[N_RESTARTS + i], x);
        is_any = 1;
    }
    memcpy(s->x, x, sizeof x);
    return is_any;
}

static int settled(Model *m, Event *e) {
    State *s = &m->state;
    Point p;
    Event quiet;
    memset(&quiet, 0, sizeof quiet);
    if (point_at(m, s->theta, &quiet, &p)) return 0;
    for (unsigned i = 0; i < N_MEMORIES; i++) s->theta[MEMORY_SLOT[i]] = p.sources[i];
    for (int round = 0; round < MOST_ROUNDS; round++) {
        int again = 0;
        if (!consistent(m, e, &p)) return 0;
        for (unsigned i = 0; i < N_MEMORIES; i++) again |= s->theta[MEMORY_SLOT[i]] != p.sources[i];
        for (unsigned k = 0; k < N_CONDITIONS; k++) again |= s->conditions[k] != (p.conditions[k] > 0.5);
        again |= restart(m, &p);
        for (unsigned i = 0; i < N_MEMORIES; i++) s->theta[MEMORY_SLOT[i]] = p.sources[i];
        for (unsigned k = 0; k < N_CONDITIONS; k++) s->conditions[k] = p.conditions[k] > 0.5;
        memset(e->ticks, 0, sizeof e->ticks);
        if (INITIAL_SLOT >= 0 && s->theta[INITIAL_SLOT] != 0.0) {
            s->theta[INITIAL_SLOT] = 0.0;
            again = 1;
        }
        if (!again) return 1;
        memset(e->active, 0, sizeof e->active);
    }
    return 0;
}

/* ------------------------------------------------------------------------------------------------- time */

static void no_later(double *first, double due) {
    if (due < *first) *first = due;
}

/* The next instant that follows from time alone, infinite if there is none; what is due by now goes into `e`. */
static int schedule(Model *m, Event *e, double *first) {
    State *s = &m->state;
    double zero[N_SWITCHES + 1], slope[N_SWITCHES + 1], ubar[N_U + N_V + 1], now = s->time;
    double near = SAME_INSTANT * largest(1.0, fabs(now));
    Point p;
    *first = HUGE_VAL;
    if (point_at(m, s->theta, e, &p)) return 0;
    inputs_and_rates(s, ubar);
    m->arg[0] = s->x;
    m->arg[1] = ubar;
    m->arg[2] = s->theta;
    m->res[0] = zero;
    m->res[1] = slope;
    if (model_clock(m->arg, m->res, m->iw, m->work, 0)) return 0;
    for (unsigned i = 0; i < N_SWITCHES; i++) {
        if (!IS_TIMED[i] || slope[i] == 0.0) continue;
        double target = 0.0, after = slope[i] > 0.0;
        if (i < N_RELATIONS) {
            if ((slope[i] > 0.0) == (s->theta[RELATION_SLOT[i]] > 0.5)) continue;
        } else {
            double number = s->theta[WHOLE_SLOT[i - N_RELATIONS]];
            target = slope[i] > 0.0 ? number + 1.0 : number;
            after = slope[i] > 0.0 ? target : number - 1.0;
        }
        double due = largest((target - zero[i]) / slope[i], now);
        no_later(first, due);
        if (due <= now + near) {
            e->is_forced[i] = 1;
            e->forced[i] = after;
            e->at[i] = i < N_RELATIONS ? fabs(p.values[i]) : 0.0;
        }
    }
    for (unsigned k = 0; k < N_TICKS; k++) {
        double due = p.samples[k] + s->ticks_done[k] * p.samples[N_TICKS + k];
        no_later(first, due);
        e->ticks[k] = due <= now + near;
    }
    return 1;
}

/* Everything that happens at the present instant, and when the next event is due. */
static int happen(Model *m, int *is_moved) {
    State *s = &m->state;
    double before[N_X + 1];
    memcpy(before, s->x, sizeof before);
    for (int turn = 0; turn < MOST_AT_ONE_INSTANT; turn++) {
        Event e;
        memset(&e, 0, sizeof e);
        if (!schedule(m, &e, &s->due)) return 0;
        if (turn && s->due > s->time + SAME_INSTANT * largest(1.0, fabs(s->time))) {
            *is_moved = !same(before, s->x, N_X);
            m->is_current = 0;
            return 1;
        }
        for (unsigned k = 0; k < N_TICKS; k++) s->ticks_done[k] += e.ticks[k];
        if (!settled(m, &e)) return 0;
    }
    return 0;
}

/* The mode in which the model starts, with the values that are set by now. */
static int start_mode(Model *m) {
    State *s = &m->state;
    Event e;
    Point p;
    Order order = {0, -1, 1};
    double theta[N_THETA + 1], asleep[N_THETA + 1];
    memset(&e, 0, sizeof e);
    if (INITIAL_SLOT >= 0) s->theta[INITIAL_SLOT] = 1.0;
    for (int round = 0;; round++) {
        if (round == MOST_ROUNDS || point_at(m, s->theta, &e, &p)) return 0;
        memcpy(theta, s->theta, sizeof theta);
        for (unsigned i = 0; i < N_STARTS; i++) theta[START_SLOT[i]] = p.starts[i];
        switch_relations(theta, &p, &e, &order);
        if (same(theta, s->theta, N_THETA)) break;
        memcpy(s->theta, theta, sizeof theta);
    }
    memcpy(asleep, s->theta, sizeof asleep);
    if (INITIAL_SLOT >= 0) asleep[INITIAL_SLOT] = 0.0;
    if (point_at(m, asleep, &e, &p)) return 0;
    for (unsigned k = 0; k < N_CONDITIONS; k++) s->conditions[k] = p.conditions[k] > 0.5;
    if (!settled(m, &e)) return 0;
    if (INITIAL_SLOT >= 0) {
        memset(&e, 0, sizeof e);
        s->theta[INITIAL_SLOT] = 0.0;
        if (!settled(m, &e)) return 0;
    }
    for (unsigned k = 0; k < N_TICKS; k++) { /* samples before the start are past */
        double interval = p.samples[N_TICKS + k], near = SAME_INSTANT * largest(1.0, fabs(s->time));
        s->ticks_done[k] = largest(ceil((s->time - p.samples[k] - near) / interval), 0.0);
    }
    m->is_current = 0;
    return 1;
}

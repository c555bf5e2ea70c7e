/* An FMI 2.0 FMU that does harm when it is initialised: what DEED names. Its output y says what came of it, 1 for a deed
 * that was done. PLACE is a file or folder outside of its own, SECRET a variable of the environment. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>
#include "fmi2Functions.h"

enum { H, DH, U, Y, K, N };
typedef struct { double v[N]; } M;

static int is_written(const char *path) {
    int f = open(path, O_CREAT | O_WRONLY, 0600);
    return f >= 0 && write(f, "x", 1) == 1;
}
static void *work(void *done) { *(int *)done = 1; return 0; }

static int deed(void) {
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(PORT), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int s, done = 0;
    char name[1000];
    pthread_t thread;
    switch (DEED) {
        case 1: return is_written(PLACE);
        case 2: return getenv("SECRET") != 0;
        case 3: s = socket(AF_INET, SOCK_STREAM, 0); return s >= 0 && connect(s, (void *)&to, sizeof to) == 0;
        case 4: s = socket(AF_INET, SOCK_DGRAM, 0); return s >= 0 && sendto(s, "x", 1, 0, (void *)&to, sizeof to) == 1;
        case 5: /* daemons */
            for (int i = 0; i < 20; i++) {
                pid_t p = fork();
                if (p == 0) { setsid(); for (;;) pause(); }
                done |= p > 0;
            }
            return done;
        case 6: return kill(getppid(), 0) == 0;
        case 7: return chmod(PLACE, 0777) == 0;
        case 8: return unlink(PLACE) == 0;
        case 9: return rename(PLACE, PLACE ".away") == 0;
        case 10: return system("true") == 0;
        case 11: return symlink("/", PLACE ".link") == 0;
        case 12: return truncate(PLACE, 0) == 0;
        case 13: for (int f = 0; f < 1000; f++) close(f); return 1;
        case 14: unlink("printed.log"); return mkfifo("printed.log", 0600) == 0 && (abort(), 1);
        /* What a good one does: a file of its own, a thread, a temporary file. */
        case 20:
            snprintf(name, sizeof name, "%s/passing-XXXXXX", getenv("TMPDIR"));
            return is_written("own") && mkstemp(name) >= 0 && !pthread_create(&thread, 0, work, &done) && !pthread_join(thread, 0) && done;
        default: return 0;
    }
}
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean log) {
    M *m = calloc(1, sizeof(M));
    m->v[H] = 1.0; m->v[K] = 1.0;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real t, fmi2Boolean e, fmi2Real f) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { ((M *)c)->v[Y] = deed(); return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) { memset(info, 0, sizeof *info); return fmi2OK; }
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { ((M *)c)->v[H] = x[0]; return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = ((M *)c)->v[H]; return fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real d[], size_t n) { M *m = c; d[0] = m->v[U] - m->v[K] * m->v[H]; return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = 1; return fmi2OK; }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean a, fmi2Boolean *e, fmi2Boolean *t) { *e = *t = 0; return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) { for (size_t i = 0; i < n; i++) v[i] = ((M *)c)->v[r[i]]; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) { for (size_t i = 0; i < n; i++) ((M *)c)->v[r[i]] = v[i]; return fmi2OK; }

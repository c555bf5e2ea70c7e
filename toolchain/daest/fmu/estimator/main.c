/* Replays a recording: estimator_main RECORDING.csv > estimates.csv
 *
 * The first row names the columns: time, the inputs and the outputs by their names, with or without a unit behind
 * (`phi [rad]`); values must be in the units of the model. An empty cell is a missing output.
 */
#include "estimator.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_COLUMNS = 1024, MOST_CHARACTERS = 65536 };

/* Cells of a line, cut in place; quotation marks around a cell are left out. */
static int cells_of(char *line, char *cells[]) {
    int n = 0;
    line[strcspn(line, "\r\n")] = 0;
    while (n < MOST_COLUMNS) {
        char *end = strchr(line, ',');
        size_t length;
        if (end) *end = 0;
        while (*line == ' ' || *line == '"') ++line;
        length = strlen(line);
        while (length && (line[length - 1] == ' ' || line[length - 1] == '"')) line[--length] = 0;
        cells[n++] = line;
        if (!end) break;
        line = end + 1;
    }
    return n;
}

static int column_of(char *cells[], int n, const char *name) {
    const size_t length = strlen(name);
    for (int i = 0; i < n; ++i)
        if (strncmp(cells[i], name, length) == 0 && (cells[i][length] == 0 || strncmp(cells[i] + length, " [", 2) == 0))
            return i;
    return -1;
}

/* 1: a number; 0: an empty cell; -1: something else. */
static int number_of(const char *cell, double *value) {
    char *end;
    if (*cell == 0) return 0;
    *value = strtod(cell, &end);
    return *end == 0 && isfinite(*value) ? 1 : -1;
}

static void print(double value) {
    if (isfinite(value))
        printf(",%.17g", value);
    else
        printf(",");
}

int main(int argc, char **argv) {
    static char line[MOST_CHARACTERS], *cells[MOST_COLUMNS];
    static Estimator e;
    static est_real u[EST_ARRAY(EST_NU)], y[EST_ARRAY(EST_NY)];
    static int valid[EST_ARRAY(EST_NY)], input[EST_ARRAY(EST_NU)], output[EST_ARRAY(EST_NY)];
    FILE *file = argc > 1 ? fopen(argv[1], "r") : stdin;
    long row = 1;
    int n, time;
    if (!file || !fgets(line, sizeof line, file)) {
        fprintf(stderr, "%s cannot be read\n", argc > 1 ? argv[1] : "stdin");
        return 2;
    }
    n = cells_of(line, cells);
    time = column_of(cells, n, "time");
    if (time < 0) time = column_of(cells, n, "time_s");
    for (int i = 0; i < EST_NU; ++i)
        if ((input[i] = column_of(cells, n, estimator_inputs[i])) < 0) {
            fprintf(stderr, "there is no column %s\n", estimator_inputs[i]);
            return 2;
        }
    for (int j = 0; j < EST_NY; ++j) output[j] = column_of(cells, n, estimator_outputs[j]);
    if (time < 0) {
        fprintf(stderr, "there is no column time\n");
        return 2;
    }
    estimator_init(&e);
    printf("time");
    for (int v = 0; v < EST_NV; ++v) printf(",\"%s\",\"%s.std\"", estimator_values[v], estimator_values[v]);
    for (int j = 0; j < EST_NY; ++j) printf(",\"innovation.%s\"", estimator_outputs[j]);
    printf(",nis,log_likelihood\n");
    while (fgets(line, sizeof line, file)) {
        double now = 0, value = 0;
        int status;
        ++row;
        if (line[strspn(line, " \r\n")] == 0) continue;
        if (cells_of(line, cells) != n || number_of(cells[time], &now) != 1) {
            fprintf(stderr, "line %ld is no sample\n", row);
            return 2;
        }
        for (int i = 0; i < EST_NU; ++i) {
            if (number_of(cells[input[i]], &value) != 1) {
                fprintf(stderr, "line %ld: %s has no value\n", row, estimator_inputs[i]);
                return 2;
            }
            u[i] = (est_real)value;
        }
        for (int j = 0; j < EST_NY; ++j) {
            valid[j] = output[j] >= 0 && number_of(cells[output[j]], &value) == 1;
            y[j] = valid[j] ? (est_real)value : 0;
        }
        status = estimator_step(&e, now, u, y, valid);
        if (status) {
            fprintf(stderr, "line %ld: the estimator stops with status %d\n", row, status);
            return 1;
        }
        printf("%.17g", now);
        for (int v = 0; v < EST_NV; ++v) {
            print((double)e.value[v]);
            print((double)e.std[v]);
        }
        for (int j = 0; j < EST_NY; ++j) print((double)e.innovation[j]);
        print((double)e.nis);
        print((double)e.log_likelihood);
        printf("\n");
    }
    return 0;
}

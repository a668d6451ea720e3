// How late this machine wakes a thread that asked to sleep for a millisecond.
//
// wakeup COUNT FILE writes COUNT latenesses in microseconds, a line each.

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

int main(int count, char **arguments) {
    if (count != 3) {
        fprintf(stderr, "usage: %s COUNT FILE\n", arguments[0]);
        return 2;
    }
    FILE *out = fopen(arguments[2], "w");
    if (!out) {
        perror(arguments[2]);
        return 1;
    }
    struct timespec due, now;
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (long left = strtol(arguments[1], NULL, 10); left > 0; left--) {
        due.tv_nsec += 1000000;
        if (due.tv_nsec >= 1000000000) {
            due.tv_nsec -= 1000000000;
            due.tv_sec++;
        }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        clock_gettime(CLOCK_MONOTONIC, &now);
        fprintf(out, "%.3f\n", (now.tv_sec - due.tv_sec) * 1e6 + (now.tv_nsec - due.tv_nsec) / 1e3);
    }
    return fclose(out) ? 1 : 0;
}

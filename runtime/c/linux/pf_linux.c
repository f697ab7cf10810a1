/*
 * The controller as a Linux program. A frame on standard input, as for pf_flight_linux.c; records
 * go to the file that is named, and one line of JSON to standard output at the end.
 *
 *     pf_linux LOG [free] [every=N] [watchdog=MS] [stall=PERIOD:MS]
 *
 * Ends with 0; 2 where the frame is refused or an argument unknown; 3 where rig or log failed; 4
 * where the watchdog had to turn the motors off.
 */
#define _GNU_SOURCE
#include "pf_loop.h"

#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static pf_frame_t frame;

static void on_signal(int number)
{
    (void)number;
    pf_loop_stop();
}

static int take_option(const char *word, pf_loop_options_t *options)
{
    unsigned a = 0U, b = 0U;
    char rest;

    if (strcmp(word, "free") == 0) {
        options->free_running = 1;
    } else if (sscanf(word, "every=%u%c", &a, &rest) == 1 && a > 0U) {
        options->log_every = a;
    } else if (sscanf(word, "watchdog=%u%c", &a, &rest) == 1) {
        options->watchdog_ms = a;
    } else if (sscanf(word, "stall=%u:%u%c", &a, &b, &rest) == 2) {
        options->stall_period = a;
        options->stall_ms = b;
    } else {
        return 0;
    }
    return 1;
}

static void print_report(const pf_loop_report_t *r, uint32_t fault)
{
    printf("{\"fault\": %u, \"periods\": %u, \"overruns\": %u, \"missed\": %u, \"dropped\": %u, "
           "\"refused\": %u, \"watchdog_trips\": %u, \"late_ns\": %lld, \"busy_ns\": %lld, "
           "\"locked\": %d, \"fifo\": %d, \"error\": %d, \"grown_kib\": %ld}\n",
        (unsigned)fault, (unsigned)r->periods, (unsigned)r->overruns, (unsigned)r->missed,
        (unsigned)r->dropped, (unsigned)r->refused, (unsigned)r->watchdog_trips,
        (long long)r->late_ns, (long long)r->busy_ns, r->locked, r->fifo, r->error, r->grown_kib);
}

int main(int count, char **words)
{
    pf_loop_options_t options = {&frame, 0, 1U, 100U, 0U, 0U, -1};
    pf_loop_report_t report;
    struct sigaction action;
    uint32_t fault = PF_FAULT_LENGTH;
    int k;

    memset(&report, 0, sizeof report);
    for (k = 2; k < count; ++k) {
        if (take_option(words[k], &options) == 0) {
            fprintf(stderr, "unknown: %s\n", words[k]);
            return 2;
        }
    }
    if (count < 2) {
        fprintf(stderr, "give a file for the records\n");
        return 2;
    }
    if (fread(&frame, 1U, sizeof frame, stdin) == sizeof frame) {
        fault = pf_flight_check(&frame, UINT32_MAX);
    }
    if (fault != 0U) {
        print_report(&report, fault);
        return 2;
    }
    options.log = open(words[1], O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (options.log < 0) {
        perror(words[1]);
        return 3;
    }
    memset(&action, 0, sizeof action);
    action.sa_handler = on_signal;
    (void)sigaction(SIGINT, &action, NULL);
    (void)sigaction(SIGTERM, &action, NULL);
    (void)pf_loop_run(&options, &report);
    if (close(options.log) != 0 && report.error == 0) {
        report.error = 5; /* EIO: what was written may not be there */
    }
    print_report(&report, fault);
    return (report.error != 0) ? 3 : ((report.watchdog_trips != 0U) ? 4 : 0);
}

/*
 * The periodic loop under Linux: on absolute time, with locked memory, and as SCHED_FIFO where that
 * is allowed. Three threads: the loop, a logger that empties the ring, and a watchdog that turns
 * the motors off when the loop has stood still for too long.
 */
#ifndef PF_LOOP_H
#define PF_LOOP_H

#include "pf_rig.h"
#include "pf_ring.h"

#include <stdint.h>

typedef struct {
    const pf_frame_t *frame;
    int free_running;       /* as fast as it goes: nothing waits for the clock, no record is lost */
    uint32_t log_every;     /* one record of so many is logged; 1 for all */
    uint32_t watchdog_ms;   /* standing still for so long trips it; 0 for no watchdog */
    uint32_t stall_period;  /* a fault for tests: in this period, sleep ... */
    uint32_t stall_ms;      /* ... for so long; 0 for none */
    int log;                /* a file descriptor for the records */
} pf_loop_options_t;

typedef struct {
    uint32_t periods;
    uint32_t overruns;       /* periods that ended after the next one was due */
    uint32_t missed;         /* periods left out, because their time had passed */
    uint32_t dropped;        /* records that the ring had no room for */
    uint32_t refused;        /* periods in which the step refused */
    uint32_t watchdog_trips;
    int64_t late_ns;         /* the latest start */
    int64_t busy_ns;         /* the longest period, from its start to its end */
    int locked, fifo;        /* whether memory is locked and the scheduler is SCHED_FIFO */
    int error;               /* errno of the rig or the log, or 0 */
    long grown_kib;          /* of resident memory, from period 1000 to the end */
} pf_loop_report_t;

/* Asks a loop that runs to end after its period; may be called from a signal handler. */
void pf_loop_stop(void);

/* Flies; the motors are off when it returns. Returns 0, or what stopped it: see report->error. */
int pf_loop_run(const pf_loop_options_t *options, pf_loop_report_t *report);

#endif

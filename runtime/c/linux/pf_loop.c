/* The periodic loop under Linux: see pf_loop.h. */
#define _GNU_SOURCE
#include "pf_loop.h"

#include <errno.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#define SECOND INT64_C(1000000000)
#define PRIORITY 80
#define STACK_TOUCHED 65536

typedef struct {
    const pf_loop_options_t *options;
    pf_rig_t *rig;
    pf_ring_t *ring;
    uint32_t beats;   /* of the loop; read by the watchdog */
    int over;         /* the loop has ended */
    uint32_t trips;
    int log_error;
} shared_t;

static pf_ring_t ring;
static volatile sig_atomic_t stopped;

void pf_loop_stop(void)
{
    stopped = 1;
}

static int64_t now_ns(void)
{
    struct timespec t;

    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * SECOND + (int64_t)t.tv_nsec;
}

static void sleep_until(int64_t when)
{
    struct timespec t;

    t.tv_sec = (time_t)(when / SECOND);
    t.tv_nsec = (long)(when % SECOND);
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR && stopped == 0) {
    }
}

static void sleep_ms(uint32_t ms)
{
    sleep_until(now_ns() + (int64_t)ms * 1000000);
}

static long resident_kib(void)
{
    struct rusage usage;

    (void)getrusage(RUSAGE_SELF, &usage);
    return usage.ru_maxrss;
}

static void touch_stack(void)
{
    volatile unsigned char page[STACK_TOUCHED];
    size_t k;

    for (k = 0; k < sizeof page; k += 1024U) {
        page[k] = 0U;
    }
}

static int write_whole(int file, const pf_record_t *record)
{
    const char *at = (const char *)record;
    size_t left = sizeof *record;

    while (left > 0U) {
        const ssize_t done = write(file, at, left);

        if (done < 0 && errno != EINTR) {
            return errno;
        }
        if (done > 0) {
            at += done;
            left -= (size_t)done;
        }
    }
    return 0;
}

/* Empties the ring until the loop is over and nothing is left. */
static void *logger(void *argument)
{
    shared_t *shared = argument;
    pf_record_t record;

    memset(&record, 0, sizeof record);
    for (;;) {
        const int last = __atomic_load_n(&shared->over, __ATOMIC_ACQUIRE);

        while (pf_ring_take(shared->ring, &record) != 0) {
            if (shared->log_error == 0) {
                shared->log_error = write_whole(shared->options->log, &record);
            }
        }
        if (last != 0) {
            return NULL;
        }
        sleep_ms(1U);
    }
}

/* Turns the motors off, once and for all, when the loop's beat stands still. */
static void *watchdog(void *argument)
{
    shared_t *shared = argument;
    uint32_t seen = __atomic_load_n(&shared->beats, __ATOMIC_ACQUIRE);
    int64_t since = now_ns();

    while (__atomic_load_n(&shared->over, __ATOMIC_ACQUIRE) == 0) {
        const uint32_t beats = __atomic_load_n(&shared->beats, __ATOMIC_ACQUIRE);

        if (beats != seen) {
            seen = beats;
            since = now_ns();
        } else if (now_ns() - since > (int64_t)shared->options->watchdog_ms * 1000000) {
            (void)pf_rig_enable(shared->rig, 0);
            __atomic_store_n(&shared->trips, 1U, __ATOMIC_RELEASE);
            return NULL;
        }
        sleep_ms(1U);
    }
    return NULL;
}

/* One period: measure, control, command, log. */
static int one_period(shared_t *shared, PF_STATE_T *state, uint32_t k, pf_loop_report_t *report)
{
    static pf_record_t record; /* static: what lies between the members stays zero */
    const pf_loop_options_t *options = shared->options;
    int error = pf_rig_read(shared->rig, k, &record.input);

    if (error != 0) {
        return error;
    }
    record.status = (int32_t)PF_STEP(state, &options->frame->params, &record.input, &record.output);
    error = pf_rig_write(shared->rig, &record.output);
    report->refused += (record.status >= 3) ? 1U : 0U;
    record.state = *state;
    if (k % options->log_every == 0U) {
        while (pf_ring_put(shared->ring, &record) == 0) {
            if (options->free_running == 0) { /* the loop does not wait for a disk */
                ++report->dropped;
                break;
            }
            (void)sched_yield();
        }
    }
    return (error != 0) ? error : pf_rig_kick(shared->rig);
}

static void fly(shared_t *shared, pf_loop_report_t *report)
{
    const pf_loop_options_t *options = shared->options;
    const int64_t period = (int64_t)(options->frame->sample_time * 1e9 + 0.5);
    int64_t due = now_ns() + period;
    long before = 0;
    PF_STATE_T state;
    uint32_t k;

    (void)PF_INIT(&state, &options->frame->params); /* the first step says what is wrong */
    for (k = 0U; k < options->frame->steps && stopped == 0 && report->error == 0; ++k) {
        int64_t begun, ended;

        if (options->free_running == 0) {
            sleep_until(due);
        }
        begun = now_ns();
        report->error = one_period(shared, &state, k, report);
        if (options->stall_ms != 0U && k == options->stall_period) {
            sleep_ms(options->stall_ms);
        }
        __atomic_add_fetch(&shared->beats, 1U, __ATOMIC_RELEASE);
        ended = now_ns();
        ++report->periods;
        report->busy_ns = (ended - begun > report->busy_ns) ? ended - begun : report->busy_ns;
        before = (k == 1000U) ? resident_kib() : before;
        if (options->free_running == 0) {
            report->late_ns = (begun - due > report->late_ns) ? begun - due : report->late_ns;
            due += period;
            report->overruns += (ended > due) ? 1U : 0U;
            while (ended > due + period) {
                due += period;
                ++report->missed;
            }
        }
        if (__atomic_load_n(&shared->trips, __ATOMIC_ACQUIRE) != 0U) {
            break; /* the motors are off: there is nothing left to control */
        }
    }
    report->grown_kib = (before != 0) ? resident_kib() - before : 0;
}

int pf_loop_run(const pf_loop_options_t *options, pf_loop_report_t *report)
{
    shared_t shared;
    pthread_t threads[2];
    struct sched_param real_time;
    uint32_t started = 0U;

    memset(report, 0, sizeof *report);
    memset(&shared, 0, sizeof shared);
    shared.options = options;
    shared.ring = &ring;
    ring.head = ring.tail = 0U;
    report->error = pf_rig_open(&shared.rig, options->frame);
    if (report->error != 0) {
        return report->error;
    }
    report->locked = (mlockall(MCL_CURRENT | MCL_FUTURE) == 0) ? 1 : 0;
    touch_stack();
    report->error = pthread_create(&threads[started], NULL, logger, &shared);
    started += (report->error == 0) ? 1U : 0U;
    if (report->error == 0 && options->watchdog_ms != 0U) {
        report->error = pthread_create(&threads[started], NULL, watchdog, &shared);
        started += (report->error == 0) ? 1U : 0U;
    }
    memset(&real_time, 0, sizeof real_time);
    real_time.sched_priority = PRIORITY; /* of this thread alone: the others started before */
    if (options->free_running == 0) {
        const int refused = pthread_setschedparam(pthread_self(), SCHED_FIFO, &real_time);

        report->fifo = (refused == 0) ? 1 : 0;
    }
    if (report->error == 0) {
        report->error = pf_rig_enable(shared.rig, 1);
        fly(&shared, report);
    }
    (void)pf_rig_enable(shared.rig, 0);
    __atomic_store_n(&shared.over, 1, __ATOMIC_RELEASE);
    while (started > 0U) {
        (void)pthread_join(threads[--started], NULL);
    }
    pf_rig_close(shared.rig);
    report->watchdog_trips = shared.trips;
    report->error = (report->error != 0) ? report->error : shared.log_error;
    return report->error;
}

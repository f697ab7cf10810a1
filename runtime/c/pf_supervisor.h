/*
 * Supervision: the mode of a controller, its faults, and what it may command.
 *
 * It knows no model. Once a period it is told how far the plant is from where the balance law can
 * hold it (the measures), what was found wrong (the checks), what the operator wants and how long
 * the period was; it answers with the mode and whether a torque is allowed. A fault is latched in
 * the period in which it is found, and leaves only by PF_COMMAND_RESET once its cause is gone.
 *
 * Freestanding C99: no heap, no globals, no library. Whatever bits come in, the mode and the fault
 * that come out are valid, and a torque is allowed in SWING_UP and BALANCE only.
 */
#ifndef PF_SUPERVISOR_H
#define PF_SUPERVISOR_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define PF_MEASURES 8U /* measures a supervisor can look at */
#define PF_LOG_LENGTH 16U /* transitions that are remembered */
#define PF_FARTHEST 1e300 /* no limit is above it */
#define PF_FAR 1e301 /* a measure beyond every limit */

typedef enum {
    PF_MODE_IDLE = 0, /* no torque; waits for PF_COMMAND_START */
    PF_MODE_SWING_UP = 1, /* on the way to where the balance law can hold the plant */
    PF_MODE_BALANCE = 2,
    PF_MODE_FAULT = 3 /* no torque; waits for PF_COMMAND_RESET */
} pf_mode_t;

typedef enum {
    PF_COMMAND_NONE = 0,
    PF_COMMAND_START = 1, /* leave IDLE */
    PF_COMMAND_STOP = 2, /* to IDLE, from every mode but FAULT */
    PF_COMMAND_RESET = 3, /* from FAULT to IDLE, if nothing is wrong any more */
    PF_COMMAND_REZERO = 4 /* the plant rests at its known place; the caller obeys, no mode changes */
} pf_command_t;

typedef enum {
    PF_FAULT_NONE = 0,
    PF_FAULT_STATE_CORRUPT = 1, /* the supervisor's own memory contradicts itself */
    PF_FAULT_PARAMETER_CHECKSUM = 2, /* the parameters are not those that were sealed */
    PF_FAULT_PARAMETER_BOUNDS = 3, /* a parameter is out of its bounds */
    PF_FAULT_NOT_FINITE = 4, /* a reading is no number */
    PF_FAULT_RANGE = 5, /* a reading is out of its domain */
    PF_FAULT_ENCODER_JUMP = 6, /* an encoder turned faster than the shaft can */
    PF_FAULT_STALE = 7, /* no new readings */
    PF_FAULT_OVERRUN = 8, /* periods too long or too short */
    PF_FAULT_WATCHDOG = 9, /* the heartbeat stopped */
    PF_FAULT_NUMERIC = 10, /* a law gave no usable result */
    PF_FAULT_SWING_UP_TIMEOUT = 11, /* no capture within swing_up_timeout */
    PF_FAULT_ATTEMPTS = 12, /* released more often than attempts allows */
    PF_FAULT_INTERFACE = 13, /* an unknown check, no measure, or more than PF_MEASURES */
    PF_FAULT_ARITHMETIC = 14, /* build or processor do not compute as IEEE 754 demands */
    PF_FAULT_PARAMETER_FIXED = 15 /* a parameter that may only change at rest changed while running */
} pf_fault_t;

/* What the caller found wrong this period: bits of `checks`. Of several findings of one period the
 * first in this order is the fault, then an unknown bit, then what the supervisor finds itself. */
#define PF_CHECK_PARAMETER_CHECKSUM 0x01U
#define PF_CHECK_PARAMETER_BOUNDS 0x02U
#define PF_CHECK_NOT_FINITE 0x04U
#define PF_CHECK_RANGE 0x08U
#define PF_CHECK_ENCODER_JUMP 0x10U
#define PF_CHECK_STALE 0x20U
#define PF_CHECK_NUMERIC 0x40U
#define PF_CHECK_ARITHMETIC 0x80U
#define PF_CHECK_PARAMETER_FIXED 0x100U

/* What the caller knows of the plant's position, or was ordered to do with it: bits of `position`. */
#define PF_POSITION_UNREAD 0x1U /* an encoder has given no reading yet: START is refused */
#define PF_POSITION_REZEROED 0x2U /* PF_COMMAND_REZERO was obeyed in this period */
#define PF_POSITION_REFUSED 0x4U /* it was refused */
#define PF_POSITION_LOST 0x8U /* an encoder jumped or fell silent: known again by init or REZERO */

/* Why the mode changed last, or did not when an order was given. */
typedef enum {
    PF_REASON_NONE = 0,
    PF_REASON_STARTED = 1,
    PF_REASON_STOPPED = 2,
    PF_REASON_CAPTURED = 3,
    PF_REASON_RELEASED = 4,
    PF_REASON_FAULT = 5,
    PF_REASON_RESET = 6,
    PF_REASON_NO_READING = 7, /* no change: START was refused, an encoder has given no reading yet */
    PF_REASON_REZEROED = 8, /* no change: the position is that of the known place */
    PF_REASON_REZERO_REFUSED = 9 /* no change: running, or not at rest, or without a known place */
} pf_reason_t;

typedef enum {
    PF_SUPERVISOR_OK = 0,
    PF_SUPERVISOR_BAD_PARAMETER = 1, /* every period then is a fault */
    PF_SUPERVISOR_BAD_ARITHMETIC = 2 /* likewise: operations do not give the bits of IEEE 754 */
} pf_supervisor_status_t;

typedef struct {
    double capture_limit[PF_MEASURES]; /* captured where no measure is above its own; from 0 */
    double release_limit[PF_MEASURES]; /* released where one is above its own; from the former, to
                                        * PF_FARTHEST */
    double sample_time; /* period T [s]; 1e-6 to 1 */
    double shortest_period; /* a period below this share of T is an overrun; 0 to 1 */
    double longest_period; /* a period above this share of T is one; 1 to 1000 */
    double watchdog_time; /* the heartbeat may stand still for so long [s]; 0: for ever */
    double swing_up_timeout; /* [s]; 0: none */
    uint32_t capture_periods; /* in a row inside until captured; from 1 */
    uint32_t release_periods; /* in a row outside until released; from 1 */
    uint32_t overruns; /* that are forgiven; one is forgotten each 1000 good periods in a row, all
                        * are at RESET */
    uint32_t attempts; /* releases that are forgiven between START and STOP; 0: all */
} pf_supervisor_params_t;

typedef struct {
    double measure[PF_MEASURES]; /* from 0; what is negative or no number is outside */
    double elapsed; /* since the last call [s], as the platform measured it */
    uint32_t measures; /* how many are in use; 1 to PF_MEASURES */
    uint32_t frame; /* another one with each new set of readings */
    uint32_t heartbeat; /* another one while the operator's side is alive */
    uint32_t command; /* one of pf_command_t; what is none is PF_COMMAND_NONE */
    uint32_t checks; /* PF_CHECK_... bits */
    uint32_t position; /* PF_POSITION_... bits */
} pf_supervisor_input_t;

/* One transition, or one order that changed no mode: then `from` and `to` are the same. */
typedef struct {
    uint32_t period; /* number of the call, from 1 */
    uint32_t frame;
    uint32_t from, to; /* pf_mode_t */
    uint32_t reason; /* pf_reason_t */
    uint32_t fault; /* pf_fault_t */
} pf_transition_t;

/* Memory. What decides is kept with its complement, and all but the log under a checksum: a change
 * of any one word between two calls is seen. */
typedef struct {
    pf_transition_t log[PF_LOG_LENGTH]; /* transition number k is entry k modulo the length */
    uint32_t logged; /* transitions so far; written after the entry */
    uint32_t mode, mode_inverse;
    uint32_t fault, fault_inverse;
    uint32_t ready, ready_inverse; /* 1 where init found the parameters good */
    uint32_t period; /* calls so far */
    uint32_t since; /* calls since the mode began */
    uint32_t inside, outside; /* periods in a row */
    uint32_t frame, heartbeat; /* last seen */
    uint32_t silent; /* periods since the heartbeat last changed */
    uint32_t overruns; /* not yet forgiven */
    uint32_t good; /* periods in a row without overrun */
    uint32_t releases; /* since START */
    uint32_t reason; /* of the last transition */
    uint32_t started; /* 1 after the first call */
    uint32_t seal; /* checksum of the members from `logged` on but the complements */
} pf_supervisor_state_t;

typedef struct {
    uint32_t mode; /* pf_mode_t */
    uint32_t fault; /* pf_fault_t, none unless in FAULT */
    uint32_t reason; /* pf_reason_t of the last transition */
    uint32_t entered; /* 1 where this call changed the mode: laws start afresh */
    uint32_t torque_allowed; /* 1 in SWING_UP and BALANCE */
} pf_supervisor_output_t;

/* Prepares *state: mode IDLE, or FAULT if a parameter is out of its bounds or the arithmetic is not
 * that of IEEE 754, see pf_arithmetic.h. From that FAULT, and from STATE_CORRUPT, only another call
 * of this function leads. */
pf_supervisor_status_t pf_supervisor_init(pf_supervisor_state_t *state,
    const pf_supervisor_params_t *params);

/* One period: decides the mode. */
void pf_supervisor_step(pf_supervisor_state_t *state, const pf_supervisor_params_t *params,
    const pf_supervisor_input_t *input, pf_supervisor_output_t *output);

/* A fault found after the step, by the law itself: in force in this same period. In FAULT already
 * the first one stays; what is none of pf_fault_t counts as PF_FAULT_NUMERIC. */
void pf_supervisor_trip(pf_supervisor_state_t *state, pf_fault_t fault,
    pf_supervisor_output_t *output);

/* The mode now; FAULT if the memory contradicts itself. */
pf_mode_t pf_supervisor_mode(const pf_supervisor_state_t *state);

/* Copies transition `number`, from 0, and returns 1; returns 0 where it is not there yet, or no
 * longer: the last PF_LOG_LENGTH - 1 are, but those before the count wrapped. An interrupt or a thread on the same core may call it
 * while the supervisor runs; between cores the caller orders memory. */
uint32_t pf_supervisor_log_read(const pf_supervisor_state_t *state, uint32_t number,
    pf_transition_t *transition);

/* Checksum of a parameter block, word by word, from PF_CHECKSUM_SEED on. Every change of one word
 * changes the result, for each operation on the sum can be undone; of changes of several words
 * about one in 2^32 does not. */
#define PF_CHECKSUM_SEED 2166136261U
uint32_t pf_checksum_word(uint32_t sum, uint32_t word);
uint32_t pf_checksum_double(uint32_t sum, double value); /* the high word first */

/* `value` within +-limit; 0 for what is no number, or a limit that is none or infinite. What is no
 * number is told by its bits, so that no compiler can leave the question out. */
double pf_limited(double value, double limit);

/* The same, and within `step` of `previous` where that is possible. */
double pf_slewed(double value, double previous, double step, double limit);

/* `angle` less whole turns, nearest to `reference` [rad]; `angle` itself where the turns between
 * them are more than 1e9 or no number. With M the larger size of the two, the result is within
 * 2^-51 (M + 2) of what exact turns give, and within pi + 2^-49 (M + 1) of `reference`. */
double pf_nearest_turn(double angle, double reference);

#ifdef __cplusplus
}
#endif

#endif

/*
 * Sensing: from the raw value of an incremental encoder's counter to angle and velocity.
 *
 * One channel is one encoder. The counter may have wrapped between two periods in either direction;
 * the count behind it does not wrap. Two velocity estimators share one recurrence, explained in
 * pf_sensing.c: a tracking loop (second order) and a filtered difference (first order). Both are
 * discretised by the trapezoidal rule, so that they are stable at every bandwidth, and both are
 * without error at constant velocity.
 *
 * Freestanding C99: no heap, no globals, no library. Compile with -ffp-contract=off for the same
 * bits on every machine. Every output is finite, whatever the input.
 */
#ifndef PF_SENSING_H
#define PF_SENSING_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    PF_SENSING_OK = 0, /* the reading was taken */
    PF_SENSING_MISSING = 1, /* no valid reading this period; all outputs hold */
    PF_SENSING_JUMP = 2, /* the reading lies too far from the last one taken; all outputs hold */
    PF_SENSING_STALE = 3, /* none taken for more than longest_gap periods; until init or rezero */
    PF_SENSING_BAD_PARAMETER = 4, /* a parameter is out of its bounds; outputs are 0 */
    PF_SENSING_LOST = 5, /* the counter stayed where it jumped to; outputs hold until init or rezero */
    PF_SENSING_BAD_ARITHMETIC = 6, /* of init alone: operations do not give the bits of IEEE 754 */
    PF_SENSING_NOT_STANDING = 7 /* of rezero alone: the reading did not rest for long enough */
} pf_sensing_status_t;

typedef enum {
    PF_SENSING_TRACKING = 0, /* tracking loop */
    PF_SENSING_DIFFERENCE = 1 /* difference quotient behind a first-order low pass */
} pf_sensing_estimator_t;

/* What a channel is. */
typedef struct {
    double counts_per_turn; /* counts a turn, four times the pulses in quadrature; 4 to 2^32 */
    double offset; /* angle at count 0 [rad], the middle of that count for no bias; |.| <= 1000 */
    double sample_time; /* period T of the calls [s]; 1e-6 to 1 */
    double bandwidth; /* w of the estimator [rad/s]; w T from 1e-4 to 1 */
    double damping; /* of the tracking loop; 0.5 to 2, whichever estimator is chosen */
    uint32_t estimator; /* one of pf_sensing_estimator_t */
    uint32_t counter_bits; /* width of the counter [bit]; 8 to 32 */
    uint32_t counter_zero; /* raw value at count 0; below 2^counter_bits */
    uint32_t largest_jump; /* counts that the shaft may turn in one period; from 1 */
    uint32_t longest_gap; /* periods without a reading that are bridged; to 64, and
        largest_jump (longest_gap + 1) below both 2^(counter_bits - 1) and 2^24 */
    int32_t direction; /* of the angle while the counter rises: 1 or -1 */
} pf_sensing_params_t;

/* What is read at the start of a period. */
typedef struct {
    uint32_t raw; /* the counter; bits above its width are ignored */
    uint32_t valid; /* 0 if there was no reading */
} pf_sensing_input_t;

/* What a channel remembers; filled by pf_sensing_init, advanced by pf_sensing_step. */
typedef struct {
    double error; /* angle less its estimate, after the correction [rad]; 0 for the difference */
    double velocity; /* estimate [rad/s] */
    double radians_per_count; /* with the sign of the direction [rad] */
    double offset; /* angle at count 0 [rad] */
    double sample_time; /* T [s] */
    double error_kept; /* share of the prediction error that the correction leaves */
    double velocity_gain; /* velocity a prediction error [1/s] */
    int64_t count; /* of the last reading taken, unwrapped */
    uint32_t raw; /* last reading taken */
    uint32_t mask; /* 2^counter_bits - 1 */
    uint32_t counter_zero; /* raw value at count 0 */
    uint32_t largest_jump; /* counts a period */
    uint32_t longest_gap; /* periods */
    uint32_t missed; /* periods since the last reading taken, at most longest_gap + 1 */
    uint32_t seen; /* last valid reading, taken or not */
    uint32_t jumped; /* 1 while that one was not taken, in the period before */
    uint32_t lost; /* 1 once it is known that the counter has jumped */
    uint32_t rest; /* reading that those since lie within a count of */
    uint32_t resting; /* how many in a row do, every period having had one */
    uint32_t ready; /* 1 once the parameters were found good */
    uint32_t started; /* 1 once a reading was taken */
} pf_sensing_state_t;

typedef struct {
    double angle; /* offset and count, the offset alone before the first reading [rad] */
    double velocity; /* [rad/s] */
    int64_t count; /* unwrapped, of either sign; 0 at counter_zero */
} pf_sensing_output_t;

/*
 * Prepares *state for the first period. Returns PF_SENSING_BAD_PARAMETER, with the state set to
 * zero, if a parameter is not finite or out of its bounds, PF_SENSING_BAD_ARITHMETIC likewise, see
 * pf_arithmetic.h; else PF_SENSING_OK.
 */
pf_sensing_status_t pf_sensing_init(pf_sensing_state_t *state, const pf_sensing_params_t *params);

/*
 * Takes other parameters and keeps count, velocity and gap: from the next period on they are in
 * force. Where the angle of a count changed, the velocity starts at zero again. Returns as
 * pf_sensing_init; a channel that is not ready, or parameters that are out of bounds, leave *state
 * as it is.
 */
pf_sensing_status_t pf_sensing_retune(pf_sensing_state_t *state,
    const pf_sensing_params_t *params);

/*
 * Says that the shaft stands at `angle` [rad] now, to half a count: the only way but
 * pf_sensing_init out of PF_SENSING_STALE and PF_SENSING_LOST. The last `periods` readings, 1 at
 * least, must have been valid and within one count; the last one is counted from. Returns
 * PF_SENSING_NOT_STANDING if they were not, PF_SENSING_BAD_PARAMETER if the channel is not ready or
 * the angle beyond 1000 rad; both leave *state as it is.
 */
pf_sensing_status_t pf_sensing_rezero(pf_sensing_state_t *state, double angle, uint32_t periods);

/* 1 where pf_sensing_rezero would take this angle now. */
int pf_sensing_may_rezero(const pf_sensing_state_t *state, double angle, uint32_t periods);

/*
 * Takes the reading of one period. The first one taken sets the count to the value nearest zero,
 * and the velocity starts at zero. After a gap of n periods the shaft may have turned by
 * (n + 1) largest_jump, and is taken to have turned evenly: at most longest_gap + 1 turns of a
 * loop. A reading further away is PF_SENSING_JUMP, and the next period decides what it was: a
 * glitch if it has a reading that is near the last one taken and not near the one that jumped; if
 * that one is near, within largest_jump, or missing, the counter has jumped and the position is
 * lost. A third reading that is near neither jumped again.
 */
pf_sensing_status_t pf_sensing_step(pf_sensing_state_t *state, const pf_sensing_input_t *input,
    pf_sensing_output_t *output);

#ifdef __cplusplus
}
#endif

#endif

/*
 * Sensing; see pf_sensing.h.
 *
 * Both estimators predict the angle by the velocity, and correct with the prediction error r:
 *
 *     r = change + error - T velocity,    error <- error_kept r,    velocity <- velocity + gain r,
 *
 * `change` being what the angle changed by, and `error` the angle less its estimate. Only changes
 * enter: no digits are lost however many turns were made. With a = w T/2 and
 * D = 1 + 2 damping a + a^2, the tracking loop has
 *
 *     error_kept = (1 - 2 damping a + a^2)/D,    gain = 4 a^2/(D T),
 *
 * which puts its poles where the trapezoidal rule z = (1 + s T/2)/(1 - s T/2) takes the zeros of
 * s^2 + 2 damping w s + w^2: inside the unit circle for every w T > 0. The filtered difference has
 *
 *     error_kept = 0,    gain = 2 a/((1 + a) T),
 *
 * its pole being where the rule takes -w. At constant velocity change = T velocity holds r at zero.
 */
#include "pf_sensing.h"

#include "pf_arithmetic.h"

#define TWO_PI 6.283185307179586
#define TWO_TO_32 4294967296.0
#define LONGEST_GAP 64U
#define LARGEST_REACH 0xffffffU /* counts a period: 2^62 of them take 8 years at 1 kHz */
#define LARGEST_COUNT (INT64_C(1) << 62)
#define LARGEST_SHOWN 9007199254740992.0 /* 2^53 */

static int lies_within(double value, double least, double most)
{
    return (value >= least) && (value <= most); /* no NaN does */
}

static uint32_t mask_of(uint32_t bits)
{
    return 0xffffffffU >> (32U - bits);
}

static int counter_is_sound(const pf_sensing_params_t *params)
{
    uint32_t half, reach;

    if ((params->counter_bits < 8U) || (params->counter_bits > 32U)) {
        return 0;
    }
    half = mask_of(params->counter_bits) >> 1;
    reach = (half < LARGEST_REACH) ? half : LARGEST_REACH;
    return (params->counter_zero <= mask_of(params->counter_bits)) && (params->largest_jump >= 1U)
        && (params->longest_gap <= LONGEST_GAP)
        && (params->largest_jump <= reach / (params->longest_gap + 1U))
        && ((params->direction == 1) || (params->direction == -1));
}

static int estimator_is_sound(const pf_sensing_params_t *params)
{
    return lies_within(params->counts_per_turn, 4.0, TWO_TO_32)
        && lies_within(params->offset, -1000.0, 1000.0)
        && lies_within(params->sample_time, 1e-6, 1.0)
        && lies_within(params->bandwidth * params->sample_time, 1e-4, 1.0)
        && lies_within(params->damping, 0.5, 2.0)
        && ((params->estimator == (uint32_t)PF_SENSING_TRACKING)
            || (params->estimator == (uint32_t)PF_SENSING_DIFFERENCE));
}

/* Member by member: a whole structure would be cleared by a library's memset. */
static void clear(pf_sensing_state_t *state)
{
    state->error = 0.0;
    state->velocity = 0.0;
    state->radians_per_count = 0.0;
    state->offset = 0.0;
    state->sample_time = 0.0;
    state->error_kept = 0.0;
    state->velocity_gain = 0.0;
    state->count = 0;
    state->raw = 0U;
    state->mask = 0U;
    state->counter_zero = 0U;
    state->largest_jump = 0U;
    state->longest_gap = 0U;
    state->missed = 0U;
    state->seen = 0U;
    state->jumped = 0U;
    state->lost = 0U;
    state->rest = 0U;
    state->resting = 0U;
    state->ready = 0U;
    state->started = 0U;
}

/* Fill what depends on the parameters alone; they were found sound. */
static void prepare(pf_sensing_state_t *state, const pf_sensing_params_t *params)
{
    double a, resistance, denominator;

    a = 0.5 * (params->bandwidth * params->sample_time);
    if (params->estimator == (uint32_t)PF_SENSING_TRACKING) {
        resistance = 2.0 * params->damping * a;
        denominator = 1.0 + resistance + a * a;
        state->error_kept = (1.0 - resistance + a * a) / denominator;
        state->velocity_gain = 4.0 * a * a / (denominator * params->sample_time);
    } else {
        state->error_kept = 0.0;
        state->velocity_gain = 2.0 * a / ((1.0 + a) * params->sample_time);
    }
    state->radians_per_count = (double)params->direction * TWO_PI / params->counts_per_turn;
    state->offset = params->offset;
    state->sample_time = params->sample_time;
    state->mask = mask_of(params->counter_bits);
    state->counter_zero = params->counter_zero;
    state->largest_jump = params->largest_jump;
    state->longest_gap = params->longest_gap;
}

pf_sensing_status_t pf_sensing_init(pf_sensing_state_t *state, const pf_sensing_params_t *params)
{
    clear(state);
    if (pf_arithmetic_holds() == 0) {
        return PF_SENSING_BAD_ARITHMETIC;
    }
    if (!counter_is_sound(params) || !estimator_is_sound(params)) {
        return PF_SENSING_BAD_PARAMETER;
    }
    prepare(state, params);
    state->ready = 1U;
    return PF_SENSING_OK;
}

pf_sensing_status_t pf_sensing_retune(pf_sensing_state_t *state,
    const pf_sensing_params_t *params)
{
    const double before = state->radians_per_count;

    if ((state->ready != 1U) || !counter_is_sound(params) || !estimator_is_sound(params)) {
        return PF_SENSING_BAD_PARAMETER;
    }
    prepare(state, params);
    if (!lies_within(state->radians_per_count, before, before)) {
        state->error = 0.0;
        state->velocity = 0.0;
    }
    return PF_SENSING_OK;
}

/* The way from one reading to another, the shorter one round the counter [counts]. */
static int64_t turned(uint32_t from, uint32_t to, uint32_t mask)
{
    const uint32_t up = (to - from) & mask;

    return (up <= (mask >> 1)) ? (int64_t)up : -(int64_t)((from - to) & mask);
}

/* The 750 has no conversion of 64 bits: the compiler would call a library. */
static double double_of(int64_t count)
{
    const uint64_t size = (count < 0) ? UINT64_C(0) - (uint64_t)count : (uint64_t)count;
    const double value = (double)(uint32_t)(size >> 32) * TWO_TO_32 + (double)(uint32_t)size;

    return (count < 0) ? -value : value;
}

/* The whole part of what is from 0 to LARGEST_SHOWN + 1, bit by bit: a conversion would be called. */
static int64_t whole_of(double size)
{
    double rest = size;
    double bit = LARGEST_SHOWN;
    uint64_t whole = 0U;
    uint32_t i;

    for (i = 0U; i < 54U; ++i) {
        whole <<= 1;
        if (rest >= bit) {
            rest -= bit;
            whole |= 1U;
        }
        bit *= 0.5;
    }
    return (int64_t)(whole & UINT64_C(0x3fffffffffffff));
}

/* Lets the estimator see a change of the angle [rad] that was spread evenly over some periods. */
static void advance(pf_sensing_state_t *state, double change, uint32_t periods)
{
    const double share = change / (double)periods;
    uint32_t i;

    for (i = 0U; i < periods; ++i) {
        const double error = share + state->error - state->sample_time * state->velocity;

        state->error = state->error_kept * error;
        state->velocity += state->velocity_gain * error;
    }
}

static int is_near(uint32_t from, uint32_t to, uint32_t mask, int64_t reach)
{
    const int64_t way = turned(from, to, mask);

    return (way <= reach) && (way >= -reach);
}

/* How long the readings have been at rest; kept up also where none of them is taken. */
static void watch(pf_sensing_state_t *state, const pf_sensing_input_t *input, uint32_t raw)
{
    if (input->valid == 0U) {
        state->resting = 0U;
    } else if ((state->resting > 0U) && is_near(state->rest, raw, state->mask, 1)) {
        state->resting += (state->resting < 0xffffffffU) ? 1U : 0U;
    } else {
        state->rest = raw;
        state->resting = 1U;
    }
}

/* `before` is the valid reading of the period before, where that one jumped. */
static pf_sensing_status_t take(pf_sensing_state_t *state, uint32_t raw, uint32_t before,
    int jumped)
{
    const uint32_t periods = state->missed + 1U;
    const int64_t way = turned(state->raw, raw, state->mask);

    if (jumped && is_near(before, raw, state->mask, (int64_t)state->largest_jump)) {
        state->lost = 1U;
        return PF_SENSING_LOST;
    }
    if (!is_near(state->raw, raw, state->mask,
            (int64_t)state->largest_jump * (int64_t)periods)) {
        state->missed = periods;
        state->jumped = 1U;
        return PF_SENSING_JUMP;
    }
    advance(state, double_of(way) * state->radians_per_count, periods);
    state->count += way;
    state->raw = raw;
    state->missed = 0U;
    return PF_SENSING_OK;
}

/* Judged by constants too: a memory that was overwritten must not make the loop above long. */
static int position_is_known(const pf_sensing_state_t *state)
{
    return (state->missed <= state->longest_gap) && (state->missed <= LONGEST_GAP)
        && (state->count <= LARGEST_COUNT) && (state->count >= -LARGEST_COUNT);
}

static pf_sensing_status_t judge(pf_sensing_state_t *state, const pf_sensing_input_t *input,
    uint32_t raw, uint32_t before, int jumped)
{
    if (state->lost != 0U) {
        return PF_SENSING_LOST;
    }
    if (!position_is_known(state)) {
        return PF_SENSING_STALE;
    }
    if ((input->valid == 0U) && jumped) {
        state->lost = 1U; /* nothing shows any more that it was a glitch */
        return PF_SENSING_LOST;
    }
    if (input->valid == 0U) {
        state->missed += 1U;
        return (state->missed > state->longest_gap) ? PF_SENSING_STALE : PF_SENSING_MISSING;
    }
    if (state->started == 0U) {
        state->raw = raw;
        state->count = turned(state->counter_zero, raw, state->mask);
        state->missed = 0U;
        state->started = 1U;
        return PF_SENSING_OK;
    }
    return take(state, raw, before, jumped);
}

static pf_sensing_status_t sense(pf_sensing_state_t *state, const pf_sensing_input_t *input)
{
    const uint32_t raw = input->raw & state->mask;
    const uint32_t before = state->seen;
    const int jumped = state->jumped != 0U;

    if (state->ready != 1U) {
        return PF_SENSING_BAD_PARAMETER;
    }
    watch(state, input, raw);
    state->jumped = 0U;
    state->seen = (input->valid == 0U) ? before : raw;
    return judge(state, input, raw, before, jumped);
}

int pf_sensing_may_rezero(const pf_sensing_state_t *state, double angle, uint32_t periods)
{
    return (state->ready == 1U) && (periods >= 1U) && (state->resting >= periods)
        && lies_within(angle, -1000.0, 1000.0);
}

pf_sensing_status_t pf_sensing_rezero(pf_sensing_state_t *state, double angle, uint32_t periods)
{
    double counts, size;
    int64_t whole;

    if (!pf_sensing_may_rezero(state, angle, periods)) {
        return ((state->ready == 1U) && lies_within(angle, -1000.0, 1000.0))
            ? PF_SENSING_NOT_STANDING : PF_SENSING_BAD_PARAMETER;
    }
    counts = (angle - state->offset) / state->radians_per_count;
    size = (counts < 0.0) ? -counts : counts;
    if (!lies_within(size, 0.0, LARGEST_SHOWN)) {
        return PF_SENSING_BAD_PARAMETER; /* of a memory that was overwritten */
    }
    whole = whole_of(size + 0.5);
    state->count = (counts < 0.0) ? -whole : whole;
    state->raw = state->seen;
    state->error = 0.0;
    state->velocity = 0.0;
    state->missed = 0U;
    state->jumped = 0U;
    state->lost = 0U;
    state->started = 1U;
    return PF_SENSING_OK;
}

pf_sensing_status_t pf_sensing_step(pf_sensing_state_t *state, const pf_sensing_input_t *input,
    pf_sensing_output_t *output)
{
    const pf_sensing_status_t status = sense(state, input);

    output->angle = double_of(state->count) * state->radians_per_count + state->offset;
    output->velocity = state->velocity;
    output->count = state->count;
    return status;
}

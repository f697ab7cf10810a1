/* Supervision; see pf_supervisor.h. */
#include "pf_supervisor.h"

#include <float.h>

#include "pf_arithmetic.h"

#define PRIME 16777619U
#define TURN 6.283185307179586
#define INVERSE_TURN 0.15915494309189535
#define MOST_TURNS 1e9
#define FORGETTING 1000U /* good periods after which an overrun is forgotten */
#define LARGEST 0xffffffffU
#define INFINITE UINT64_C(0x7ff0000000000000) /* of infinity; what is no number has more */

static int lies_within(double value, double least, double most)
{
    return (value >= least) && (value <= most); /* no NaN does */
}

static uint32_t raised(uint32_t count)
{
    return (count < LARGEST) ? count + 1U : count;
}

static int parameters_are_valid(const pf_supervisor_params_t *params)
{
    uint32_t i;

    for (i = 0U; i < PF_MEASURES; ++i) {
        if (!lies_within(params->capture_limit[i], 0.0, PF_FARTHEST) ||
            !lies_within(params->release_limit[i], params->capture_limit[i], PF_FARTHEST)) {
            return 0;
        }
    }
    return lies_within(params->sample_time, 1e-6, 1.0)
        && lies_within(params->shortest_period, 0.0, 1.0)
        && lies_within(params->longest_period, 1.0, 1000.0)
        && lies_within(params->watchdog_time, 0.0, 1e6)
        && lies_within(params->swing_up_timeout, 0.0, 1e6)
        && (params->capture_periods >= 1U) && (params->release_periods >= 1U);
}

static void set_mode(pf_supervisor_state_t *state, pf_mode_t mode)
{
    state->mode = (uint32_t)mode;
    state->mode_inverse = ~(uint32_t)mode;
}

static void set_fault(pf_supervisor_state_t *state, pf_fault_t fault)
{
    state->fault = (uint32_t)fault;
    state->fault_inverse = ~(uint32_t)fault;
}

static uint32_t seal_of(const pf_supervisor_state_t *state)
{
    uint32_t sum = pf_checksum_word(PF_CHECKSUM_SEED, state->logged);

    sum = pf_checksum_word(sum, state->mode);
    sum = pf_checksum_word(sum, state->fault);
    sum = pf_checksum_word(sum, state->ready);
    sum = pf_checksum_word(sum, state->period);
    sum = pf_checksum_word(sum, state->since);
    sum = pf_checksum_word(sum, state->inside);
    sum = pf_checksum_word(sum, state->outside);
    sum = pf_checksum_word(sum, state->frame);
    sum = pf_checksum_word(sum, state->heartbeat);
    sum = pf_checksum_word(sum, state->silent);
    sum = pf_checksum_word(sum, state->overruns);
    sum = pf_checksum_word(sum, state->good);
    sum = pf_checksum_word(sum, state->releases);
    sum = pf_checksum_word(sum, state->reason);
    return pf_checksum_word(sum, state->started);
}

/* The ranges are looked at too: a seal that fits by chance is no reason for a mode that is none. */
static int is_sound(const pf_supervisor_state_t *state)
{
    const int faulty = state->fault != (uint32_t)PF_FAULT_NONE;

    return (state->mode == ~state->mode_inverse) && (state->fault == ~state->fault_inverse)
        && (state->ready == ~state->ready_inverse) && (state->ready <= 1U)
        && (state->mode <= (uint32_t)PF_MODE_FAULT)
        && (state->fault <= (uint32_t)PF_FAULT_PARAMETER_FIXED)
        && (faulty == (state->mode == (uint32_t)PF_MODE_FAULT))
        && (state->reason <= (uint32_t)PF_REASON_REZERO_REFUSED) && (state->started <= 1U)
        && (state->seal == seal_of(state));
}

pf_mode_t pf_supervisor_mode(const pf_supervisor_state_t *state)
{
    return is_sound(state) ? (pf_mode_t)state->mode : PF_MODE_FAULT;
}

/* Member by member: a whole structure would be cleared by a library's memset. */
static void clear(pf_supervisor_state_t *state)
{
    uint32_t i;

    for (i = 0U; i < PF_LOG_LENGTH; ++i) {
        state->log[i].period = 0U;
        state->log[i].frame = 0U;
        state->log[i].from = 0U;
        state->log[i].to = 0U;
        state->log[i].reason = 0U;
        state->log[i].fault = 0U;
    }
    state->logged = 0U;
    state->period = 0U;
    state->since = 0U;
    state->inside = 0U;
    state->outside = 0U;
    state->frame = 0U;
    state->heartbeat = 0U;
    state->silent = 0U;
    state->overruns = 0U;
    state->good = 0U;
    state->releases = 0U;
    state->reason = (uint32_t)PF_REASON_NONE;
    state->started = 0U;
}

static void record(pf_supervisor_state_t *state, pf_mode_t mode, pf_fault_t fault,
    pf_reason_t reason)
{
    volatile pf_transition_t *entry = &state->log[state->logged % PF_LOG_LENGTH];
    volatile uint32_t *logged = &state->logged;

    entry->period = state->period;
    entry->frame = state->frame;
    entry->from = (state->mode <= (uint32_t)PF_MODE_FAULT) ? state->mode : (uint32_t)PF_MODE_FAULT;
    entry->to = (uint32_t)mode;
    entry->reason = (uint32_t)reason;
    entry->fault = (uint32_t)fault;
    *logged = state->logged + 1U; /* a reader that sees the count sees the entry */
    state->reason = (uint32_t)reason;
}

/* What became of an order that changes no mode, once for as long as it is given. */
static void note(pf_supervisor_state_t *state, pf_reason_t reason)
{
    if (state->reason != (uint32_t)reason) {
        record(state, (pf_mode_t)state->mode, (pf_fault_t)state->fault, reason);
    }
}

static void change(pf_supervisor_state_t *state, pf_mode_t mode, pf_fault_t fault,
    pf_reason_t reason)
{
    record(state, mode, fault, reason);
    set_mode(state, mode);
    set_fault(state, fault);
    state->since = 0U;
    state->inside = 0U;
    state->outside = 0U;
}

pf_supervisor_status_t pf_supervisor_init(pf_supervisor_state_t *state,
    const pf_supervisor_params_t *params)
{
    const int exact = pf_arithmetic_holds();
    uint32_t good = 0U;

    if (exact && parameters_are_valid(params)) {
        good = 1U;
    }
    clear(state);
    state->ready = good;
    state->ready_inverse = ~good;
    set_mode(state, PF_MODE_IDLE);
    set_fault(state, PF_FAULT_NONE);
    if (good == 0U) {
        change(state, PF_MODE_FAULT, exact ? PF_FAULT_PARAMETER_BOUNDS : PF_FAULT_ARITHMETIC,
            PF_REASON_FAULT);
    }
    state->seal = seal_of(state);
    if (good == 1U) {
        return PF_SUPERVISOR_OK;
    }
    return exact ? PF_SUPERVISOR_BAD_PARAMETER : PF_SUPERVISOR_BAD_ARITHMETIC;
}

/* Nothing remembered can be relied on, and only init makes it trusted again. The log stays. */
static void distrust(pf_supervisor_state_t *state)
{
    state->ready = 0U;
    state->ready_inverse = ~0U;
    state->started = 0U;
    change(state, PF_MODE_FAULT, PF_FAULT_STATE_CORRUPT, PF_REASON_FAULT);
}

static pf_fault_t fault_of(uint32_t checks)
{
    static const struct {
        uint32_t check;
        pf_fault_t fault;
    } table[] = {
        {PF_CHECK_PARAMETER_CHECKSUM, PF_FAULT_PARAMETER_CHECKSUM},
        {PF_CHECK_PARAMETER_BOUNDS, PF_FAULT_PARAMETER_BOUNDS},
        {PF_CHECK_NOT_FINITE, PF_FAULT_NOT_FINITE},
        {PF_CHECK_RANGE, PF_FAULT_RANGE},
        {PF_CHECK_ENCODER_JUMP, PF_FAULT_ENCODER_JUMP},
        {PF_CHECK_STALE, PF_FAULT_STALE},
        {PF_CHECK_NUMERIC, PF_FAULT_NUMERIC},
        {PF_CHECK_ARITHMETIC, PF_FAULT_ARITHMETIC},
        {PF_CHECK_PARAMETER_FIXED, PF_FAULT_PARAMETER_FIXED},
    };
    uint32_t i;

    for (i = 0U; i < (uint32_t)(sizeof(table) / sizeof(table[0])); ++i) {
        if ((checks & table[i].check) != 0U) {
            return table[i].fault;
        }
    }
    return (checks != 0U) ? PF_FAULT_INTERFACE : PF_FAULT_NONE;
}

/* Count a period that was too long or too short; returns whether it is one too many. */
static int overruns(pf_supervisor_state_t *state, const pf_supervisor_params_t *params,
    double elapsed)
{
    const double period = params->sample_time;

    if (lies_within(elapsed, params->shortest_period * period, params->longest_period * period)) {
        state->good = raised(state->good);
        if ((state->good % FORGETTING == 0U) && (state->overruns > 0U)) {
            state->overruns -= 1U;
        }
        return 0;
    }
    state->good = 0U;
    state->overruns = raised(state->overruns);
    return state->overruns > params->overruns;
}

/* What is wrong this period. */
static pf_fault_t finding(pf_supervisor_state_t *state, const pf_supervisor_params_t *params,
    const pf_supervisor_input_t *input)
{
    const int first = state->started == 0U;
    const int stale = !first && (input->frame == state->frame);
    const int late = !first && overruns(state, params, input->elapsed);
    pf_fault_t fault;

    state->silent = (first || (input->heartbeat != state->heartbeat)) ? 0U : raised(state->silent);
    state->frame = input->frame;
    state->heartbeat = input->heartbeat;
    state->started = 1U;
    fault = fault_of(input->checks);
    if (fault != PF_FAULT_NONE) {
        return fault;
    }
    if ((input->measures == 0U) || (input->measures > PF_MEASURES)) {
        return PF_FAULT_INTERFACE;
    }
    if (!lies_within(input->elapsed, -DBL_MAX, DBL_MAX)) {
        return PF_FAULT_NOT_FINITE;
    }
    if (stale) {
        return PF_FAULT_STALE;
    }
    if (late) {
        return PF_FAULT_OVERRUN;
    }
    if ((params->watchdog_time > 0.0) &&
        ((double)state->silent * params->sample_time > params->watchdog_time)) {
        return PF_FAULT_WATCHDOG;
    }
    return PF_FAULT_NONE;
}

/* Whether every measure in use is within its limit; how many there are was checked. */
static int all_within(const pf_supervisor_input_t *input, const double *limit)
{
    uint32_t i;

    for (i = 0U; (i < input->measures) && (i < PF_MEASURES); ++i) {
        if (!lies_within(input->measure[i], 0.0, limit[i])) {
            return 0;
        }
    }
    return 1;
}

static void start(pf_supervisor_state_t *state)
{
    state->releases = 0U;
    change(state, PF_MODE_SWING_UP, PF_FAULT_NONE, PF_REASON_STARTED);
}

static void swing_up(pf_supervisor_state_t *state, const pf_supervisor_params_t *params,
    const pf_supervisor_input_t *input)
{
    const double time = (double)state->since * params->sample_time;

    state->inside = all_within(input, params->capture_limit) ? raised(state->inside) : 0U;
    if (state->inside >= params->capture_periods) {
        change(state, PF_MODE_BALANCE, PF_FAULT_NONE, PF_REASON_CAPTURED);
    } else if ((params->swing_up_timeout > 0.0) && (time > params->swing_up_timeout)) {
        change(state, PF_MODE_FAULT, PF_FAULT_SWING_UP_TIMEOUT, PF_REASON_FAULT);
    } else {
        /* goes on */
    }
}

static void balance(pf_supervisor_state_t *state, const pf_supervisor_params_t *params,
    const pf_supervisor_input_t *input)
{
    state->outside = all_within(input, params->release_limit) ? 0U : raised(state->outside);
    if (state->outside < params->release_periods) {
        return;
    }
    state->releases = raised(state->releases);
    if ((params->attempts > 0U) && (state->releases > params->attempts)) {
        change(state, PF_MODE_FAULT, PF_FAULT_ATTEMPTS, PF_REASON_FAULT);
    } else {
        change(state, PF_MODE_SWING_UP, PF_FAULT_NONE, PF_REASON_RELEASED);
    }
}

static void obey(pf_supervisor_state_t *state, const pf_supervisor_params_t *params,
    const pf_supervisor_input_t *input)
{
    if ((input->command == (uint32_t)PF_COMMAND_STOP) && (state->mode != (uint32_t)PF_MODE_IDLE)) {
        change(state, PF_MODE_IDLE, PF_FAULT_NONE, PF_REASON_STOPPED);
        return;
    }
    switch ((pf_mode_t)state->mode) {
    case PF_MODE_IDLE:
        if ((input->command == (uint32_t)PF_COMMAND_START) &&
            ((input->position & PF_POSITION_UNREAD) != 0U)) {
            note(state, PF_REASON_NO_READING);
        } else if (input->command == (uint32_t)PF_COMMAND_START) {
            start(state);
        } else {
            /* waits */
        }
        break;
    case PF_MODE_SWING_UP:
        swing_up(state, params, input);
        break;
    case PF_MODE_BALANCE:
        balance(state, params, input);
        break;
    case PF_MODE_FAULT:
    default:
        break;
    }
}

static void answer(const pf_supervisor_state_t *state, uint32_t entered,
    pf_supervisor_output_t *output)
{
    const uint32_t mode = state->mode;
    const int active = (mode == (uint32_t)PF_MODE_SWING_UP) || (mode == (uint32_t)PF_MODE_BALANCE);

    output->mode = mode;
    output->fault = state->fault;
    output->reason = state->reason;
    output->entered = entered;
    output->torque_allowed = active ? 1U : 0U;
}

void pf_supervisor_step(pf_supervisor_state_t *state, const pf_supervisor_params_t *params,
    const pf_supervisor_input_t *input, pf_supervisor_output_t *output)
{
    const int sound = is_sound(state);
    const uint32_t mode = state->mode;
    pf_fault_t fault;

    state->period += 1U;
    if (!sound) {
        distrust(state);
        state->seal = seal_of(state);
        answer(state, 1U, output);
        return;
    }
    state->since = raised(state->since);
    fault = parameters_are_valid(params) ? finding(state, params, input)
                                         : PF_FAULT_PARAMETER_BOUNDS;
    if ((input->position & PF_POSITION_REZEROED) != 0U) {
        note(state, PF_REASON_REZEROED);
    } else if ((input->position & PF_POSITION_REFUSED) != 0U) {
        note(state, PF_REASON_REZERO_REFUSED);
    } else {
        /* nothing was ordered */
    }
    if (mode == (uint32_t)PF_MODE_FAULT) {
        if ((fault == PF_FAULT_NONE) && (input->command == (uint32_t)PF_COMMAND_RESET) &&
            (state->ready == 1U)) {
            state->overruns = 0U;
            change(state, PF_MODE_IDLE, PF_FAULT_NONE, PF_REASON_RESET);
        }
    } else if (fault != PF_FAULT_NONE) {
        change(state, PF_MODE_FAULT, fault, PF_REASON_FAULT);
    } else {
        obey(state, params, input);
    }
    state->seal = seal_of(state);
    answer(state, (state->mode != mode) ? 1U : 0U, output);
}

void pf_supervisor_trip(pf_supervisor_state_t *state, pf_fault_t fault,
    pf_supervisor_output_t *output)
{
    const uint32_t number = (uint32_t)fault;
    const int known = (number != (uint32_t)PF_FAULT_NONE) &&
        (number <= (uint32_t)PF_FAULT_PARAMETER_FIXED);
    uint32_t entered = 1U;

    if (!is_sound(state)) {
        distrust(state);
    } else if (state->mode != (uint32_t)PF_MODE_FAULT) {
        change(state, PF_MODE_FAULT, known ? fault : PF_FAULT_NUMERIC, PF_REASON_FAULT);
    } else if (output->entered != 1U) {
        entered = 0U; /* latched in an earlier period */
    } else {
        /* latched by the step of this one */
    }
    state->seal = seal_of(state);
    answer(state, entered, output);
}

uint32_t pf_supervisor_log_read(const pf_supervisor_state_t *state, uint32_t number,
    pf_transition_t *transition)
{
    const volatile pf_supervisor_state_t *seen = state;
    const volatile pf_transition_t *entry = &seen->log[number % PF_LOG_LENGTH];
    uint32_t logged;

    transition->period = entry->period;
    transition->frame = entry->frame;
    transition->from = entry->from;
    transition->to = entry->to;
    transition->reason = entry->reason;
    transition->fault = entry->fault;
    logged = seen->logged; /* read last: the oldest entry may be overwritten meanwhile */
    return ((number < logged) && ((logged - number) < PF_LOG_LENGTH)) ? 1U : 0U;
}

uint32_t pf_checksum_word(uint32_t sum, uint32_t word)
{
    const uint32_t mixed = (sum ^ word) * PRIME;

    return mixed ^ (mixed >> 15); /* else the highest bits of two words would cancel */
}

uint32_t pf_checksum_double(uint32_t sum, double value)
{
    union {
        double value;
        uint64_t bits;
    } seen;

    seen.value = value;
    return pf_checksum_word(pf_checksum_word(sum, (uint32_t)(seen.bits >> 32)),
        (uint32_t)(seen.bits & LARGEST));
}

/* By its bits, which even a compiler that takes every value for a number looks at. */
static uint64_t magnitude(double value)
{
    union {
        double value;
        uint64_t bits;
    } seen;

    seen.value = value;
    return seen.bits & UINT64_C(0x7fffffffffffffff);
}

double pf_limited(double value, double limit)
{
    if ((magnitude(value) > INFINITE) || (magnitude(limit) >= INFINITE) || !(limit >= 0.0)) {
        return 0.0;
    }
    if (value > limit) {
        return limit;
    }
    if (value < -limit) {
        return -limit;
    }
    return lies_within(value, -limit, limit) ? value : 0.0;
}

double pf_slewed(double value, double previous, double step, double limit)
{
    const double wanted = pf_limited(value, limit);

    if ((magnitude(step) < INFINITE) && (step >= 0.0) && (magnitude(previous) < INFINITE)) {
        if (wanted > previous + step) {
            return pf_limited(previous + step, limit);
        }
        if (wanted < previous - step) {
            return pf_limited(previous - step, limit);
        }
    }
    return wanted;
}

double pf_nearest_turn(double angle, double reference)
{
    const double turns = (angle - reference) * INVERSE_TURN;
    double whole;

    if (!lies_within(turns, -MOST_TURNS, MOST_TURNS)) {
        return angle;
    }
    whole = (double)(int32_t)((turns < 0.0) ? turns - 0.5 : turns + 0.5);
    return angle - whole * TURN;
}

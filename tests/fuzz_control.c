/*
 * A fuzzer's way into the complete controller: any bytes as memory, parameters and readings, with
 * seals that fit them or not.
 *
 * The first byte says how far a sensible flight is flown before, the second what the bytes after it
 * are laid over and what is sealed anew. What is left then is one period after another, either as
 * the raw bytes of the readings or as a script of small steps, which leads through the modes.
 * The controller's source is part of this one, for its own checksum of the memory; build as
 * fuzz_step.c, with -DPF_CONTROL_SOURCE='"model_control.c"'.
 */
#include PF_CONTROL_SOURCE

#include "pf_model.h"

#include <float.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define OVER_STATE 1U
#define OVER_PARAMS 2U
#define SEAL_STATE 4U
#define SEAL_PARAMS 8U
#define INIT_AFTER 16U
#define RAW_READINGS 32U
#define SWING_UP_BY 64U /* the energy law instead of the plan */
#define HAND_HELD 128U /* the plant stands upright at the start */
#define PERIODS 48U

typedef struct {
    PF_CONTROL_STATE_T state;
    PF_CONTROL_PARAMS_T params;
    PF_CONTROL_INPUT_T input;
} period_t;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int holds)
{
    if (!holds) {
        abort();
    }
}

static int finite(double x)
{
    return (x - x) <= 0.0; /* false for what is infinite or no number */
}

/* As support_control.py does it: of pf_supervisor.c only the checksum's steps are public. */
static void seal_supervisor(pf_supervisor_state_t *state)
{
    const uint32_t words[] = {state->logged, state->mode, state->fault, state->ready, state->period,
        state->since, state->inside, state->outside, state->frame, state->heartbeat, state->silent,
        state->overruns, state->good, state->releases, state->reason, state->started};
    uint32_t sum = PF_CHECKSUM_SEED;
    size_t k;

    for (k = 0; k < sizeof words / sizeof words[0]; ++k) {
        sum = pf_checksum_word(sum, words[k]);
    }
    state->mode_inverse = ~state->mode;
    state->fault_inverse = ~state->fault;
    state->ready_inverse = ~state->ready;
    state->seal = sum;
}

static void require_consistent(const PF_CONTROL_OUTPUT_T *output)
{
    require(output->mode <= (uint32_t)PF_MODE_FAULT);
    require(output->fault <= (uint32_t)PF_FAULT_PARAMETER_FIXED);
    require((output->fault != 0U) == (output->mode == (uint32_t)PF_MODE_FAULT));
    require(output->reason <= (uint32_t)PF_REASON_REZERO_REFUSED);
    require(output->phase <= 2U);
    require(output->law_status <= 6U);
}

static void require_limited(double torque, double limit, uint32_t mode)
{
    const int active = (mode == (uint32_t)PF_MODE_SWING_UP) || (mode == (uint32_t)PF_MODE_BALANCE);

    require(finite(torque));
    if (active && (limit > 0.0) && (limit <= DBL_MAX)) {
        require((torque <= limit) && (torque >= -limit));
    } else {
        require((torque <= 0.0) && (torque >= 0.0));
    }
}

static void require_numbers(const PF_CONTROL_OUTPUT_T *output)
{
    double members[offsetof(PF_CONTROL_OUTPUT_T, mode) / sizeof(double)];
    size_t k;

    memcpy(members, output, sizeof members);
    for (k = 0; k < sizeof members / sizeof members[0]; ++k) {
        require(finite(members[k]));
    }
}

static void one_period(period_t *period, int untouched)
{
    PF_CONTROL_OUTPUT_T output;
    const int whole = memory_checksum(&period->state) == period->state.seal;
    const int sealed = PF_CONTROL_CHECKSUM(&period->params) == period->params.checksum;
    const pf_mode_t before = pf_supervisor_mode(&period->state.supervisor);

    memset(&output, 0xff, sizeof output);
    PF_CONTROL_STEP(&period->state, &period->params, &period->input, &output);
    require_consistent(&output);
    require_limited(output.PF_TORQUE, period->params.law.PF_LIMIT, output.mode);
    if (!whole || !sealed ||
        ((before == PF_MODE_FAULT) && (period->input.command != (uint32_t)PF_COMMAND_RESET))) {
        require(output.mode == (uint32_t)PF_MODE_FAULT);
    }
    require((uint32_t)pf_supervisor_mode(&period->state.supervisor) == output.mode);
    require(memory_checksum(&period->state) == period->state.seal);
    if (untouched) {
        require_numbers(&output);
    }
}

static void good_reading(PF_CONTROL_INPUT_T *input)
{
    input->q1_valid = 1U;
    input->q2_valid = 1U;
    input->elapsed = 1e-3;
    input->frame += 1U;
    input->heartbeat += 1U;
    input->command = 0U;
}

/* Four bytes a period: by how much the encoders turn, what is wrong, and what it is worth. */
static void scripted(PF_CONTROL_INPUT_T *input, const uint8_t *byte)
{
    static const double elapsed[] = {0.0, -1e-3, 1e-4, 2.1e-3, 1.0, DBL_MAX, -DBL_MAX, 5e-324};

    good_reading(input);
    input->q1_raw += (uint32_t)(int32_t)(int8_t)byte[0];
    input->q2_raw += (uint32_t)(int32_t)(int8_t)byte[1];
    input->command = byte[2] & 3U;
    input->q1_valid = ((byte[2] & 4U) == 0U) ? 1U : 0U;
    input->q2_valid = ((byte[2] & 8U) == 0U) ? 1U : 0U;
    input->frame -= ((byte[2] & 16U) == 0U) ? 0U : 1U;
    input->heartbeat -= ((byte[2] & 32U) == 0U) ? 0U : 1U;
    if ((byte[2] & 64U) != 0U) {
        input->elapsed = elapsed[byte[3] % 8U];
    }
    if ((byte[2] & 128U) != 0U) {
        input->q1_raw += (uint32_t)byte[3] << 12;
    }
}

static void sensible(period_t *period, unsigned flags, unsigned periods)
{
    unsigned k;

    period->params = PF_CONTROL_SET;
    if ((flags & SWING_UP_BY) != 0U) {
        period->params.swing_up = 1U;
    }
    PF_CONTROL_SEAL(&period->params);
    require(PF_CONTROL_INIT(&period->state, &period->params) == 0);
    period->input.q1_raw = ((flags & HAND_HELD) != 0U) ? 1250U : 0xffffffffU - 1249U;
    for (k = 0; k < periods; ++k) {
        good_reading(&period->input);
        period->input.command = (k == 1U) ? (uint32_t)PF_COMMAND_START : 0U;
        one_period(period, 1);
    }
}

static size_t lay_over(void *at, size_t room, const uint8_t *data, size_t size)
{
    const size_t taken = (size < room) ? size : room;

    memcpy(at, data, taken);
    return taken;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    period_t period;
    unsigned flags, k;
    size_t at = 2U;
    int untouched;

    if (size < 2U) {
        return 0;
    }
    memset(&period, 0, sizeof period);
    flags = data[1];
    untouched = (flags & (OVER_STATE | OVER_PARAMS)) == 0U;
    sensible(&period, flags, data[0] % 8U);
    if ((flags & OVER_STATE) != 0U) { /* up to a place that the fuzzer can choose */
        const size_t from = (size > at) ? ((size_t)data[at++] * 8U) % sizeof period.state : 0U;

        at += lay_over((unsigned char *)&period.state + from, sizeof period.state - from, data + at,
            size - at);
    }
    if ((flags & OVER_PARAMS) != 0U) {
        const size_t from = (size > at) ? ((size_t)data[at++] * 8U) % sizeof period.params : 0U;

        at += lay_over((unsigned char *)&period.params + from, sizeof period.params - from,
            data + at, size - at);
    }
    if ((flags & SEAL_PARAMS) != 0U) {
        PF_CONTROL_SEAL(&period.params);
    }
    if ((flags & INIT_AFTER) != 0U) {
        (void)PF_CONTROL_INIT(&period.state, &period.params);
    }
    if ((flags & SEAL_STATE) != 0U) {
        seal_supervisor(&period.state.supervisor);
        period.state.seal = memory_checksum(&period.state);
    }
    for (k = 0; (k < PERIODS) && (at < size); ++k) {
        if ((flags & RAW_READINGS) != 0U) {
            good_reading(&period.input);
            at += lay_over(&period.input, sizeof period.input, data + at, size - at);
        } else {
            uint8_t bytes[4] = {0U, 0U, 0U, 0U};

            at += lay_over(bytes, sizeof bytes, data + at, size - at);
            scripted(&period.input, bytes);
        }
        one_period(&period, untouched);
    }
    good_reading(&period.input);
    one_period(&period, untouched);
    return 0;
}

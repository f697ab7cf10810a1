/*
 * A fuzzer's way into the supervisor and its arithmetic: any bytes as memory, parameters and what
 * it is told, sealed or not. The first byte says which; the rest is laid over what init gives, then
 * one period after another. Build as fuzz_step.c, with pf_supervisor.c.
 */
#include "pf_supervisor.c"

#include <stdlib.h>
#include <string.h>

#define OVER_STATE 1U
#define OVER_PARAMS 2U
#define SEAL 4U
#define TRIPPED 8U
#define SCRIPTED 16U
#define PERIODS 64U

typedef struct {
    pf_supervisor_state_t state;
    pf_supervisor_params_t params;
    pf_supervisor_input_t input;
} period_t;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int holds)
{
    if (!holds) {
        abort();
    }
}

static void sensible(period_t *period)
{
    uint32_t i;

    memset(period, 0, sizeof *period);
    for (i = 0U; i < PF_MEASURES; ++i) {
        period->params.capture_limit[i] = 1.0;
        period->params.release_limit[i] = 2.0;
    }
    period->params.sample_time = 1e-3;
    period->params.shortest_period = 0.2;
    period->params.longest_period = 2.0;
    period->params.watchdog_time = 0.005;
    period->params.swing_up_timeout = 0.02;
    period->params.capture_periods = 2U;
    period->params.release_periods = 2U;
    period->params.overruns = 1U;
    period->params.attempts = 2U;
    require(pf_supervisor_init(&period->state, &period->params) == PF_SUPERVISOR_OK);
}

static void good_input(pf_supervisor_input_t *input)
{
    uint32_t i;

    for (i = 0U; i < PF_MEASURES; ++i) {
        input->measure[i] = 0.0;
    }
    input->elapsed = 1e-3;
    input->measures = PF_MEASURES;
    input->frame += 1U;
    input->heartbeat += 1U;
    input->command = 0U;
    input->checks = 0U;
}

/* Two bytes a period: what is told, and what it is worth. */
static void scripted(pf_supervisor_input_t *input, const uint8_t *byte)
{
    static const double measure[] = {0.0, 0.5, 1.5, 3.0, -1.0, PF_FAR, DBL_MAX, 5e-324};

    good_input(input);
    input->command = byte[0] & 3U;
    input->frame -= ((byte[0] & 4U) == 0U) ? 0U : 1U;
    input->heartbeat -= ((byte[0] & 8U) == 0U) ? 0U : 1U;
    input->elapsed = ((byte[0] & 16U) == 0U) ? 1e-3 : measure[byte[1] % 8U];
    input->measure[byte[1] >> 5] = measure[(byte[1] >> 2) & 7U];
    if ((byte[0] & 32U) != 0U) {
        input->checks = 1U << (byte[1] & 31U);
    }
    if ((byte[0] & 64U) != 0U) {
        input->measures = byte[1] & 15U;
    }
}

static void require_consistent(const period_t *period, const pf_supervisor_output_t *output)
{
    const int active = (output->mode == 1U) || (output->mode == 2U);

    require(output->mode <= (uint32_t)PF_MODE_FAULT);
    require(output->fault <= (uint32_t)PF_FAULT_PARAMETER_FIXED);
    require((output->fault != 0U) == (output->mode == (uint32_t)PF_MODE_FAULT));
    require(output->reason <= (uint32_t)PF_REASON_REZERO_REFUSED);
    require(output->entered <= 1U);
    require(output->torque_allowed == (active ? 1U : 0U));
    require(is_sound(&period->state));
    require(period->state.mode == output->mode);
    require(period->state.fault == output->fault);
}

static void one_period(period_t *period, int tripped)
{
    pf_supervisor_output_t output;
    pf_transition_t entry;
    const int sound = is_sound(&period->state);
    const pf_supervisor_state_t before = period->state;
    const int held = (before.mode == (uint32_t)PF_MODE_FAULT) &&
        (period->input.command != (uint32_t)PF_COMMAND_RESET);

    memset(&output, 0xff, sizeof output);
    pf_supervisor_step(&period->state, &period->params, &period->input, &output);
    require_consistent(period, &output);
    require(output.entered == ((!sound || (output.mode != before.mode)) ? 1U : 0U));
    if (!sound) {
        require(output.fault == (uint32_t)PF_FAULT_STATE_CORRUPT);
    } else if (held) {
        require(output.fault == before.fault);
    } else if ((period->input.checks != 0U) || !parameters_are_valid(&period->params)) {
        require(output.mode == (uint32_t)PF_MODE_FAULT);
    }
    if (tripped) {
        pf_supervisor_trip(&period->state, (pf_fault_t)(period->input.checks & 31U), &output);
        require_consistent(period, &output);
        require(output.mode == (uint32_t)PF_MODE_FAULT);
    }
    require(pf_supervisor_log_read(&period->state, period->state.logged, &entry) == 0U);
    if (pf_supervisor_log_read(&period->state, period->state.logged - 1U, &entry) == 1U) {
        require(entry.to <= (uint32_t)PF_MODE_FAULT);
    }
}

static void arithmetic(const pf_supervisor_input_t *input)
{
    const double *x = input->measure;
    const double limit = lies_within(x[1], 0.0, DBL_MAX) ? x[1] : 0.0;
    const double limited = pf_limited(x[0], x[1]);
    const double slewed = pf_slewed(x[0], x[2], x[3], x[1]);
    const double turned = pf_nearest_turn(x[4], x[5]);

    require(lies_within(limited, -limit, limit));
    require(lies_within(slewed, -limit, limit));
    if (lies_within(x[4], -1e6, 1e6) && lies_within(x[5], -1e6, 1e6)) {
        require(lies_within(turned - x[5], -3.1416, 3.1416));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    period_t period;
    unsigned flags = (size > 0U) ? data[0] : 0U;
    unsigned k;
    size_t at = 1U;

    sensible(&period);
    if ((flags & (OVER_STATE | OVER_PARAMS)) != 0U) {
        unsigned char *to = ((flags & OVER_STATE) != 0U) ? (unsigned char *)&period.state.logged
            : (unsigned char *)&period.params;
        const size_t room = (size_t)(((flags & OVER_PARAMS) != 0U)
            ? (unsigned char *)&period.input - to : (unsigned char *)&period.params - to);
        const size_t taken = (size - at < room) ? size - at : room;

        memcpy(to, data + at, taken);
        at += taken;
    }
    if ((flags & SEAL) != 0U) {
        period.state.mode_inverse = ~period.state.mode;
        period.state.fault_inverse = ~period.state.fault;
        period.state.ready_inverse = ~period.state.ready;
        period.state.seal = seal_of(&period.state);
    }
    for (k = 0; (k < PERIODS) && (at < size); ++k) {
        const size_t asked = ((flags & SCRIPTED) != 0U) ? 2U : sizeof period.input;
        const size_t taken = (size - at < asked) ? size - at : asked;
        uint8_t bytes[2] = {0U, 0U};

        if ((flags & SCRIPTED) != 0U) {
            memcpy(bytes, data + at, taken);
            scripted(&period.input, bytes);
        } else {
            good_input(&period.input);
            memcpy(&period.input, data + at, taken);
        }
        at += taken;
        arithmetic(&period.input);
        one_period(&period, ((flags & TRIPPED) != 0U) && (k % 8U == 7U));
    }
    good_input(&period.input);
    one_period(&period, 0);
    return 0;
}

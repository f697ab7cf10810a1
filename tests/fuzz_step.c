/*
 * A fuzzer's way into the controller: any bytes as state, parameters and measurements.
 *
 * The first byte says which of the three the rest is laid over; what it does not reach stays as init
 * and a parameter set give it, so that a short input is a small fault in a sensible period. Build
 * with clang -fsanitize=fuzzer, or with fuzz_replay.c for a program that reads files.
 */
#include "pf_model.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* The model's torque and the parameter that limits it: -DPF_TORQUE=tau -DPF_LIMIT=torque_limit. */
#define PF_PERIODS 3

typedef struct {
    PF_STATE_T state;
    PF_PARAMS_T params;
    PF_INPUT_T input;
} period_t;

extern const PF_PARAMS_T PF_SET;
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int holds)
{
    if (!holds) {
        abort();
    }
}

static int is_finite(double x)
{
    return (x - x) <= 0.0; /* false for what is infinite or no number */
}

static void one_period(period_t *period)
{
    PF_OUTPUT_T output;
    double members[sizeof output / sizeof(double)];
    const PF_STATE_T before = period->state;
    const int status = (int)PF_STEP(&period->state, &period->params, &period->input, &output);
    size_t k;

    require(status >= 0 && status <= 6);
    memcpy(members, &output, sizeof output);
    for (k = 0; k < sizeof members / sizeof members[0]; ++k) {
        require(is_finite(members[k]));
    }
    if (status >= 3) {
        require(memcmp(&before, &period->state, sizeof before) == 0);
        require(output.PF_TORQUE >= 0.0 && output.PF_TORQUE <= 0.0);
    } else {
        require(period->params.PF_LIMIT > 0.0);
        require(output.PF_TORQUE <= period->params.PF_LIMIT);
        require(output.PF_TORQUE >= -period->params.PF_LIMIT);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    period_t period;
    unsigned char *at = (unsigned char *)&period;
    size_t room = sizeof period;
    int k;

    memset(&period, 0, sizeof period);
    period.params = PF_SET;
    (void)PF_INIT(&period.state, &period.params);
    if (size > 0U) {
        switch (data[0] % 4U) {
        case 0:
            at = (unsigned char *)&period.input;
            room = sizeof period.input;
            break;
        case 1:
            at = (unsigned char *)&period.params;
            room = sizeof period.params + sizeof period.input;
            break;
        case 2:
            room = sizeof period.state;
            break;
        default:
            break;
        }
        memcpy(at, data + 1, (size - 1U < room) ? (size - 1U) : room);
        if (data[0] >= 128U) { /* as after a change of parameters */
            (void)PF_INIT(&period.state, &period.params);
        }
    }
    for (k = 0; k < PF_PERIODS; ++k) {
        one_period(&period);
    }
    return 0;
}

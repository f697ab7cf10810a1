/* What a PC needs to drive pf_sensing on a host or on an emulated target: many channels at once. */
#include "pf_sensing.h"

uint32_t pf_sensing_sizeof(uint32_t role);
void pf_sensing_batch_init(uint32_t channels, pf_sensing_state_t *state,
    const pf_sensing_params_t *params, int32_t *status);
void pf_sensing_batch_step(uint32_t channels, uint32_t periods, pf_sensing_state_t *state,
    const pf_sensing_input_t *input, pf_sensing_output_t *output, int32_t *status);
void pf_sensing_batch_retune(uint32_t channels, pf_sensing_state_t *state,
    const pf_sensing_params_t *params, int32_t *status);
void pf_sensing_batch_rezero(uint32_t channels, pf_sensing_state_t *state, const double *angle,
    uint32_t periods, int32_t *status);

uint32_t pf_sensing_sizeof(uint32_t role)
{
    static const uint32_t sizes[] = {
        (uint32_t)sizeof(pf_sensing_params_t), (uint32_t)sizeof(pf_sensing_input_t),
        (uint32_t)sizeof(pf_sensing_state_t), (uint32_t)sizeof(pf_sensing_output_t),
    };

    return (role < (uint32_t)(sizeof(sizes) / sizeof(sizes[0]))) ? sizes[role] : 0U;
}

void pf_sensing_batch_init(uint32_t channels, pf_sensing_state_t *state,
    const pf_sensing_params_t *params, int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < channels; ++i) {
        status[i] = (int32_t)pf_sensing_init(&state[i], &params[i]);
    }
}

void pf_sensing_batch_retune(uint32_t channels, pf_sensing_state_t *state,
    const pf_sensing_params_t *params, int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < channels; ++i) {
        status[i] = (int32_t)pf_sensing_retune(&state[i], &params[i]);
    }
}

void pf_sensing_batch_rezero(uint32_t channels, pf_sensing_state_t *state, const double *angle,
    uint32_t periods, int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < channels; ++i) {
        status[i] = (int32_t)pf_sensing_rezero(&state[i], angle[i], periods);
    }
}

/* Readings, outputs and statuses are laid out period by period, the channels side by side. */
void pf_sensing_batch_step(uint32_t channels, uint32_t periods, pf_sensing_state_t *state,
    const pf_sensing_input_t *input, pf_sensing_output_t *output, int32_t *status)
{
    uint32_t i, k;

    for (k = 0U; k < periods; ++k) {
        for (i = 0U; i < channels; ++i) {
            const uint32_t at = k * channels + i;

            status[at] = (int32_t)pf_sensing_step(&state[i], &input[at], &output[at]);
        }
    }
}

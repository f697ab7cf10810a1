/*
 * What a PC needs to drive a complete controller on a host or on an emulated target: many at once.
 *
 * It knows no model: pf_model.h, generated beside the controller, gives the names.
 */
#include "pf_model.h"

#ifndef PF_CONTROL_HEADER
#error "this generation has no complete controller"
#endif
#include PF_CONTROL_HEADER

#if PF_ABI_VERSION != 3
#error "the generated code has another ABI than this harness: regenerate"
#endif

uint32_t pf_control_sizeof(uint32_t role);
void pf_control_batch_seal(uint32_t n, PF_CONTROL_PARAMS_T *params);
void pf_control_batch_init(uint32_t n, PF_CONTROL_STATE_T *state, const PF_CONTROL_PARAMS_T *params,
    int32_t *status);
void pf_control_batch_step(uint32_t n, PF_CONTROL_STATE_T *state, const PF_CONTROL_PARAMS_T *params,
    const PF_CONTROL_INPUT_T *input, PF_CONTROL_OUTPUT_T *output);

uint32_t pf_control_sizeof(uint32_t role)
{
    static const uint32_t sizes[] = {
        (uint32_t)sizeof(PF_CONTROL_PARAMS_T), (uint32_t)sizeof(PF_CONTROL_INPUT_T),
        (uint32_t)sizeof(PF_CONTROL_STATE_T), (uint32_t)sizeof(PF_CONTROL_OUTPUT_T),
    };

    return (role < (uint32_t)(sizeof(sizes) / sizeof(sizes[0]))) ? sizes[role] : 0U;
}

void pf_control_batch_seal(uint32_t n, PF_CONTROL_PARAMS_T *params)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        PF_CONTROL_SEAL(&params[i]);
    }
}

void pf_control_batch_init(uint32_t n, PF_CONTROL_STATE_T *state, const PF_CONTROL_PARAMS_T *params,
    int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        status[i] = (int32_t)PF_CONTROL_INIT(&state[i], &params[i]);
    }
}

void pf_control_batch_step(uint32_t n, PF_CONTROL_STATE_T *state, const PF_CONTROL_PARAMS_T *params,
    const PF_CONTROL_INPUT_T *input, PF_CONTROL_OUTPUT_T *output)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        PF_CONTROL_STEP(&state[i], &params[i], &input[i], &output[i]);
    }
}

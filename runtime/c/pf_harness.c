/*
 * The harness: what a PC needs to drive generated code on a host or on an emulated target.
 *
 * It knows no model: pf_model.h, generated beside the controller, gives the names. Arrays are laid
 * out one structure a sample, so that one call serves a single period and a batch of samples.
 */
#include "pf_model.h"

#include <float.h>
#include <stdint.h>

#if PF_ABI_VERSION != 2
#error "the generated code has another ABI than this harness: regenerate"
#endif

#if defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD != 0)
#error "intermediate results are kept in another precision than double: results would differ"
#endif

typedef union {
    double value;
    uint64_t bits;
    uint8_t bytes[8];
} pf_double_bits_t;

/* What the target must be for the bits to be the same; 0 if it is. */
uint32_t pf_target_check(void);
uint32_t pf_sizeof(uint32_t role);
void pf_batch_init(uint32_t n, PF_STATE_T *state, const PF_PARAMS_T *params, int32_t *status);
void pf_batch_step(uint32_t n, PF_STATE_T *state, const PF_PARAMS_T *params,
    const PF_INPUT_T *input, PF_OUTPUT_T *output, int32_t *status);
void pf_batch_continuous(uint32_t n, const PF_CONTINUOUS_STATE_T *state, const PF_PARAMS_T *params,
    const PF_INPUT_T *input, PF_CONTINUOUS_OUTPUT_T *output);
void pf_batch_acceleration(uint32_t n, const PF_PLANT_PARAMS_T *params,
    const PF_PLANT_STATE_T *state, const PF_PLANT_INPUT_T *input, PF_PLANT_RATE_T *rate);
void pf_batch_energy(uint32_t n, const PF_PLANT_PARAMS_T *params, const PF_PLANT_STATE_T *state,
    double *energy);
void pf_batch_plant_step(uint32_t n, PF_PLANT_STATE_T *state, const PF_PLANT_PARAMS_T *params,
    const PF_PLANT_INPUT_T *input, const double *step, uint32_t substeps);

uint32_t pf_target_check(void)
{
    volatile double third = 1.0;
    pf_double_bits_t seen;
    uint32_t fault = 0U;

    third /= 3.0; /* at run time, in the rounding mode in force: to nearest gives ...555 */
    seen.value = third;
    if (seen.bits != UINT64_C(0x3fd5555555555555)) {
        fault |= 1U;
    }
    third = 4.9406564584124654e-324; /* subnormals must not be flushed to zero */
    seen.value = third * 1.0;
    if (seen.bits != UINT64_C(1)) {
        fault |= 2U;
    }
    if (sizeof(double) != 8U || sizeof(uint32_t) != 4U) {
        fault |= 4U;
    }
    return fault;
}

uint32_t pf_sizeof(uint32_t role)
{
    static const uint32_t sizes[] = {
        (uint32_t)sizeof(PF_PARAMS_T), (uint32_t)sizeof(PF_INPUT_T),
        (uint32_t)sizeof(PF_STATE_T), (uint32_t)sizeof(PF_OUTPUT_T),
        (uint32_t)sizeof(PF_CONTINUOUS_STATE_T), (uint32_t)sizeof(PF_CONTINUOUS_OUTPUT_T),
        (uint32_t)sizeof(PF_PLANT_PARAMS_T), (uint32_t)sizeof(PF_PLANT_STATE_T),
        (uint32_t)sizeof(PF_PLANT_INPUT_T), (uint32_t)sizeof(PF_PLANT_RATE_T),
    };

    return (role < (uint32_t)(sizeof(sizes) / sizeof(sizes[0]))) ? sizes[role] : 0U;
}

void pf_batch_init(uint32_t n, PF_STATE_T *state, const PF_PARAMS_T *params, int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        status[i] = (int32_t)PF_INIT(&state[i], &params[i]);
    }
}

void pf_batch_step(uint32_t n, PF_STATE_T *state, const PF_PARAMS_T *params,
    const PF_INPUT_T *input, PF_OUTPUT_T *output, int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        status[i] = (int32_t)PF_STEP(&state[i], &params[i], &input[i], &output[i]);
    }
}

void pf_batch_continuous(uint32_t n, const PF_CONTINUOUS_STATE_T *state, const PF_PARAMS_T *params,
    const PF_INPUT_T *input, PF_CONTINUOUS_OUTPUT_T *output)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        PF_CONTINUOUS(&state[i], &params[i], &input[i], &output[i]);
    }
}

void pf_batch_acceleration(uint32_t n, const PF_PLANT_PARAMS_T *params,
    const PF_PLANT_STATE_T *state, const PF_PLANT_INPUT_T *input, PF_PLANT_RATE_T *rate)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        PF_ACCELERATION(&params[i], &state[i], &input[i], &rate[i]);
    }
}

void pf_batch_energy(uint32_t n, const PF_PLANT_PARAMS_T *params, const PF_PLANT_STATE_T *state,
    double *energy)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        energy[i] = PF_ENERGY(&params[i], &state[i]);
    }
}

void pf_batch_plant_step(uint32_t n, PF_PLANT_STATE_T *state, const PF_PLANT_PARAMS_T *params,
    const PF_PLANT_INPUT_T *input, const double *step, uint32_t substeps)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        PF_PLANT_STEP(&state[i], &params[i], &input[i], step[i], substeps);
    }
}

/*
 * The harness: what a PC needs to drive generated code on a host or on an emulated target.
 *
 * It knows no model: pf_model.h, generated beside the controller, gives the names. Arrays are laid
 * out one structure a sample, so that one call serves a single period and a batch of samples.
 */
#include "pf_arithmetic.h"
#include "pf_model.h"

#include <stdint.h>

#if PF_ABI_VERSION != 3
#error "the generated code has another ABI than this harness: regenerate"
#endif

/* The precision of the model: its type, the bits of 1/3 and the least number there is. */
#ifdef PF_SINGLE
#define PF_REAL float
#define PF_WORD uint32_t
#define PF_C(literal) literal##f
#define PF_THIRD UINT32_C(0x3eaaaaab)
#define PF_LEAST 1.40129846e-45f
#else
#define PF_REAL double
#define PF_WORD uint64_t
#define PF_C(literal) literal
#define PF_THIRD UINT64_C(0x3fd5555555555555)
#define PF_LEAST 4.9406564584124654e-324
#endif

typedef union {
    PF_REAL value;
    PF_WORD bits;
} pf_real_bits_t;

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
    PF_REAL *energy);
void pf_batch_plant_step(uint32_t n, PF_PLANT_STATE_T *state, const PF_PLANT_PARAMS_T *params,
    const PF_PLANT_INPUT_T *input, const PF_REAL *step, uint32_t substeps);
#ifdef PF_HAS_SWING_UP
void pf_batch_swing_up(uint32_t n, const PF_PARAMS_T *params, const PF_INPUT_T *input,
    PF_SWING_UP_OUTPUT_T *output, int32_t *status);
#define PF_SIZEOF_SWING_UP_OUTPUT ((uint32_t)sizeof(PF_SWING_UP_OUTPUT_T))
#else
#define PF_SIZEOF_SWING_UP_OUTPUT 0U
#endif
#ifdef PF_HAS_FOLLOW
void pf_batch_follow(uint32_t n, PF_STATE_T *state, const PF_PARAMS_T *params,
    const PF_INPUT_T *input, const PF_REFERENCE_T *reference, PF_OUTPUT_T *output,
    int32_t *status);
void pf_batch_plan_at(uint32_t n, const PF_REAL *time, PF_REFERENCE_T *reference, uint32_t plan);
#define PF_SIZEOF_REFERENCE ((uint32_t)sizeof(PF_REFERENCE_T))
#else
#define PF_SIZEOF_REFERENCE 0U
#endif

uint32_t pf_target_check(void)
{
    volatile PF_REAL third = PF_C(1.0);
    pf_real_bits_t seen;
    uint32_t fault = 0U;

    third /= PF_C(3.0); /* at run time, in the rounding mode in force: to nearest */
    seen.value = third;
    if (seen.bits != PF_THIRD) {
        fault |= 1U;
    }
    third = PF_LEAST; /* subnormals must not be flushed to zero */
    seen.value = third * PF_C(1.0);
    if (seen.bits != 1U) {
        fault |= 2U;
    }
    if (sizeof(PF_REAL) != sizeof(PF_WORD) || sizeof(uint32_t) != 4U) {
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
        PF_SIZEOF_SWING_UP_OUTPUT, PF_SIZEOF_REFERENCE,
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
    PF_REAL *energy)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        energy[i] = PF_ENERGY(&params[i], &state[i]);
    }
}

void pf_batch_plant_step(uint32_t n, PF_PLANT_STATE_T *state, const PF_PLANT_PARAMS_T *params,
    const PF_PLANT_INPUT_T *input, const PF_REAL *step, uint32_t substeps)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        PF_PLANT_STEP(&state[i], &params[i], &input[i], step[i], substeps);
    }
}

#ifdef PF_HAS_SWING_UP
void pf_batch_swing_up(uint32_t n, const PF_PARAMS_T *params, const PF_INPUT_T *input,
    PF_SWING_UP_OUTPUT_T *output, int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        status[i] = (int32_t)PF_SWING_UP(&params[i], &input[i], &output[i]);
    }
}
#endif

#ifdef PF_HAS_FOLLOW
void pf_batch_follow(uint32_t n, PF_STATE_T *state, const PF_PARAMS_T *params,
    const PF_INPUT_T *input, const PF_REFERENCE_T *reference, PF_OUTPUT_T *output,
    int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        status[i] =
            (int32_t)PF_FOLLOW(&state[i], &params[i], &input[i], &reference[i], &output[i]);
    }
}

void pf_batch_plan_at(uint32_t n, const PF_REAL *time, PF_REFERENCE_T *reference, uint32_t plan)
{
    static const PF_PLAN_T *const plans[] = PF_PLANS;
    uint32_t i;

    for (i = 0U; i < n && plan < (uint32_t)(sizeof(plans) / sizeof(plans[0])); ++i) {
        PF_PLAN_AT(plans[plan], time[i], &reference[i]);
    }
}
#endif

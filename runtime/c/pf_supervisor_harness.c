/* What a PC needs to drive pf_supervisor on a host or on an emulated target: many units at once. */
#include "pf_supervisor.h"

uint32_t pf_supervisor_sizeof(uint32_t role);
void pf_supervisor_batch_init(uint32_t units, pf_supervisor_state_t *state,
    const pf_supervisor_params_t *params, int32_t *status);
void pf_supervisor_batch_step(uint32_t units, uint32_t periods, pf_supervisor_state_t *state,
    const pf_supervisor_params_t *params, const pf_supervisor_input_t *input,
    pf_supervisor_output_t *output);
void pf_supervisor_batch_trip(uint32_t units, pf_supervisor_state_t *state, const uint32_t *fault,
    pf_supervisor_output_t *output);
void pf_supervisor_batch_mode(uint32_t units, const pf_supervisor_state_t *state, uint32_t *mode);
void pf_supervisor_batch_log_read(uint32_t units, const pf_supervisor_state_t *state,
    uint32_t number, pf_transition_t *transition, uint32_t *there);
void pf_checksum_batch(uint32_t blocks, uint32_t length, const double *value, uint32_t *sum);
void pf_limited_batch(uint32_t count, const double *value, const double *limit, double *result);
void pf_slewed_batch(uint32_t count, const double *value, const double *previous,
    const double *step, const double *limit, double *result);
void pf_nearest_turn_batch(uint32_t count, const double *angle, const double *reference,
    double *result);

uint32_t pf_supervisor_sizeof(uint32_t role)
{
    static const uint32_t sizes[] = {
        (uint32_t)sizeof(pf_supervisor_params_t), (uint32_t)sizeof(pf_supervisor_input_t),
        (uint32_t)sizeof(pf_supervisor_state_t), (uint32_t)sizeof(pf_supervisor_output_t),
    };

    return (role < (uint32_t)(sizeof(sizes) / sizeof(sizes[0]))) ? sizes[role] : 0U;
}

void pf_supervisor_batch_init(uint32_t units, pf_supervisor_state_t *state,
    const pf_supervisor_params_t *params, int32_t *status)
{
    uint32_t i;

    for (i = 0U; i < units; ++i) {
        status[i] = (int32_t)pf_supervisor_init(&state[i], &params[i]);
    }
}

/* Inputs and outputs are laid out period by period, the units side by side. */
void pf_supervisor_batch_step(uint32_t units, uint32_t periods, pf_supervisor_state_t *state,
    const pf_supervisor_params_t *params, const pf_supervisor_input_t *input,
    pf_supervisor_output_t *output)
{
    uint32_t i, k;

    for (k = 0U; k < periods; ++k) {
        for (i = 0U; i < units; ++i) {
            const uint32_t at = (k * units) + i;

            pf_supervisor_step(&state[i], &params[i], &input[at], &output[at]);
        }
    }
}

void pf_supervisor_batch_trip(uint32_t units, pf_supervisor_state_t *state, const uint32_t *fault,
    pf_supervisor_output_t *output)
{
    uint32_t i;

    for (i = 0U; i < units; ++i) {
        pf_supervisor_trip(&state[i], (pf_fault_t)fault[i], &output[i]);
    }
}

void pf_supervisor_batch_mode(uint32_t units, const pf_supervisor_state_t *state, uint32_t *mode)
{
    uint32_t i;

    for (i = 0U; i < units; ++i) {
        mode[i] = (uint32_t)pf_supervisor_mode(&state[i]);
    }
}

void pf_supervisor_batch_log_read(uint32_t units, const pf_supervisor_state_t *state,
    uint32_t number, pf_transition_t *transition, uint32_t *there)
{
    uint32_t i;

    for (i = 0U; i < units; ++i) {
        there[i] = pf_supervisor_log_read(&state[i], number, &transition[i]);
    }
}

/* The blocks one after another. */
void pf_checksum_batch(uint32_t blocks, uint32_t length, const double *value, uint32_t *sum)
{
    uint32_t i, k;

    for (i = 0U; i < blocks; ++i) {
        sum[i] = PF_CHECKSUM_SEED;
        for (k = 0U; k < length; ++k) {
            sum[i] = pf_checksum_double(sum[i], value[(i * length) + k]);
        }
    }
}

void pf_limited_batch(uint32_t count, const double *value, const double *limit, double *result)
{
    uint32_t i;

    for (i = 0U; i < count; ++i) {
        result[i] = pf_limited(value[i], limit[i]);
    }
}

void pf_slewed_batch(uint32_t count, const double *value, const double *previous,
    const double *step, const double *limit, double *result)
{
    uint32_t i;

    for (i = 0U; i < count; ++i) {
        result[i] = pf_slewed(value[i], previous[i], step[i], limit[i]);
    }
}

void pf_nearest_turn_batch(uint32_t count, const double *angle, const double *reference,
    double *result)
{
    uint32_t i;

    for (i = 0U; i < count; ++i) {
        result[i] = pf_nearest_turn(angle[i], reference[i]);
    }
}

/* A whole flight inside one program: see pf_flight.h. */
#include "pf_flight.h"

#include "pf_arithmetic.h"

uint32_t pf_flight_check(const pf_frame_t *frame, uint32_t room)
{
    uint32_t fault = pf_target_check();
    uint32_t role;
    union {
        PF_FLIGHT_REAL value;
        unsigned char bytes[sizeof(PF_FLIGHT_REAL)];
    } here, there;
    volatile PF_FLIGHT_REAL third = (PF_FLIGHT_REAL)1;

    if (frame->magic != PF_FLIGHT_MAGIC || frame->order != PF_FLIGHT_ORDER) {
        return fault | PF_FAULT_ORDER; /* nothing else in it can be read */
    }
    if (frame->version != PF_FLIGHT_VERSION || frame->abi != PF_ABI_VERSION) {
        fault |= PF_FAULT_VERSION;
    }
    for (role = 0U; role < PF_FLIGHT_ROLES; ++role) {
        if (frame->sizes[role] != pf_sizeof(role)) {
            fault |= PF_FAULT_LAYOUT;
        }
    }
    if (frame->frame_size != sizeof(pf_frame_t) || frame->record_size != sizeof(pf_record_t)) {
        fault |= PF_FAULT_LAYOUT;
    }
    if ((fault & PF_FAULT_LAYOUT) != 0U) {
        return fault;
    }
    third /= (PF_FLIGHT_REAL)3;
    here.value = third;
    there.value = frame->third;
    for (role = 0U; role < sizeof(PF_FLIGHT_REAL); ++role) {
        if (here.bytes[role] != there.bytes[role]) {
            fault |= PF_FAULT_REAL; /* such as the words of a double the other way round */
        }
    }
    if (frame->steps > room) {
        fault |= PF_FAULT_LENGTH;
    }
    return fault;
}

void pf_flight_begin(pf_flight_t *flight, const pf_frame_t *frame)
{
    flight->frame = frame;
    flight->period = 0U;
    flight->plant = frame->initial;
    (void)PF_INIT(&flight->state, &frame->params); /* the first step says what is wrong */
}

void pf_flight_measure(const pf_flight_t *flight, pf_record_t *record)
{
    const double now = (double)flight->period * flight->frame->sample_time;

    pf_measure(&flight->plant, (PF_FLIGHT_REAL)now, &record->input);
}

void pf_flight_control(pf_flight_t *flight, pf_record_t *record)
{
    record->status = (int32_t)PF_STEP(&flight->state, &flight->frame->params, &record->input,
        &record->output);
}

void pf_flight_advance(pf_flight_t *flight, pf_record_t *record)
{
    PF_PLANT_INPUT_T applied;

    record->state = flight->state;
    record->energy = PF_ENERGY(&flight->frame->plant, &flight->plant);
    pf_apply(&record->output, &applied);
    PF_PLANT_STEP(&flight->plant, &flight->frame->plant, &applied, flight->frame->plant_step,
        flight->frame->substeps);
    ++flight->period;
}

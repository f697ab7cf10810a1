/*
 * A whole flight inside one program: the generated controller and the generated plant, period by
 * period, as the host flies them. The host says in the first frame what it believes of the target;
 * a target that is different refuses to fly.
 *
 * A frame and a record are what lies in memory: structures of the target, in its byte order.
 */
#ifndef PF_FLIGHT_H
#define PF_FLIGHT_H

#include "pf_model.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifdef PF_SINGLE
#define PF_FLIGHT_REAL float
#else
#define PF_FLIGHT_REAL double
#endif

#define PF_FLIGHT_MAGIC UINT32_C(0x50664631)
#define PF_FLIGHT_ORDER UINT32_C(0x01020304)
#define PF_FLIGHT_VERSION 1U
#define PF_FLIGHT_ROLES 10U

/* Why a target refuses; bits of one word. The first three are those of pf_target_check. */
#define PF_FAULT_ROUNDING 0x01U  /* 1/3 is not rounded to nearest */
#define PF_FAULT_SUBNORMAL 0x02U /* subnormals are flushed to zero */
#define PF_FAULT_WIDTH 0x04U     /* a type has another width */
#define PF_FAULT_ORDER 0x08U     /* bytes are in another order than the host believes */
#define PF_FAULT_VERSION 0x10U   /* another version of this protocol, or of the generated code */
#define PF_FAULT_LAYOUT 0x20U    /* a structure has another size */
#define PF_FAULT_REAL 0x40U      /* a real number has other bits */
#define PF_FAULT_LENGTH 0x80U    /* more periods than there is room for, or a frame cut short */

/* The first frame: what the host believes, and the flight. */
typedef struct {
    uint32_t magic;
    uint32_t order;
    uint32_t version;
    uint32_t abi;
    uint32_t steps;
    uint32_t substeps;
    uint32_t sizes[PF_FLIGHT_ROLES];
    uint32_t frame_size;
    uint32_t record_size;
    double sample_time;         /* [s] */
    PF_FLIGHT_REAL plant_step;  /* [s] */
    PF_FLIGHT_REAL third;       /* 1/3 */
    PF_PARAMS_T params;
    PF_PLANT_PARAMS_T plant;
    PF_PLANT_STATE_T initial;
} pf_frame_t;

/* One period: what entered and left the controller, what it remembers, the plant's energy. */
typedef struct {
    PF_INPUT_T input;
    PF_OUTPUT_T output;
    PF_STATE_T state;
    PF_FLIGHT_REAL energy; /* [J] */
    int32_t status;
    uint32_t ticks; /* of the target's clock that the step took; 0 where it has none */
} pf_record_t;

/* A flight under way. */
typedef struct {
    const pf_frame_t *frame;
    uint32_t period;
    PF_STATE_T state;
    PF_PLANT_STATE_T plant;
} pf_flight_t;

/* Of pf_harness.c: what is wrong with the target's arithmetic, and the size of a structure. */
uint32_t pf_target_check(void);
uint32_t pf_sizeof(uint32_t role);

/* Returns what is wrong with `frame` on this target, which can hold `room` records; 0 if nothing. */
uint32_t pf_flight_check(const pf_frame_t *frame, uint32_t room);

/* Prepares a flight of a checked frame, which must live on. */
void pf_flight_begin(pf_flight_t *flight, const pf_frame_t *frame);

/* The parts of a period, in this order. Only the second is the controller's. */
void pf_flight_measure(const pf_flight_t *flight, pf_record_t *record);
void pf_flight_control(pf_flight_t *flight, pf_record_t *record);
void pf_flight_advance(pf_flight_t *flight, pf_record_t *record);

#ifdef __cplusplus
}
#endif

#endif

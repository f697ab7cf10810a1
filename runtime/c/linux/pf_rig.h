/*
 * What the periodic loop asks of a rig: six functions. pf_rig_simulated.c answers them with the
 * generated plant; for a real rig write a file with these six and link it instead.
 *
 * Each but the last returns 0, or an errno value where it failed: the loop then stops, torque off.
 */
#ifndef PF_RIG_H
#define PF_RIG_H

#include "pf_flight.h"

typedef struct pf_rig pf_rig_t;

/* Opens the rig, its motors off. The frame says where a simulated one starts; it must live on. */
int pf_rig_open(pf_rig_t **rig, const pf_frame_t *frame);
/* Measures, at the start of period number `period`. */
int pf_rig_read(pf_rig_t *rig, uint32_t period, PF_INPUT_T *measured);
/* Commands the torque of `output`, held until the next. */
int pf_rig_write(pf_rig_t *rig, const PF_OUTPUT_T *output);
/* Turns the motors on or off; may be called from another thread than the rest. */
int pf_rig_enable(pf_rig_t *rig, int on);
/* Tells the rig's own watchdog that the controller lives. */
int pf_rig_kick(pf_rig_t *rig);
/* Turns the motors off and closes the rig. */
void pf_rig_close(pf_rig_t *rig);

#endif

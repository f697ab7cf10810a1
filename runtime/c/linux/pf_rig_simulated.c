/* A rig that is the generated plant: time passes for it when a torque is commanded. */
#include "pf_rig.h"

#include "pf_arithmetic.h"

#include <errno.h>
#include <stddef.h>

struct pf_rig {
    const pf_frame_t *frame;
    PF_PLANT_STATE_T plant;
    int open, enabled; /* `enabled` is written by another thread too: atomically */
    uint32_t kicks;
};

static pf_rig_t the_rig; /* no heap after the start, and none here at all */

int pf_rig_open(pf_rig_t **rig, const pf_frame_t *frame)
{
    if (the_rig.open != 0) {
        return EBUSY;
    }
    the_rig.frame = frame;
    the_rig.plant = frame->initial;
    the_rig.open = 1;
    the_rig.kicks = 0U;
    __atomic_store_n(&the_rig.enabled, 0, __ATOMIC_RELEASE);
    *rig = &the_rig;
    return 0;
}

int pf_rig_read(pf_rig_t *rig, uint32_t period, PF_INPUT_T *measured)
{
    const double now = (double)period * rig->frame->sample_time;

    pf_measure(&rig->plant, (PF_FLIGHT_REAL)now, measured);
    return 0;
}

int pf_rig_write(pf_rig_t *rig, const PF_OUTPUT_T *output)
{
    static const PF_OUTPUT_T nothing;
    PF_PLANT_INPUT_T applied;

    pf_apply((__atomic_load_n(&rig->enabled, __ATOMIC_ACQUIRE) != 0) ? output : &nothing, &applied);
    PF_PLANT_STEP(&rig->plant, &rig->frame->plant, &applied, rig->frame->plant_step,
        rig->frame->substeps);
    return 0;
}

int pf_rig_enable(pf_rig_t *rig, int on)
{
    __atomic_store_n(&rig->enabled, on, __ATOMIC_RELEASE);
    return 0;
}

int pf_rig_kick(pf_rig_t *rig)
{
    ++rig->kicks;
    return 0;
}

void pf_rig_close(pf_rig_t *rig)
{
    (void)pf_rig_enable(rig, 0);
    rig->open = 0;
}

/*
 * The digital twin's inner loop: N rigs between two samples, each over its own number of substeps.
 *
 * It knows no model: pf_model.h, generated beside the plant, gives the names. A substep is one
 * Runge-Kutta step of the generated plant under a torque that is held. On its way to the shaft a
 * command passes the motor's limit, the converter, a delay of whole substeps, the drive's slew
 * limit and a first-order lag, whose exact mean over the substep acts. Compile with
 * -ffp-contract=off for the same bits on every machine.
 */
#include "pf_arithmetic.h"
#include "pf_elementary.h"
#include "pf_model.h"

#include <stdint.h>

#ifdef PF_SINGLE
#error "the twin's plant is of double precision"
#endif

#define TWO_PI 6.283185307179586
#define FARTHEST 1e6 /* beyond this coordinate or rate [SI] a rig is lost, and stays where it was */

#define MEMBERS(type) ((uint32_t)(sizeof(type) / sizeof(double)))
#define ACTUATORS MEMBERS(PF_PLANT_INPUT_T)
#define COORDINATES MEMBERS(PF_PLANT_RATE_T)

/* One drive: what it is, and what it remembers. */
typedef struct {
    double limit; /* of the motor [N m] */
    double quantum; /* of the converter [N m], 0 without one */
    double codes; /* the converter has codes -codes to codes - 1 */
    double slew; /* largest change a substep [N m] */
    double keep; /* e^(-h/tau), what the lag keeps over a substep */
    double mean; /* (1 - keep) tau/h, what it keeps in the mean */
    double held; /* command in force, limited and converted [N m] */
    double slewed; /* behind the slew limit [N m] */
    double torque; /* behind the lag [N m] */
    double applied; /* mean on the shaft in the last substep [N m] */
    uint32_t delay; /* substeps, below the length of the line */
    uint32_t lags; /* 0 for a drive without lag */
} pf_twin_drive_t;

typedef enum {
    PF_TWIN_HELD = 0, /* amplitude, from the first to before the last substep */
    PF_TWIN_SINE = 1, /* amplitude sin(2 pi turns) */
    PF_TWIN_IMPULSE = 2 /* amplitude is an impulse [N m s]: a jump of the rates at first */
} pf_twin_kind_t;

/* A generalised force from outside, on one coordinate. */
typedef struct {
    double amplitude;
    double frequency; /* turns a substep */
    double phase; /* turns */
    uint32_t kind;
    uint32_t first, last;
    uint32_t is_load; /* 1: subtracts from a parameter of the plant; 0: adds to an input */
    uint32_t index; /* of that parameter or input */
    uint32_t pad;
} pf_twin_force_t;

/* Dry friction on one coordinate, held over a substep. */
typedef struct {
    double coulomb; /* [N m] */
    double excess; /* stiction beyond it [N m] */
    double inverse_stribeck; /* [s] */
    double inverse_layer; /* [s] */
    uint32_t is_load, index; /* as above */
    uint32_t rate; /* index of the rate in the plant's state */
    uint32_t pad;
} pf_twin_friction_t;

/* What acts on a rig in one substep. */
typedef struct {
    PF_PLANT_PARAMS_T params;
    PF_PLANT_INPUT_T input;
} pf_twin_action_t;

uint32_t pf_twin_sizeof(uint32_t role);
void pf_twin_decay(uint32_t n, const double *ratio, double *keep, double *mean);
void pf_twin_advance(uint32_t n, const uint32_t *from, const uint32_t *count,
    const double *command, PF_PLANT_STATE_T *state, const PF_PLANT_PARAMS_T *params,
    pf_twin_drive_t *drive, double *line, uint32_t *lost, const double *step, uint32_t length,
    const pf_twin_force_t *forces, uint32_t force_count, const pf_twin_friction_t *frictions,
    uint32_t friction_count);

uint32_t pf_twin_sizeof(uint32_t role)
{
    static const uint32_t sizes[] = {
        (uint32_t)sizeof(pf_twin_drive_t), (uint32_t)sizeof(pf_twin_force_t),
        (uint32_t)sizeof(pf_twin_friction_t),
    };

    return (role < (uint32_t)(sizeof(sizes) / sizeof(sizes[0]))) ? sizes[role] : 0U;
}

/* What a lag keeps over a substep of `ratio` time constants, at its end and in the mean. */
void pf_twin_decay(uint32_t n, const double *ratio, double *keep, double *mean)
{
    uint32_t i;

    for (i = 0U; i < n; ++i) {
        keep[i] = pf_exp(-ratio[i]);
        mean[i] = -pf_expm1(-ratio[i]) / ratio[i];
    }
}

/* A command behind the motor's limit and the converter; 0 for what is no number. */
static double converted(const pf_twin_drive_t *drive, double command)
{
    double value = 0.0;

    if (command >= drive->limit) {
        value = drive->limit;
    } else if (command <= -drive->limit) {
        value = -drive->limit;
    } else if (command > -drive->limit) {
        value = command;
    }
    if (drive->quantum > 0.0) {
        double code = value / drive->quantum;

        code = (double)(int64_t)(code + ((code < 0.0) ? -0.5 : 0.5));
        code = (code > drive->codes - 1.0) ? drive->codes - 1.0 : code;
        code = (code < -drive->codes) ? -drive->codes : code;
        value = code * drive->quantum;
    }
    return value;
}

/* The mean torque of one drive in substep `at`. */
static double driven(pf_twin_drive_t *drive, double *line, uint32_t length, uint32_t at)
{
    double wanted, change, away;

    line[at % length] = drive->held;
    wanted = line[(at % length + length - drive->delay) % length];
    change = wanted - drive->slewed;
    if (change > drive->slew) {
        drive->slewed += drive->slew;
    } else if (change < -drive->slew) {
        drive->slewed -= drive->slew;
    } else {
        drive->slewed = wanted;
    }
    if (drive->lags == 0U) {
        drive->torque = drive->slewed;
        return drive->slewed;
    }
    away = drive->torque - drive->slewed;
    drive->torque = drive->slewed + away * drive->keep;
    return drive->slewed + away * drive->mean;
}

static void push(pf_twin_action_t *action, uint32_t is_load, uint32_t index, double force)
{
    if (is_load != 0U) {
        ((double *)&action->params)[index] -= force;
    } else {
        ((double *)&action->input)[index] += force;
    }
}

static double wave(const pf_twin_force_t *force, uint32_t at)
{
    double turns;

    if (force->kind != (uint32_t)PF_TWIN_SINE) {
        return force->amplitude;
    }
    turns = force->frequency * ((double)at + 0.5) + force->phase;
    turns -= (double)(int64_t)turns;
    return force->amplitude * pf_sin(TWO_PI * turns);
}

static double dry_friction(const pf_twin_friction_t *friction, double rate)
{
    const double slow = rate * friction->inverse_stribeck;
    const double side = rate * friction->inverse_layer;
    const double size = friction->coulomb + friction->excess / (1.0 + slow * slow);

    return size * ((side > 1.0) ? 1.0 : ((side < -1.0) ? -1.0 : side));
}

/* The jump M^-1 J of the rates: the plant's accelerations with J as a force, less those without. */
static void strike(const pf_twin_force_t *force, const pf_twin_action_t *action,
    PF_PLANT_STATE_T *state)
{
    pf_twin_action_t struck = *action;
    PF_PLANT_RATE_T with, without;
    uint32_t k;

    push(&struck, force->is_load, force->index, force->amplitude);
    PF_ACCELERATION(&struck.params, state, &struck.input, &with);
    PF_ACCELERATION(&action->params, state, &action->input, &without);
    for (k = 0U; k < COORDINATES; ++k) {
        ((double *)state)[COORDINATES + k] += ((double *)&with)[k] - ((double *)&without)[k];
    }
}

static int is_lost(const PF_PLANT_STATE_T *state)
{
    uint32_t k;

    for (k = 0U; k < MEMBERS(PF_PLANT_STATE_T); ++k) {
        const double value = ((const double *)state)[k];

        if (!((value <= FARTHEST) && (value >= -FARTHEST))) {
            return 1;
        }
    }
    return 0;
}

void pf_twin_advance(uint32_t n, const uint32_t *from, const uint32_t *count,
    const double *command, PF_PLANT_STATE_T *state, const PF_PLANT_PARAMS_T *params,
    pf_twin_drive_t *drive, double *line, uint32_t *lost, const double *step, uint32_t length,
    const pf_twin_force_t *forces, uint32_t force_count, const pf_twin_friction_t *frictions,
    uint32_t friction_count)
{
    uint32_t i, a, k, at;

    for (i = 0U; i < n; ++i) {
        const PF_PLANT_STATE_T before = state[i];
        pf_twin_drive_t *mine = &drive[i * ACTUATORS];

        for (a = 0U; a < ACTUATORS; ++a) {
            mine[a].held = converted(&mine[a], command[i * ACTUATORS + a]);
        }
        for (at = from[i]; (at < from[i] + count[i]) && (lost[i] == 0U); ++at) {
            pf_twin_action_t action;

            action.params = params[i];
            for (a = 0U; a < ACTUATORS; ++a) {
                mine[a].applied = driven(
                    &mine[a], &line[(i * ACTUATORS + a) * length], length, at);
                ((double *)&action.input)[a] = mine[a].applied;
            }
            for (k = 0U; k < force_count; ++k) {
                if ((at < forces[k].first) || (at >= forces[k].last)) {
                    continue;
                }
                if (forces[k].kind == (uint32_t)PF_TWIN_IMPULSE) {
                    strike(&forces[k], &action, &state[i]);
                } else {
                    push(&action, forces[k].is_load, forces[k].index, wave(&forces[k], at));
                }
            }
            for (k = 0U; k < friction_count; ++k) {
                push(&action, frictions[k].is_load, frictions[k].index,
                    -dry_friction(&frictions[k], ((double *)&state[i])[frictions[k].rate]));
            }
            PF_PLANT_STEP(&state[i], &action.params, &action.input, *step, 1U);
            if (is_lost(&state[i])) {
                state[i] = before;
                lost[i] = 1U;
            }
        }
    }
}

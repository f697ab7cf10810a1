#include "hand.h"

#ifdef HAND_LIBM
#include <math.h>
#define ARCTAN atan
#define ROOT sqrt
static void sine_cosine(double x, double *sine, double *cosine)
{
    *sine = sin(x);
    *cosine = cos(x);
}
#else
#include "pf_elementary_unit.h" /* the functions themselves, so that calls can be inlined */
#define ARCTAN pf_atan
#define ROOT pf_sqrt
#define sine_cosine pf_sincos
#endif

/* a b + c, and c - a b: fused where that is one instruction. */
#if defined(__powerpc__) || defined(__FMA__)
#define MADD(a, b, c) __builtin_fma(a, b, c)
#define MINUS(c, a, b) (-__builtin_fma(a, b, -(c)))
#else
#define MADD(a, b, c) ((a) * (b) + (c))
#define MINUS(c, a, b) ((c) - (a) * (b))
#endif

#ifdef HAND_CHECKED /* within the checked ranges the functions need not look at their argument */
#undef ARCTAN
#undef sine_cosine
#define ARCTAN pf_atan_inline
#define sine_cosine pf_sincos_within_inline
#define LENGTH(a, b) pf_sqrt_normal_inline(MADD(a, a, MADD(b, b, 0x1p-120)))
#else
#define LENGTH(a, b) ROOT(MADD(a, a, (b) * (b)))
#endif

void hand_init(hand_law_t *law, const hand_params_t *p)
{
    law->q1d = p->q1d;
    law->q2d = p->q2d;
    law->lam = p->lam;
    law->lam2 = p->lam2;
    law->lam_lam1 = p->lam * p->lam1;
    law->sigma = p->sigma;
    law->arctan_gain = 2.0 * p->eta / 3.14159265358979323846;
    law->theta3 = p->theta3;
    law->row1 = p->theta2 * (p->lam - 1.0);
    law->row2 = p->theta1 + p->theta2 - p->theta2 * p->lam;
    law->row2_slope = 2.0 - p->lam;
    law->theta1_theta2 = p->theta1 * p->theta2;
    law->gravity1 = p->theta4 * p->g;
    law->gravity2 = p->theta5 * p->g;
    law->half_period = 0.5 * p->sample_time;
    law->period = p->sample_time;
    law->kappa = p->kappa;
    law->epsilon = p->epsilon;
    law->epsilon_inverse = 1.0 / p->epsilon;
    law->torque_limit = p->torque_limit;
    law->torque_step = p->sample_time * p->slew_limit;
    law->singular_threshold = p->singular_threshold;
    law->threshold_squared = p->singular_threshold * p->singular_threshold;
    law->leakage_decay = p->leakage_decay;
    law->adaptation_step = p->adaptation_step;
}

#ifdef HAND_CHECKED
static int refused(hand_output_t *output, int code)
{
    output->tau = output->p1 = output->p2 = output->p3 = 0.0;
    output->s = output->beta = output->adb = 0.0;
    return code;
}

int hand_step(
    hand_state_t *state, const hand_law_t *law, const hand_input_t *input, hand_output_t *output)
#else
int hand_step(
    hand_state_t *state, const hand_law_t *law, const hand_input_t *input, double *torque)
#endif
{
#ifdef HAND_CHECKED
    if (!(__builtin_fabs(input->q1) < HAND_LARGEST_ANGLE
            && __builtin_fabs(input->q2) < HAND_LARGEST_ANGLE
            && __builtin_fabs(input->dq1) < HAND_LARGEST_RATE
            && __builtin_fabs(input->dq2) < HAND_LARGEST_RATE)) {
        return refused(output, HAND_BAD_INPUT);
    }
#endif
    double sin1, cos1, sin2, cos2;
    const double dq1 = input->dq1, dq2 = input->dq2;
    const double e1 = input->q1 - law->q1d, e2 = input->q2 - law->q2d;

    /* Servo-constraint, (3), its decay, (2), and the regressor, (47). */
    const double coasting = MADD(law->lam, dq1, dq2);
    const double s = MADD(law->lam_lam1, e1, MADD(law->lam2, e2, coasting));
    const double drift = MADD(law->arctan_gain, ARCTAN(s), law->sigma * s);
    const double distance = 1.0 + LENGTH(e1, e2);
    const double speed = 1.0 + LENGTH(dq1, dq2);
    const double regressor = MADD(distance, distance, speed * speed);

    /* det M (A D B) and det M (b + A D (C q' + G)); A q' needs only the rates. */
    sine_cosine(input->q1, &sin1, &cos1);
    sine_cosine(input->q2, &sin2, &cos2);
    const double x = law->theta3 * cos2, h = law->theta3 * sin2;
    const double gravity12 = law->gravity2 * MINUS(cos1 * cos2, sin1, sin2);
    const double bias1 = MINUS(MADD(law->gravity1, cos1, gravity12), h * dq2, dq1 + dq1 + dq2);
    const double bias2 = MADD(h * dq1, dq1, gravity12);
    const double det = MINUS(law->theta1_theta2, x, x);
    const double n1 = law->row1 - x, n2 = MADD(law->row2_slope, x, law->row2);
    const double wanted = MADD(law->lam_lam1, dq1, MADD(law->lam2, dq2, drift));
    const double demand = MADD(n1, bias1, MINUS(n2 * bias2, det, wanted));
    const double adb = n1 / det;

    /* p1, (17); next to ADB = 0 it is scaled down. */
    const int near_singular = __builtin_fabs(adb) < law->singular_threshold;
    const double p1 = near_singular ? adb * demand / (det * law->threshold_squared) : demand / n1;
    double total = p1;

    /* p2 + p3, (18), (19): backward Euler on beta, inside or outside the layer of p3. */
    const double offset = state->engaged
        ? MADD(law->half_period, drift + state->drift_previous, state->constraint_offset)
        : -s;
    const double beta = offset + s;
    const double bhat = adb * beta;
    const double effort = state->bound_estimate * regressor;
    const double rate = law->period * (adb * adb);
    double gain = MADD(effort * effort, law->epsilon_inverse, law->kappa);
    double numerator = bhat, denominator = MADD(rate, gain, 1.0);
    const int outside = effort * __builtin_fabs(bhat) > law->epsilon * denominator;
    const double push = bhat < 0.0 ? -effort : effort;
    if (outside) {
        gain = law->kappa;
        total -= push;
        numerator = MINUS(bhat, rate, push);
        denominator = MADD(rate, gain, 1.0);
    }
    const double bhat_next = numerator / denominator;
    total = MINUS(total, gain, bhat_next);

    /* What the motor can reach within a period; the torque limit comes last. */
    const double least = state->tau_previous - law->torque_step;
    const double most = state->tau_previous + law->torque_step;
    const int slewing = total < least || total > most;
    const double slewed = total < least ? least : total > most ? most : total;

#ifdef HAND_CHECKED
    /* A finite total vouches for p1, p2, p3, s, beta, ADB and the offset: all of them enter it. */
    const double magnitude = __builtin_fabs(slewed), bound = law->torque_limit;
    if (!(bound > 0.0)) {
        return refused(output, HAND_BAD_PARAMETER);
    }
    const double command = magnitude > bound ? (slewed < 0.0 ? -bound : bound) : slewed;
    if (!(__builtin_fabs(total) <= 0x1.fffffffffffffp+1023
            && __builtin_fabs(command) <= 0x1.fffffffffffffp+1023)) {
        return refused(output, HAND_NUMERIC);
    }
    const int saturated = slewing || magnitude > bound;
    if (saturated) {
        if (!state->engaged) {
            state->constraint_offset = offset;
        }
    } else {
        const double estimate = MADD(law->leakage_decay, state->bound_estimate,
            law->adaptation_step * regressor * __builtin_fabs(bhat_next));
        if (!(estimate <= 0x1.fffffffffffffp+1023)) {
            return refused(output, HAND_NUMERIC);
        }
        state->constraint_offset = offset;
        state->bound_estimate = estimate;
    }
    output->tau = state->tau_previous = command;
    output->p1 = p1;
    output->p2 = -law->kappa * bhat_next;
    output->p3 = outside ? -push : -(effort * effort * law->epsilon_inverse) * bhat_next;
    output->s = s;
    output->beta = beta;
    output->adb = adb;
    state->drift_previous = drift;
    state->engaged = 1u;
    return near_singular ? HAND_NEAR_SINGULAR : saturated ? HAND_SATURATED : HAND_OK;
#else
    /* Saturation holds integral and adaptation. What is not finite came from the input. */
    const double size = __builtin_fabs(slewed), limit = law->torque_limit;
    if (!(__builtin_fabs(total) <= 1e300)) {
        *torque = 0.0;
        return 1;
    }
    *torque = size > limit ? (slewed < 0.0 ? -limit : limit) : slewed;
    if (slewing || size > limit) {
        if (!state->engaged) {
            state->constraint_offset = offset;
        }
    } else {
        state->constraint_offset = offset;
        state->bound_estimate = MADD(law->leakage_decay, state->bound_estimate,
            law->adaptation_step * regressor * __builtin_fabs(bhat_next));
    }
    state->tau_previous = *torque;
    state->drift_previous = drift;
    state->engaged = 1u;
    return 0;
#endif
}

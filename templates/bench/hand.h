/*
 * The Pendubot's balance step as a careful engineer writes it by hand: the bar for generated code.
 *
 * The law is the sampled one of docs/sampled-law.md; equation numbers are those of the paper.
 */
#ifndef HAND_H
#define HAND_H

#include <stdint.h>

/* Parameters, SI units; names as in the paper. */
typedef struct {
    double theta1, theta2, theta3, theta4, theta5, g;
    double lam, lam1, lam2, sigma, eta, kappa, epsilon;
    double q1d, q2d, sample_time, torque_limit, slew_limit, singular_threshold;
    double leakage_decay, adaptation_step; /* e^(-k2 T) and k1 (1 - e^(-k2 T))/k2 */
} hand_params_t;

/* What depends on the parameters alone, worked out once. */
typedef struct {
    double q1d, q2d;
    double lam, lam2, lam_lam1; /* s = q2' + lam2 e2 + lam q1' + lam lam1 e1 */
    double sigma, arctan_gain; /* drift = sigma s + (2 eta/pi) arctan s */
    double theta3;
    double row1, row2, row2_slope; /* A adj M = (row1 - x, row2 + row2_slope x), x = theta3 cos q2 */
    double theta1_theta2;
    double gravity1, gravity2; /* theta4 g, theta5 g */
    double half_period, period;
    double kappa, epsilon, epsilon_inverse;
    double torque_limit, torque_step, singular_threshold, threshold_squared;
    double leakage_decay, adaptation_step;
} hand_law_t;

/* What the controller remembers. */
typedef struct {
    double constraint_offset; /* beta - s */
    double drift_previous;
    double bound_estimate; /* ahat */
    double tau_previous; /* torque last commanded */
    uint32_t engaged;
} hand_state_t;

typedef struct {
    double q1, q2, dq1, dq2;
} hand_input_t;

void hand_init(hand_law_t *law, const hand_params_t *params);

#ifdef HAND_CHECKED
/* Everything that the generated step gives. */
typedef struct {
    double tau, p1, p2, p3, s, beta, adb;
} hand_output_t;

/* In the order of the generated step's codes. */
enum { HAND_OK, HAND_SATURATED, HAND_NEAR_SINGULAR, HAND_BAD_INPUT, HAND_BAD_PARAMETER, HAND_NUMERIC };

/* Beyond these a measurement is refused. */
#define HAND_LARGEST_ANGLE 1e4
#define HAND_LARGEST_RATE 1e3

/*
 * One period under the contract of the generated step: a code above HAND_NEAR_SINGULAR comes with
 * zero outputs and the state kept, any other with finite outputs and a torque within its limit.
 */
int hand_step(
    hand_state_t *state, const hand_law_t *law, const hand_input_t *input, hand_output_t *output);
#else
/* One period. Returns 0, or 1 with torque 0 and the state kept if an input is not finite. */
int hand_step(
    hand_state_t *state, const hand_law_t *law, const hand_input_t *input, double *torque);
#endif

#endif

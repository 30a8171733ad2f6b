/* The vibration motor's equations: Eq. (13) with set-valued Coulomb friction, Eq. (14) with
 * saturation and anti-windup. Symbols are the paper's, units SI and radians. How they are integrated
 * is integrate.h, what changes at events of an external solver events.h.
 *
 * This file knows nothing of FMI: it is the kernel that the shims drive. A Motor is plain data, so
 * that a copy of it is its whole state. Floating-point contraction must be off (see the flags in
 * fmus/compiler.py): then every platform computes the same bits up to its libm's sine. */
#ifndef MOTOR_H
#define MOTOR_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "variables.h"

enum Solver { SOLVER_SEMI_IMPLICIT_EULER = 1, SOLVER_RK4 = 2 };

typedef struct {
    union {
        struct { INPUT_FIELDS };
        double input[INPUT_COUNT];
    };
    union {
        struct { PARAMETER_FIELDS };
        double parameter[PARAMETER_COUNT];
    };
    double theta;     /* rad, 0 when the eccentric mass hangs straight down */
    double omega;     /* rad/s */
    double integral;  /* rad, of the speed error */
    double sin_theta; /* of theta: one sine a step serves the step and the outputs */

    /* Time is the importer's number, never a sum of steps: rounding does not accumulate. */
    double time; /* s */
    double owed; /* s of the communication steps that the integration is behind, or ahead if < 0 */

    /* Derived from the parameters by motor_initialise. */
    double torque_per_volt; /* K_T / R */
    double damping;         /* b + K_T^2 / R: viscous friction and back-EMF */
    double weight_torque;   /* m g r */
    double inverse_J;

    int32_t closed_loop;
    int32_t solver;

    /* Model Exchange: an external solver integrates between events and the modes hold still. */
    int32_t modes_held;
    int32_t friction;   /* sign of the sliding speed, 0 while the shaft sticks */
    int32_t saturation; /* sign of the voltage limit that the command is beyond, else 0 */
    int32_t jumped;     /* 1 once an input is set in Event Mode, until the update tells of it */
} Motor;

static inline double motor_sign(double x) { return (x > 0.0) - (x < 0.0); }

static inline void motor_set_state(Motor *s, double theta, double omega, double integral) {
    s->theta = theta;
    s->omega = omega;
    s->integral = integral;
    s->sin_theta = sin(theta);
}

/* What follows from parameters and state. */
static inline void motor_derive(Motor *s) {
    s->torque_per_volt = s->K_T / s->R;
    s->damping = s->b + s->K_T * s->K_T / s->R;
    s->weight_torque = s->m * s->g * s->r;
    s->inverse_J = 1.0 / s->J;
    s->sin_theta = sin(s->theta);
}

/* Put the parameters into force and the state to its start. */
static inline void motor_initialise(Motor *s) {
    motor_derive(s);
    motor_set_state(s, s->theta_start, s->omega_start, 0.0);
}

/* The equations, at a given speed and integral. */

/* Speed error that the controller sees. */
static inline double motor_error(const Motor *s, double omega) {
    return s->omega_des - (omega + s->omega_noise);
}

/* Voltage command before saturation. */
static inline double motor_command(const Motor *s, double omega, double integral) {
    /* Eq. (14) */
    return s->closed_loop ? s->K_p * motor_error(s, omega) + s->K_i * integral : s->V_in;
}

static inline double motor_saturate(const Motor *s, double u) {
    return u > s->V_s_max ? s->V_s_max : u < -s->V_s_max ? -s->V_s_max : u;
}

/* Sign of the limit that the command is beyond, 0 within the limits. */
static inline double motor_saturation(const Motor *s, double u) {
    return (u > s->V_s_max) - (u < -s->V_s_max);
}

/* Rate of the integral. Conditional integration: it holds while the command is beyond the limit
 * and the error would push it further out. */
static inline double motor_integral_rate(const Motor *s, double omega, double saturation) {
    const double error = motor_error(s, omega);
    return s->closed_loop && !(saturation * error > 0.0) ? error : 0.0;
}

/* Every torque on the shaft but Coulomb friction. */
static inline double motor_drive_torque(const Motor *s, double sin_theta, double omega, double V_s) {
    return s->torque_per_volt * V_s - s->damping * omega - s->weight_torque * sin_theta + s->d;
}

/* sgn(omega) of Eq. (13), set-valued at rest: 0 while the torque cannot overcome the friction. */
static inline double motor_direction(const Motor *s, double omega, double drive_torque) {
    if (omega != 0.0)
        return motor_sign(omega);
    return fabs(drive_torque) <= s->c ? 0.0 : motor_sign(drive_torque);
}

static inline double motor_acceleration(const Motor *s, double drive_torque, double direction) {
    /* Eq. (13), sgn(0) set-valued: at rest friction balances any torque up to c. */
    return direction == 0.0 ? 0.0 : (drive_torque - s->c * direction) * s->inverse_J;
}

/* What follows is at the present state, inputs and, where they are held, modes. */

static inline double motor_present_command(const Motor *s) {
    return motor_command(s, s->omega, s->integral);
}

static inline double motor_voltage(const Motor *s) {
    return motor_saturate(s, motor_present_command(s));
}

static inline double motor_current(const Motor *s) {
    return (motor_voltage(s) - s->K_T * s->omega) / s->R;
}

static inline double motor_present_torque(const Motor *s) {
    return motor_drive_torque(s, s->sin_theta, s->omega, motor_voltage(s));
}

static inline double motor_present_direction(const Motor *s) {
    return s->modes_held ? s->friction : motor_direction(s, s->omega, motor_present_torque(s));
}

static inline double motor_present_saturation(const Motor *s) {
    return s->modes_held ? s->saturation : motor_saturation(s, motor_present_command(s));
}

static inline double motor_omega_dot(const Motor *s) {
    return motor_acceleration(s, motor_present_torque(s), motor_present_direction(s));
}

static inline double motor_integral_dot(const Motor *s) {
    return motor_integral_rate(s, s->omega, motor_present_saturation(s));
}

#endif

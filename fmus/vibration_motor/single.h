/* One motor with its state, as the FMU VibrationMotor holds it, and the equations of motor.h at its
 * present state, inputs and, where they are held, modes. How it is integrated is integrate.h, what
 * changes at events of an external solver events.h. */
#ifndef SINGLE_H
#define SINGLE_H

#include "motor.h"

enum Solver { SOLVER_SEMI_IMPLICIT_EULER = 1, SOLVER_RK4 = 2 };

/* Plain data: a copy of it is its whole state. */
typedef struct {
    MotorInputs in;
    MotorConstants p;
    MotorState x;
    double sin_theta; /* one sine a step serves the step and the outputs */

    /* Model Exchange: an external solver integrates between events and the modes hold still. */
    int32_t modes_held;
    int32_t friction;   /* sign of the sliding speed, 0 while the shaft sticks */
    int32_t saturation; /* sign of the voltage limit that the command is beyond, else 0 */
    int32_t jumped;     /* 1 once an input is set in Event Mode, until the update tells of it */
} Motor;

static inline void single_set_state(Motor *s, MotorState x) {
    s->x = x;
    s->sin_theta = sine(x.theta);
}

/* What follows from parameters and state. */
static inline void single_derive(Motor *s) {
    motor_derive(&s->p);
    single_set_state(s, s->x);
}

/* Put the parameters into force and the state to its start. */
static inline void single_initialise(Motor *s) {
    s->x = motor_start(&s->p);
    single_derive(s);
}

static inline double single_command(const Motor *s) {
    return motor_command(&s->p, &s->in, s->x.omega, s->x.integral);
}

static inline double single_voltage(const Motor *s) {
    return motor_saturate(&s->p, single_command(s));
}

static inline double single_current(const Motor *s) {
    return motor_current(&s->p, s->x.omega, single_voltage(s));
}

static inline double single_torque(const Motor *s) {
    return motor_drive(&s->p, &s->in, s->x, s->sin_theta).torque;
}

static inline double single_direction(const Motor *s) {
    return s->modes_held ? s->friction : motor_direction(&s->p, s->x.omega, single_torque(s));
}

static inline double single_saturation(const Motor *s) {
    return s->modes_held ? s->saturation : motor_saturation(&s->p, single_command(s));
}

static inline double single_omega_dot(const Motor *s) {
    return motor_acceleration(&s->p, single_torque(s), single_direction(s));
}

static inline double single_integral_dot(const Motor *s) {
    return motor_integral_rate(&s->p, &s->in, s->x.omega, single_saturation(s));
}

#endif

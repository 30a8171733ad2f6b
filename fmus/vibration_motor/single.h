/* One motor with its state, as the FMU VibrationMotor holds it: the equations of motor.h at its
 * present state and inputs, and its integration at a fixed internal step by semi-implicit Euler or
 * RK4. */
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

static inline double single_omega_dot(const Motor *s) {
    const double torque = motor_drive(&s->p, &s->in, s->x, s->sin_theta).torque;
    return motor_acceleration(&s->p, torque, motor_direction(&s->p, s->x.omega, torque));
}

static inline void single_step_euler(Motor *s, double h) {
    const MotorDrive drive = motor_drive(&s->p, &s->in, s->x, s->sin_theta);
    single_set_state(s, motor_euler(&s->p, s->x, drive, h));
}

static inline MotorState single_rate(const Motor *s, MotorState y, double direction) {
    const MotorDrive drive = motor_drive(&s->p, &s->in, y, sine(y.theta));
    return (MotorState){y.omega, motor_acceleration(&s->p, drive.torque, direction),
                        drive.integral_rate};
}

static inline MotorState motor_along(MotorState y, double h, MotorState rate) {
    return (MotorState){y.theta + h * rate.theta, y.omega + h * rate.omega,
                        y.integral + h * rate.integral};
}

/* Classical Runge-Kutta step of the smooth motion in one direction of friction. */
static MotorState single_rk4(const Motor *s, MotorState y, double direction, double h) {
    const MotorState k1 = single_rate(s, y, direction);
    const MotorState k2 = single_rate(s, motor_along(y, 0.5 * h, k1), direction);
    const MotorState k3 = single_rate(s, motor_along(y, 0.5 * h, k2), direction);
    const MotorState k4 = single_rate(s, motor_along(y, h, k3), direction);
    const MotorState slope = {
        (k1.theta + 2.0 * (k2.theta + k3.theta) + k4.theta) / 6.0,
        (k1.omega + 2.0 * (k2.omega + k3.omega) + k4.omega) / 6.0,
        (k1.integral + 2.0 * (k2.integral + k3.integral) + k4.integral) / 6.0,
    };
    return motor_along(y, h, slope);
}

/* Longest step up to h, to the last bit, that keeps the shaft turning in the direction. */
static double single_time_to_standstill(const Motor *s, MotorState y, double direction, double h) {
    double turning = 0.0, reversed = h;
    for (;;) {
        const double middle = 0.5 * (turning + reversed);
        if (middle <= turning || middle >= reversed)
            return turning;
        if (single_rk4(s, y, direction, middle).omega * direction > 0.0)
            turning = middle;
        else
            reversed = middle;
    }
}

/* One step of RK4 that stops at standstill and continues from there: sticking or reversing. */
static void single_step_rk4(Motor *s, double h) {
    enum { MOST_STANDSTILLS = 4 }; /* in one step; more would be rattling about rest: it sticks */
    MotorState y = s->x;
    double left = h;
    for (int standstill = 0; standstill < MOST_STANDSTILLS; standstill++) {
        const MotorDrive drive = motor_drive(&s->p, &s->in, y, sine(y.theta));
        const double direction = motor_direction(&s->p, y.omega, drive.torque);
        if (direction == 0.0)
            break;
        const MotorState next = single_rk4(s, y, direction, left);
        if (next.omega * direction > 0.0) {
            single_set_state(s, next);
            return;
        }
        const double before = single_time_to_standstill(s, y, direction, left);
        y = single_rk4(s, y, direction, before);
        y.omega = 0.0;
        left -= before;
    }
    y.omega = 0.0;
    y.integral += left * motor_drive(&s->p, &s->in, y, sine(y.theta)).integral_rate;
    single_set_state(s, y);
}

static inline void single_step(Motor *s, double h) {
    if (s->p.solver == SOLVER_SEMI_IMPLICIT_EULER)
        single_step_euler(s, h);
    else
        single_step_rk4(s, h);
}

#endif

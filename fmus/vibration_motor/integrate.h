/* Integration of motor.h at a fixed internal step, for co-simulation: semi-implicit Euler and RK4. */
#ifndef INTEGRATE_H
#define INTEGRATE_H

#include "motor.h"


/* One step of semi-implicit Euler; friction as a proximal step, which stops exactly at 0. */
static inline void motor_step_euler(Motor *s, double h) {
    const double u = motor_command(s, s->omega, s->integral);
    const double torque = motor_drive_torque(s, s->sin_theta, s->omega, motor_saturate(s, u));
    const double free = s->omega + h * s->inverse_J * torque;
    const double friction = h * s->inverse_J * s->c;
    s->integral += h * motor_integral_rate(s, s->omega, motor_saturation(s, u));
    s->omega = free > friction ? free - friction : free < -friction ? free + friction : 0.0;
    s->theta += h * s->omega;
    s->sin_theta = sin(s->theta);
}

typedef struct {
    double theta, omega, integral;
} MotorState;

static inline MotorState motor_rate(const Motor *s, MotorState y, double direction) {
    const double u = motor_command(s, y.omega, y.integral);
    const double torque = motor_drive_torque(s, sin(y.theta), y.omega, motor_saturate(s, u));
    return (MotorState){y.omega, (torque - s->c * direction) * s->inverse_J,
                        motor_integral_rate(s, y.omega, motor_saturation(s, u))};
}

static inline MotorState motor_along(MotorState y, double h, MotorState rate) {
    return (MotorState){y.theta + h * rate.theta, y.omega + h * rate.omega,
                        y.integral + h * rate.integral};
}

/* Classical Runge-Kutta step of the smooth motion in one direction of friction. */
static MotorState motor_rk4(const Motor *s, MotorState y, double direction, double h) {
    const MotorState k1 = motor_rate(s, y, direction);
    const MotorState k2 = motor_rate(s, motor_along(y, 0.5 * h, k1), direction);
    const MotorState k3 = motor_rate(s, motor_along(y, 0.5 * h, k2), direction);
    const MotorState k4 = motor_rate(s, motor_along(y, h, k3), direction);
    const MotorState slope = {
        (k1.theta + 2.0 * (k2.theta + k3.theta) + k4.theta) / 6.0,
        (k1.omega + 2.0 * (k2.omega + k3.omega) + k4.omega) / 6.0,
        (k1.integral + 2.0 * (k2.integral + k3.integral) + k4.integral) / 6.0,
    };
    return motor_along(y, h, slope);
}

/* Longest step up to h, to the last bit, that keeps the shaft turning in the direction. */
static double motor_time_to_standstill(const Motor *s, MotorState y, double direction, double h) {
    double turning = 0.0, reversed = h;
    for (;;) {
        const double middle = 0.5 * (turning + reversed);
        if (middle <= turning || middle >= reversed)
            return turning;
        if (motor_rk4(s, y, direction, middle).omega * direction > 0.0)
            turning = middle;
        else
            reversed = middle;
    }
}

/* One step of RK4 that stops at standstill and goes on from there: sticking or reversing. */
static void motor_step_rk4(Motor *s, double h) {
    enum { MOST_STANDSTILLS = 4 }; /* in one step; more would be rattling about rest: it sticks */
    MotorState y = {s->theta, s->omega, s->integral};
    double left = h;
    for (int standstill = 0; standstill < MOST_STANDSTILLS; standstill++) {
        const double u = motor_command(s, y.omega, y.integral);
        const double torque = motor_drive_torque(s, sin(y.theta), y.omega, motor_saturate(s, u));
        const double direction = motor_direction(s, y.omega, torque);
        if (direction == 0.0)
            break;
        const MotorState next = motor_rk4(s, y, direction, left);
        if (next.omega * direction > 0.0) {
            motor_set_state(s, next.theta, next.omega, next.integral);
            return;
        }
        const double before = motor_time_to_standstill(s, y, direction, left);
        y = motor_rk4(s, y, direction, before);
        y.omega = 0.0;
        left -= before;
    }
    const double u = motor_command(s, 0.0, y.integral);
    motor_set_state(s, y.theta, 0.0, y.integral + left * motor_integral_rate(s, 0.0, motor_saturation(s, u)));
}

static inline void motor_step(Motor *s, double h) {
    if (s->solver == SOLVER_SEMI_IMPLICIT_EULER)
        motor_step_euler(s, h);
    else
        motor_step_rk4(s, h);
}

#endif

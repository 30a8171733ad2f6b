/* The vibration motor: Eq. (13) with set-valued Coulomb friction, Eq. (14) with saturation and
 * anti-windup, and their integration. Symbols are the paper's, units SI and radians.
 *
 * This file knows nothing of FMI: it is the kernel that the shims drive. A Motor is plain data, so
 * that a copy of it is its whole state. Floating-point contraction must be off (see the flags in
 * fmus/build.py): then every platform computes the same bits up to its libm's sine. */
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
    int32_t closed_loop;
    int32_t solver;

    double theta;     /* rad, 0 when the eccentric mass hangs straight down */
    double omega;     /* rad/s */
    double integral;  /* rad, of the speed error */
    double sin_theta; /* of theta: one sine a step serves the step and the outputs */

    /* Time is base_time + steps * step_size: whole steps never accumulate rounding. */
    double base_time;
    int64_t steps;

    /* Derived from the parameters by motor_initialise. */
    double torque_per_volt; /* K_T / R */
    double damping;         /* b + K_T^2 / R: viscous friction and back-EMF */
    double weight_torque;   /* m g r */
    double inverse_J;
} Motor;

static inline double motor_sign(double x) { return (x > 0.0) - (x < 0.0); }

static inline double motor_time(const Motor *s) {
    return s->base_time + (double)s->steps * s->step_size;
}

static inline void motor_set_state(Motor *s, double theta, double omega, double integral) {
    s->theta = theta;
    s->omega = omega;
    s->integral = integral;
    s->sin_theta = sin(theta);
}

/* Put the parameters into force and the state to its start. */
static inline void motor_initialise(Motor *s) {
    s->torque_per_volt = s->K_T / s->R;
    s->damping = s->b + s->K_T * s->K_T / s->R;
    s->weight_torque = s->m * s->g * s->r;
    s->inverse_J = 1.0 / s->J;
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

/* Rate of the integral. Conditional integration: it holds while the command is beyond the limit
 * and the error would push it further out. */
static inline double motor_integral_rate(const Motor *s, double omega, double u) {
    if (!s->closed_loop)
        return 0.0;
    const double error = motor_error(s, omega);
    if ((u > s->V_s_max && error > 0.0) || (u < -s->V_s_max && error < 0.0))
        return 0.0;
    return error;
}

/* Every torque on the shaft but Coulomb friction. */
static inline double motor_drive_torque(const Motor *s, double sin_theta, double omega, double V_s) {
    return s->torque_per_volt * V_s - s->damping * omega - s->weight_torque * sin_theta + s->d;
}

/* sgn(omega) of Eq. (13), set-valued at rest: 0 while the torque cannot overcome the friction. */
static inline double motor_friction_sign(const Motor *s, double omega, double drive_torque) {
    if (omega != 0.0)
        return motor_sign(omega);
    return fabs(drive_torque) <= s->c ? 0.0 : motor_sign(drive_torque);
}

static inline double motor_acceleration(const Motor *s, double omega, double drive_torque) {
    const double direction = motor_friction_sign(s, omega, drive_torque);
    /* Eq. (13), sgn(0) set-valued: at rest friction balances any torque up to c. */
    return direction == 0.0 ? 0.0 : (drive_torque - s->c * direction) * s->inverse_J;
}

/* The outputs, at the present state and inputs. */

static inline double motor_voltage(const Motor *s) {
    return motor_saturate(s, motor_command(s, s->omega, s->integral));
}

static inline double motor_omega_dot(const Motor *s) {
    const double torque = motor_drive_torque(s, s->sin_theta, s->omega, motor_voltage(s));
    return motor_acceleration(s, s->omega, torque);
}

static inline double motor_current(const Motor *s) {
    return (motor_voltage(s) - s->K_T * s->omega) / s->R;
}

/* The integration. */

/* One step of semi-implicit Euler; friction as a proximal step, which stops exactly at 0. */
static inline void motor_step_euler(Motor *s, double h) {
    const double u = motor_command(s, s->omega, s->integral);
    const double torque = motor_drive_torque(s, s->sin_theta, s->omega, motor_saturate(s, u));
    const double free = s->omega + h * s->inverse_J * torque;
    const double friction = h * s->inverse_J * s->c;
    s->integral += h * motor_integral_rate(s, s->omega, u);
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
                        motor_integral_rate(s, y.omega, u)};
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
        const double direction = motor_friction_sign(s, y.omega, torque);
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
    motor_set_state(s, y.theta, 0.0, y.integral + left * motor_integral_rate(s, 0.0, u));
}

static inline void motor_step(Motor *s, double h) {
    if (s->solver == SOLVER_SEMI_IMPLICIT_EULER)
        motor_step_euler(s, h);
    else
        motor_step_rk4(s, h);
}

#endif

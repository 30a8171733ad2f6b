/* The vibration motor's equations: Eq. (13) with set-valued Coulomb friction, Eq. (14) with
 * saturation and anti-windup, and the step of semi-implicit Euler. Symbols are the paper's, units SI
 * and radians.
 *
 * This file knows nothing of FMI and keeps nothing: every function makes values from values, so that
 * the same ones serve one motor (single.h) and arrays of them (lanes.h). There are no branches that
 * a select cannot stand for. Floating-point contraction must be off (see the flags in
 * fmus/compiler.py): then every platform computes the same bits. */
#ifndef MOTOR_H
#define MOTOR_H

#include "sine.h"
#include "variables.h"

/* rad/s; beyond it derivatives and outputs overflow. */
#define MOST_SPEED 1e100

typedef union {
    struct { INPUT_FIELDS };
    double value[INPUT_COUNT];
} MotorInputs;

typedef struct {
    union {
        struct { PARAMETER_FIELDS };
        double value[PARAMETER_COUNT];
    };
    /* What follows from them; see motor_derive. */
    double torque_per_volt; /* K_T / R */
    double damping;         /* b + K_T^2 / R: viscous friction and back-EMF */
    double weight_torque;   /* m g r */
    double inverse_J;
    int32_t closed_loop;
    int32_t solver;
} MotorConstants;

typedef struct {
    double theta;    /* rad, 0 when the eccentric mass hangs straight down */
    double omega;    /* rad/s */
    double integral; /* rad, of the speed error */
} MotorState;

/* What moves the state on: every torque on the shaft but Coulomb friction, and the integral's rate. */
typedef struct {
    double torque;
    double integral_rate;
} MotorDrive;

INLINE double motor_sign(double x) { return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : 0.0; }

/* Put changed parameters into force. */
INLINE void motor_derive(MotorConstants *p) {
    p->torque_per_volt = p->K_T / p->R;
    p->damping = p->b + p->K_T * p->K_T / p->R;
    p->weight_torque = p->m * p->g * p->r;
    p->inverse_J = 1.0 / p->J;
}

INLINE MotorState motor_start(const MotorConstants *p) {
    return (MotorState){p->theta_start, p->omega_start, 0.0};
}

/* Infinities and NaNs do not go away again: checking after many steps is enough. */
INLINE bool motor_is_bounded(MotorState x) {
    return (fabs(x.theta + x.integral) < INFINITY) & (fabs(x.omega) <= MOST_SPEED);
}

/* Speed error that the controller sees. */
INLINE double motor_error(const MotorInputs *in, double omega) {
    return in->omega_des - (omega + in->omega_noise);
}

/* Voltage command before saturation. */
INLINE double motor_command(const MotorConstants *p, const MotorInputs *in, double omega,
                            double integral) {
    /* Eq. (14) */
    return p->closed_loop ? p->K_p * motor_error(in, omega) + p->K_i * integral : in->V_in;
}

INLINE double motor_saturate(const MotorConstants *p, double u) {
    return u > p->V_s_max ? p->V_s_max : u < -p->V_s_max ? -p->V_s_max : u;
}

/* Sign of the limit that the command is beyond, 0 within the limits. */
INLINE double motor_saturation(const MotorConstants *p, double u) {
    return u > p->V_s_max ? 1.0 : u < -p->V_s_max ? -1.0 : 0.0;
}

/* Rate of the integral. Conditional integration: it holds while the command is beyond the limit
 * and the error would push it further out. */
INLINE double motor_integral_rate(const MotorConstants *p, const MotorInputs *in, double omega,
                                  double saturation) {
    const double error = motor_error(in, omega);
    return p->closed_loop && !(saturation * error > 0.0) ? error : 0.0;
}

/* Every torque on the shaft but Coulomb friction. */
INLINE double motor_drive_torque(const MotorConstants *p, const MotorInputs *in, double sin_theta,
                                 double omega, double V_s) {
    return p->torque_per_volt * V_s - p->damping * omega - p->weight_torque * sin_theta + in->d;
}

INLINE MotorDrive motor_drive(const MotorConstants *p, const MotorInputs *in, MotorState x,
                              double sin_theta) {
    const double u = motor_command(p, in, x.omega, x.integral);
    return (MotorDrive){
        motor_drive_torque(p, in, sin_theta, x.omega, motor_saturate(p, u)),
        motor_integral_rate(p, in, x.omega, motor_saturation(p, u)),
    };
}

/* sgn(omega) of Eq. (13), set-valued at rest: 0 while the torque cannot overcome the friction. */
INLINE double motor_direction(const MotorConstants *p, double omega, double torque) {
    const double at_rest = fabs(torque) <= p->c ? 0.0 : motor_sign(torque);
    return omega == 0.0 ? at_rest : motor_sign(omega);
}

INLINE double motor_acceleration(const MotorConstants *p, double torque, double direction) {
    /* Eq. (13), sgn(0) set-valued: at rest friction balances any torque up to c. */
    const double turning = (torque - p->c * direction) * p->inverse_J;
    return direction == 0.0 ? 0.0 : turning;
}

INLINE double motor_current(const MotorConstants *p, double omega, double V_s) {
    return (V_s - p->K_T * omega) / p->R;
}

/* The state after one step h of semi-implicit Euler; friction as a proximal step, which stops exactly
 * at 0. */
INLINE MotorState motor_euler(const MotorConstants *p, MotorState x, MotorDrive drive, double h) {
    const double free = x.omega + h * p->inverse_J * drive.torque;
    const double friction = h * p->inverse_J * p->c;
    const double omega = free > friction ? free - friction : free < -friction ? free + friction : 0.0;
    return (MotorState){x.theta + h * omega, omega, x.integral + h * drive.integral_rate};
}

#endif

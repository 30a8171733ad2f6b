/* Exact partial derivatives of one motor's outputs and state derivatives, by value reference.
 *
 * Each function differentiates the equation of the same name in motor.h; `by` is the value reference
 * of an input, state or parameter. Modes (direction of friction, saturation) are constants. */
#ifndef SENSITIVITY_H
#define SENSITIVITY_H

#include "single.h"

static double error_by(uint32_t by) {
    return by == VR_omega_des ? 1.0 : by == VR_omega || by == VR_omega_noise ? -1.0 : 0.0;
}

static double command_by(const Motor *s, uint32_t by) {
    if (!s->p.closed_loop)
        return by == VR_V_in;
    const double gain = s->p.K_p * error_by(by);
    return by == VR_integral ? s->p.K_i
           : by == VR_K_i    ? s->x.integral
           : by == VR_K_p    ? motor_error(&s->in, s->x.omega)
                             : gain;
}

static double voltage_by(const Motor *s, uint32_t by) {
    const double side = motor_saturation(&s->p, single_command(s));
    return side == 0.0 ? command_by(s, by) : by == VR_V_s_max ? side : 0.0;
}

static double current_by(const Motor *s, uint32_t by) {
    const double direct = by == VR_omega ? -s->p.K_T
                          : by == VR_K_T ? -s->x.omega
                          : by == VR_R   ? -single_current(s)
                                         : 0.0;
    return (voltage_by(s, by) + direct) / s->p.R;
}

/* Of K_T i - b omega - m g r sin(theta) + d: motor_drive_torque written with the current. */
static double drive_torque_by(const Motor *s, uint32_t by) {
    double direct = 0.0;
    switch (by) {
    case VR_K_T: direct = single_current(s); break;
    case VR_omega: direct = -s->p.b; break;
    case VR_b: direct = -s->x.omega; break;
    case VR_theta: direct = -s->p.weight_torque * cosine(s->x.theta); break;
    case VR_m: direct = -s->p.g * s->p.r * s->sin_theta; break;
    case VR_g: direct = -s->p.m * s->p.r * s->sin_theta; break;
    case VR_r: direct = -s->p.m * s->p.g * s->sin_theta; break;
    case VR_d: direct = 1.0; break;
    default: break;
    }
    return s->p.K_T * current_by(s, by) + direct;
}

static double omega_dot_by(const Motor *s, uint32_t by) {
    const double direction = single_direction(s);
    if (direction == 0.0)
        return 0.0;
    const double direct = by == VR_c ? -direction : by == VR_J ? -single_omega_dot(s) : 0.0;
    return (drive_torque_by(s, by) + direct) * s->p.inverse_J;
}

static double integral_dot_by(const Motor *s, uint32_t by) {
    const double error = motor_error(&s->in, s->x.omega);
    const bool holds = single_saturation(s) * error > 0.0;
    return s->p.closed_loop && !holds ? error_by(by) : 0.0;
}

/* Partial derivative of `unknown` by `by`; false where there is none to give. */
static bool partial(const Motor *s, uint32_t unknown, uint32_t by, double *value) {
    switch (unknown) {
    case VR_theta: *value = by == VR_theta; return true;
    case VR_omega: *value = by == VR_omega; return true;
    case VR_der_theta: *value = by == VR_omega; return true;
    case VR_omega_dot: *value = omega_dot_by(s, by); return true;
    case VR_der_integral: *value = integral_dot_by(s, by); return true;
    case VR_V_s: *value = voltage_by(s, by); return true;
    case VR_i: *value = current_by(s, by); return true;
    case VR_u: *value = command_by(s, by); return true;
    case VR_integral: *value = by == VR_integral; return true;
    default: return false;
    }
}

#endif

/* Exact partial derivatives of motor.h's outputs and state derivatives, by value reference.
 *
 * Each function differentiates the equation of the same name in motor.h; `by` is the value reference
 * of an input, state or parameter. Modes (direction of friction, saturation) are constants. */
#ifndef SENSITIVITY_H
#define SENSITIVITY_H

#include "motor.h"

static double error_by(uint32_t by) {
    return by == VR_omega_des ? 1.0 : by == VR_omega || by == VR_omega_noise ? -1.0 : 0.0;
}

static double command_by(const Motor *s, uint32_t by) {
    if (!s->closed_loop)
        return by == VR_V_in;
    const double gain = s->K_p * error_by(by);
    return by == VR_integral ? s->K_i
           : by == VR_K_i    ? s->integral
           : by == VR_K_p    ? motor_error(s, s->omega)
                             : gain;
}

static double voltage_by(const Motor *s, uint32_t by) {
    const double side = motor_saturation(s, motor_present_command(s));
    return side == 0.0 ? command_by(s, by) : by == VR_V_s_max ? side : 0.0;
}

static double current_by(const Motor *s, uint32_t by) {
    const double direct = by == VR_omega ? -s->K_T
                          : by == VR_K_T ? -s->omega
                          : by == VR_R   ? -motor_current(s)
                                         : 0.0;
    return (voltage_by(s, by) + direct) / s->R;
}

/* Of K_T i - b omega - m g r sin(theta) + d: motor_drive_torque written with the current. */
static double drive_torque_by(const Motor *s, uint32_t by) {
    double direct = 0.0;
    switch (by) {
    case VR_K_T: direct = motor_current(s); break;
    case VR_omega: direct = -s->b; break;
    case VR_b: direct = -s->omega; break;
    case VR_theta: direct = -s->weight_torque * cos(s->theta); break;
    case VR_m: direct = -s->g * s->r * s->sin_theta; break;
    case VR_g: direct = -s->m * s->r * s->sin_theta; break;
    case VR_r: direct = -s->m * s->g * s->sin_theta; break;
    case VR_d: direct = 1.0; break;
    default: break;
    }
    return s->K_T * current_by(s, by) + direct;
}

static double omega_dot_by(const Motor *s, uint32_t by) {
    const double direction = motor_present_direction(s);
    if (direction == 0.0)
        return 0.0;
    const double direct = by == VR_c ? -direction : by == VR_J ? -motor_omega_dot(s) : 0.0;
    return (drive_torque_by(s, by) + direct) * s->inverse_J;
}

static double integral_dot_by(const Motor *s, uint32_t by) {
    const double error = motor_error(s, s->omega);
    const bool holds = motor_present_saturation(s) * error > 0.0;
    return s->closed_loop && !holds ? error_by(by) : 0.0;
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

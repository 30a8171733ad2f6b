/* Model Exchange: the motor's modes between events and the indicators that end them.
 *
 * An external solver sees smooth equations, because the direction of friction and the side of the
 * saturation hold still (motor.h) until an indicator turns from positive to negative. The margins
 * make an event come just after the mode has become wrong, never just before. */
#ifndef EVENTS_H
#define EVENTS_H

#include "motor.h"

enum { STATE_COUNT = 3, INDICATOR_COUNT = 3 };

#define SPEED_MARGIN 1e-9    /* rad/s */
#define TORQUE_MARGIN 1e-9   /* of c */
#define LEAST_TORQUE 1e-18   /* N.m, margin where c is 0 */
#define VOLTAGE_MARGIN 1e-12 /* V */
/* Saturation ends this part of V_s_max below the limit. Conditional integration alone would
 * switch without end where the integral pushes the command out of the limits and the speed back. */
#define HYSTERESIS 1e-4

/* Positive while the friction mode holds: still turning that way, or still held. */
static inline double indicator_friction(const Motor *s) {
    if (s->friction)
        return s->friction * s->omega + SPEED_MARGIN;
    return s->c * (1.0 + TORQUE_MARGIN) + LEAST_TORQUE - fabs(motor_present_torque(s));
}

/* Positive while the command stays on its side of the upper (side 1) or lower (side -1) limit. */
static inline double indicator_saturation(const Motor *s, int side) {
    const double beyond = side * motor_present_command(s) - s->V_s_max;
    if (s->saturation == side)
        return beyond + HYSTERESIS * s->V_s_max + VOLTAGE_MARGIN;
    return VOLTAGE_MARGIN - beyond;
}

/* Bring the modes up to date. Returns whether the motion goes on otherwise than before, so that a
 * solver must start anew: the speed was reset, a mode changed, or an input was set. */
static inline bool events_update(Motor *s) {
    const int32_t friction = s->friction, saturation = s->saturation;
    bool changed = s->jumped;
    s->jumped = 0;
    s->modes_held = 1;
    /* At standstill, whichever way it came: held, or driven on by more than the friction. */
    const double u_at_rest = motor_command(s, 0.0, s->integral);
    const double at_rest = motor_drive_torque(s, s->sin_theta, 0.0, motor_saturate(s, u_at_rest));
    const double onward = motor_direction(s, 0.0, at_rest);
    const bool crossed = s->friction && s->friction * s->omega <= 0.0;
    if ((crossed || s->omega == 0.0) && onward * s->omega <= 0.0) {
        changed |= s->omega != 0.0;
        s->omega = 0.0;
        s->friction = (int32_t)onward;
    } else {
        s->friction = (int32_t)motor_sign(s->omega);
    }
    const double u = motor_present_command(s);
    const double side = motor_saturation(s, u);
    if (side != 0.0 || s->saturation * u <= s->V_s_max * (1.0 - HYSTERESIS))
        s->saturation = (int32_t)side;
    return changed || s->friction != friction || s->saturation != saturation;
}

/* First update after initialisation: no mode to keep. */
static inline void events_initialise(Motor *s) {
    s->friction = 0;
    s->saturation = 0;
    events_update(s);
}

#endif

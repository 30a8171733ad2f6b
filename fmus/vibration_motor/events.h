/* Model Exchange: the motor's modes between events and the indicators that end them.
 *
 * An external solver sees smooth equations, because the direction of friction and the side of the
 * saturation hold still (single.h) until an indicator turns from positive to negative. The margins
 * make an event come just after the mode has become wrong, never just before. */
#ifndef EVENTS_H
#define EVENTS_H

#include "single.h"

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
        return s->friction * s->x.omega + SPEED_MARGIN;
    return s->p.c * (1.0 + TORQUE_MARGIN) + LEAST_TORQUE - fabs(single_torque(s));
}

/* Positive while the command stays on its side of the upper (side 1) or lower (side -1) limit. */
static inline double indicator_saturation(const Motor *s, int side) {
    const double beyond = side * single_command(s) - s->p.V_s_max;
    if (s->saturation == side)
        return beyond + HYSTERESIS * s->p.V_s_max + VOLTAGE_MARGIN;
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
    const MotorState resting = {s->x.theta, 0.0, s->x.integral};
    const MotorDrive at_rest = motor_drive(&s->p, &s->in, resting, s->sin_theta);
    const double onward = motor_direction(&s->p, 0.0, at_rest.torque);
    const bool crossed = s->friction && s->friction * s->x.omega <= 0.0;
    if ((crossed || s->x.omega == 0.0) && onward * s->x.omega <= 0.0) {
        changed |= s->x.omega != 0.0;
        s->x.omega = 0.0;
        s->friction = (int32_t)onward;
    } else {
        s->friction = (int32_t)motor_sign(s->x.omega);
    }
    const double u = single_command(s);
    const double side = motor_saturation(&s->p, u);
    if (side != 0.0 || s->saturation * u <= s->p.V_s_max * (1.0 - HYSTERESIS))
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

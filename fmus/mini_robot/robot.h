/* One robot with its state, as the FMU MiniRobot holds it, and how a communication step moves it. */
#ifndef ROBOT_H
#define ROBOT_H

#include "design.h"
#include "variables.h"

enum { MOTOR_COUNT = 2 }; /* D, E */

typedef union {
    struct { INPUT_FIELDS };
    struct { Shaft motor[MOTOR_COUNT]; };
    double value[INPUT_COUNT];
} RobotInputs;

typedef struct {
    union {
        struct { PARAMETER_FIELDS };
        double value[PARAMETER_COUNT];
    };
    /* What follows from them; see robot_derive. */
    BodyConstants body;
    Mount mount[MOTOR_COUNT];
} RobotConstants;

/* Plain data: a copy of it is its whole state. */
typedef struct {
    RobotInputs in;
    RobotConstants p;
    Body x;
    Shaft before[MOTOR_COUNT]; /* inputs of the last communication step */
    double reaction[MOTOR_COUNT];
    int32_t extrapolate, padding; /* equal states are equal bytes */
} Robot;

/* Put changed parameters into force. */
static void robot_derive(Robot *s) {
    RobotConstants *p = &s->p;
    p->body = design_body(p->mass, p->diameter, p->height, p->com_height, p->foot_radius, p->g);
    p->body.centre_x = p->com_x;
    p->body.centre_y = p->com_y;
    for (int k = 0; k < FOOT_COUNT; k++)
        p->body.mu[k] = p->mu;
    p->body.restitution = p->restitution;
    p->body.dt = p->step_size;
    p->body.inverse_dt = 1.0 / p->step_size;
    p->body.contact.tolerance = CONTACT_TOLERANCE * p->mass * p->g * p->step_size;
    design_solver(&p->body);
    for (int k = 0; k < MOTOR_COUNT; k++) {
        const double side = k == 0 ? 1.0 : -1.0;
        p->mount[k] = (Mount){p->m, p->r, p->J, p->g, side * p->motor_radius,
                              p->motor_axis_height - p->com_height, side};
    }
}

/* Put the parameters into force and the robot to its start. */
static void robot_initialise(Robot *s) {
    const Trig half = sine_cosine(s->p.heading_start / 2.0);
    robot_derive(s);
    s->x = (Body){.position = {s->p.x_start, s->p.y_start, s->p.com_height + s->p.lift_start},
                  .orientation = {half.cosine, 0.0, 0.0, half.sine}};
    for (int k = 0; k < MOTOR_COUNT; k++)
        s->reaction[k] = 0.0;
}

/* A motor at the end of an internal step. Inputs are what the motors are at the start of the
 * communication step, carried on by their accelerations, or at its end, interpolated. */
INLINE Shaft robot_shaft(const Robot *s, int motor, int64_t tick, int64_t ticks) {
    const Shaft now = s->in.motor[motor], before = s->before[motor];
    if (s->extrapolate) {
        const double tau = (double)(tick + 1) * s->p.step_size;
        const double omega = now.omega + now.omega_dot * tau;
        return (Shaft){now.theta + 0.5 * (now.omega + omega) * tau, omega, now.omega_dot};
    }
    if (ticks == 1)
        return now;
    const double share = (double)(tick + 1) / (double)ticks;
    return (Shaft){before.theta + share * (now.theta - before.theta),
                   before.omega + share * (now.omega - before.omega),
                   before.omega_dot + share * (now.omega_dot - before.omega_dot)};
}

INLINE Wrench robot_wrench(const Robot *s, int64_t tick, int64_t ticks) {
    const Wrench d = motor_wrench(s->p.mount[0], robot_shaft(s, 0, tick, ticks));
    const Wrench e = motor_wrench(s->p.mount[1], robot_shaft(s, 1, tick, ticks));
    Wrench both = {plus(d.force, 1.0, e.force), plus(d.moment, 1.0, e.moment)};
    if (s->in.F_x != 0.0 || s->in.F_y != 0.0 || s->in.M_z != 0.0) {
        const Vector outside = {s->in.F_x, s->in.F_y, 0.0};
        both.force = plus(both.force, 1.0, to_body(rotation_matrix(s->x.orientation), outside));
        both.moment.z += s->in.M_z;
    }
    return both;
}

/* What the body's mean acceleration over a communication step does to the eccentric masses. */
static void robot_react(Robot *s, Body before, int64_t ticks) {
    const double rate = 1.0 / ((double)ticks * s->p.step_size);
    const Vector change = scaled(rate, plus(s->x.velocity, -1.0, before.velocity));
    const Vector turn = plus(s->x.omega, -1.0, before.omega);
    const Matrix world_from_body = rotation_matrix(s->x.orientation);
    const Vector acceleration =
        at_axis(to_body(world_from_body, change), scaled(rate, turn), &s->p.body);
    for (int k = 0; k < MOTOR_COUNT; k++) {
        const double theta = s->extrapolate ? robot_shaft(s, k, ticks - 1, ticks).theta
                                            : s->in.motor[k].theta;
        s->reaction[k] = reaction_torque(s->p.mount[k], theta, acceleration, turn, rate);
    }
}

static void robot_step(Robot *s, int64_t ticks) {
    const Body before = s->x;
    for (int64_t tick = 0; tick < ticks; tick++)
        s->x = body_stepped(s->x, &s->p.body, robot_wrench(s, tick, ticks));
    robot_react(s, before, ticks);
    for (int k = 0; k < MOTOR_COUNT; k++)
        s->before[k] = s->in.motor[k];
}

#endif

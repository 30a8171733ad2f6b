/* One rigid robot on the floor: Newton-Euler equations (Eq. 2) with three contacts, by semi-implicit
 * Euler: cosim/physics/body.py in C, which says why. */
#ifndef BODY_H
#define BODY_H

#include "contact.h"
#include "wrench.h"

typedef struct {
    double inverse_mass;
    Vector inertia, inverse_inertia; /* about the centre of mass, body frame */
    double product, inverse_product; /* elements xy of both tensors, 0 unless off the axis */
    double centre_x, centre_y;       /* of mass, from the robot's axis */
    Vector gravity;                  /* world frame */
    double mu[FOOT_COUNT];           /* under feet A, B, C */
    double restitution;
    double dt, inverse_dt;
    Contact contact;
} BodyConstants;

/* Plain doubles. */
typedef struct {
    Vector position; /* of the centre of mass, world frame */
    Quaternion orientation;
    Vector velocity;        /* of the centre of mass, world frame */
    Vector omega;           /* body frame */
    Impulse at[FOOT_COUNT]; /* of the last step */
} Body;

INLINE bool is_off_axis(const BodyConstants *p) { return p->centre_x != 0.0 || p->centre_y != 0.0; }

/* Moment about the centre of mass, from that about the robot's axis at its height. */
INLINE Vector about_centre(Vector moment, Vector force, const BodyConstants *p) {
    if (!is_off_axis(p))
        return moment;
    return (Vector){moment.x - p->centre_y * force.z, moment.y + p->centre_x * force.z,
                    moment.z - (p->centre_x * force.y - p->centre_y * force.x)};
}

/* Velocity of the robot's axis at the height of the centre of mass, body frame. */
INLINE Vector at_axis(Vector velocity, Vector omega, const BodyConstants *p) {
    if (!is_off_axis(p))
        return velocity;
    return (Vector){velocity.x + p->centre_y * omega.z, velocity.y - p->centre_x * omega.z,
                    velocity.z - (p->centre_y * omega.x - p->centre_x * omega.y)};
}

/* Product of a tensor, whose only other element is xy, and a vector. */
INLINE Vector tensor_times(Vector diagonal, double product, Vector v, const BodyConstants *p) {
    const Vector t = times(diagonal, v);
    return is_off_axis(p) ? (Vector){t.x + product * v.y, t.y + product * v.x, t.z} : t;
}

/* The angular velocity after a moment has acted for dt. */
INLINE Vector body_turned(Vector omega, Vector moment, const BodyConstants *p) {
    const Vector inverse = scaled(p->dt, p->inverse_inertia);
    return plus(omega, 1.0, tensor_times(inverse, p->dt * p->inverse_product, moment, p));
}

/* Angular velocity after dt without any moment: implicit midpoint rule, two iterations. */
INLINE Vector body_spun(Vector omega, const BodyConstants *p) {
    Vector middle = omega, after = omega;
    for (int k = 0; k < 2; k++) {
        /* Eq. (2), left side */
        after = body_turned(omega, cross(tensor_times(p->inertia, p->product, middle, p), middle), p);
        middle = (Vector){0.5 * (omega.x + after.x), 0.5 * (omega.y + after.y),
                          0.5 * (omega.z + after.z)};
    }
    return after;
}

typedef struct {
    Vector velocity, omega; /* body frame */
    Vector total;           /* impulse */
} Pushed;

/* Velocities after the contact impulses; A and C are added first, as mirror images. */
INLINE Pushed with_impulses(Vector velocity, Vector omega, const BodyConstants *p, Vector normal,
                            const Impulse at[FOOT_COUNT]) {
    const Vector a = plus(at[0].friction, at[0].normal, normal);
    const Vector b = plus(at[1].friction, at[1].normal, normal);
    const Vector c = plus(at[2].friction, at[2].normal, normal);
    const Vector both = plus(a, 1.0, c), total = plus(both, 1.0, b);
    const Vector foot = p->contact.foot[0];
    const double x_b = p->contact.foot[1].x;
    const Vector twist = {
        foot.y * (a.z - c.z) - foot.z * total.y,
        foot.z * total.x - (foot.x * both.z + x_b * b.z),
        foot.x * both.y + x_b * b.y - foot.y * (a.x - c.x),
    };
    const Vector turn =
        tensor_times(p->inverse_inertia, p->inverse_product, about_centre(twist, total, p), p);
    return (Pushed){plus(velocity, p->inverse_mass, total), plus(omega, 1.0, turn), total};
}

/* Velocities of feet A, B, C, from that of the axis, all in the body frame. */
INLINE void foot_velocities(Vector velocity, Vector omega, const Contact *contact,
                            Vector feet[FOOT_COUNT]) {
    const Vector foot = contact->foot[0];
    const double x_b = contact->foot[1].x;
    const double along = velocity.x + omega.y * foot.z, aside = velocity.y - omega.x * foot.z;
    const double across = aside + omega.z * foot.x;
    const double up = velocity.z - omega.y * foot.x;
    const double swing = omega.z * foot.y, roll = omega.x * foot.y;
    feet[0] = (Vector){along - swing, across, up + roll};
    feet[1] = (Vector){along, aside + omega.z * x_b, velocity.z - omega.y * x_b};
    feet[2] = (Vector){along + swing, across, up - roll};
}

/* Least normal speed of a foot after the step: any where no floor is below it, which a mu below 0 says. */
INLINE double least_speed(Vector foot, const Body *body, Vector normal, double mu,
                          const BodyConstants *p) {
    if (mu < 0.0)
        return -INFINITY;
    if (is_off_axis(p))
        foot = (Vector){foot.x - p->centre_x, foot.y - p->centre_y, foot.z};
    const double gap = body->position.z + dot(normal, foot);
    const double least = allowed_approach(gap, p->inverse_dt);
    if (!(p->restitution > 0.0))
        return least;
    const double before = body->velocity.z + dot(cross(normal, body->omega), foot);
    return impact_speed(gap, before, least, p->restitution, p->inverse_dt);
}

/* The body after dt under a force and a moment about the axis, body frame, beside gravity and
 * contacts. */
static Body body_stepped(Body body, const BodyConstants *p, Wrench applied) {
    const double dt = p->dt;
    const Matrix world_from_body = rotation_matrix(body.orientation);
    /* Eq. (2), before contacts and seen from the body */
    const Vector free_velocity =
        plus(to_body(world_from_body, plus(body.velocity, dt, p->gravity)), dt * p->inverse_mass,
             applied.force);
    const Vector spun = body_spun(body.omega, p);
    const Vector free_omega =
        body_turned(spun, about_centre(applied.moment, applied.force, p), p);
    const Vector half_spin = plus(body.omega, -1.0, spun);

    const Vector normal = world_from_body.z;
    double least[FOOT_COUNT];
    for (int k = 0; k < FOOT_COUNT; k++)
        least[k] = least_speed(p->contact.foot[k], &body, normal, p->mu[k], p);
    Pushed now = with_impulses(free_velocity, free_omega, p, normal, body.at);
    double change = INFINITY;
    for (int sweep = 0; sweep < MAX_SWEEPS && change >= p->contact.tolerance; sweep++) {
        Vector feet[FOOT_COUNT];
        Impulse at[FOOT_COUNT];
        foot_velocities(at_axis(now.velocity, now.omega, p), now.omega, &p->contact, feet);
        for (int k = 0; k < FOOT_COUNT; k++)
            at[k] = gradient_step(body.at[k], feet[k], normal, least[k], p->mu[k], &p->contact);
        const Pushed before = now;
        now = with_impulses(free_velocity, free_omega, p, normal, at);
        change = fabs(at[0].normal - body.at[0].normal) + fabs(at[2].normal - body.at[2].normal) +
                 fabs(at[1].normal - body.at[1].normal);
        change += fabs(now.total.x - before.total.x) + fabs(now.total.y - before.total.y);
        change += p->contact.spin_inertia * fabs(now.omega.z - before.omega.z);
        for (int k = 0; k < FOOT_COUNT; k++)
            body.at[k] = at[k];
    }

    const Vector push = to_world(world_from_body, plus(now.total, dt, applied.force));
    body.velocity = plus(plus(body.velocity, dt, p->gravity), p->inverse_mass, push);
    body.position = plus(body.position, dt, body.velocity);
    body.orientation = rotated(body.orientation, scaled(dt, plus(now.omega, 0.5, half_spin)));
    body.omega = now.omega;
    return body;
}

#endif

/* Three rigid unilateral contacts with Coulomb friction as impulses per step:
 * cosim/physics/contact.py in C, which says why. */
#ifndef CONTACT_H
#define CONTACT_H

#include "vector.h"

#define GAP_CORRECTION 0.1 /* share of a penetration removed per step */
/* Sweeps end when impulses change by less than this share of weight times step. */
#define CONTACT_TOLERANCE 0.01
enum { MAX_SWEEPS = 50, FOOT_COUNT = 3 };

typedef struct {
    double normal;   /* N s */
    Vector friction; /* body frame, N s */
} Impulse;

/* Geometry, body frame, and step sizes of the solver. */
typedef struct {
    Vector foot[FOOT_COUNT];             /* A, B, C from the robot's axis, m */
    double step_normal, step_tangential; /* kg */
    double spin_inertia;                 /* kg m */
    double tolerance;                    /* N s */
} Contact;

/* Least normal speed of a foot at that gap: it may close the gap, not pass it. */
INLINE double allowed_approach(double gap, double inverse_dt) {
    return gap > 0.0 ? -gap * inverse_dt : -GAP_CORRECTION * gap * inverse_dt;
}

/* Least normal speed of a foot after a step by Newton's impact law; before: its normal speed. */
INLINE double impact_speed(double gap, double before, double allowed, double restitution,
                           double inverse_dt) {
    const double bounce = -restitution * before;
    const bool lands = gap * inverse_dt + before <= 0.0 && bounce > 0.0 && bounce > allowed;
    return lands ? bounce : allowed;
}

/* One projected gradient step of a contact: Signorini's condition and Coulomb's cone. */
INLINE Impulse gradient_step(Impulse impulse, Vector velocity, Vector normal, double least,
                             double mu, const Contact *contact) {
    const double speed = dot(normal, velocity);
    const Vector friction =
        plus(impulse.friction, -contact->step_tangential, plus(velocity, -speed, normal));
    const double wanted = impulse.normal - contact->step_normal * (speed - least);
    const double pressed = wanted > 0.0 ? wanted : 0.0;
    const double limit = mu * pressed, length_2 = dot(friction, friction);
    const double shrink = length_2 > limit * limit ? limit / square_root(length_2) : 1.0;
    return (Impulse){pressed, scaled(shrink, friction)};
}

#endif

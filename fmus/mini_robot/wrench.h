/* Forces of the eccentric masses on the body: cosim/physics/forces.py in C. */
#ifndef WRENCH_H
#define WRENCH_H

#include "trig.h"
#include "vector.h"

typedef struct {
    double theta, omega, omega_dot; /* rad, rad/s, rad/s2 */
} Shaft;

/* Eccentric mass and place of a motor in the body frame. */
typedef struct {
    double m, r, J, g;
    double y, z;    /* m, z over the centre of mass */
    double sin_phi; /* of the angle from the body's x axis to the shaft (Fig. 4b) */
} Mount;

typedef struct {
    Vector force, moment; /* N, N m, about the axis at the height of the centre of mass */
} Wrench;

INLINE Wrench motor_wrench(Mount mount, Shaft shaft) {
    const Trig t = sine_cosine(shaft.theta);
    const double mr = mount.m * mount.r, omega = shaft.omega, omega_dot = shaft.omega_dot;
    /* Eq. (3) */
    const double f_x = (mr * omega_dot * t.cosine - mr * omega * omega * t.sine) * mount.sin_phi;
    const double f_z = -mount.m * mount.g - mr * omega_dot * t.sine - mr * omega * omega * t.cosine;
    const double n_y = -(mount.J * omega_dot + mr * mount.g * t.sine) * mount.sin_phi;
    /* Eq. (2), j = D, E */
    return (Wrench){{f_x, 0.0, f_z}, {mount.y * f_z, mount.z * f_x + n_y, -mount.y * f_x}};
}

/* Torque on an eccentric mass of the body's acceleration: that of the axis, and the turn that came to
 * the angular velocity at a rate in 1/s; body frame. */
INLINE double reaction_torque(Mount mount, double theta, Vector acceleration, Vector turn,
                              double rate) {
    const Trig t = sine_cosine(theta);
    const double mount_x = acceleration.x + rate * (turn.y * mount.z - turn.z * mount.y);
    const double mount_z = acceleration.z + rate * turn.x * mount.y;
    return mount.m * mount.r * (mount.sin_phi * t.cosine * mount_x - t.sine * mount_z);
}

#endif

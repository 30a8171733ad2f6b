/* Whether a motor's parameters are stable with an internal step: semi-implicit Euler swings the speed
 * up where the step is too long for a light shaft or a fast integral. Needs instance.h and motor.h. */
#ifndef STABILITY_H
#define STABILITY_H

/* Least J by Jury's criterion for the loop of speed and integral; that of the weight is added. */
static double least_J(const MotorConstants *p, double h) {
    const double gain = p->closed_loop ? p->torque_per_volt : 0.0;
    return 0.5 * h * (p->damping + gain * p->K_p) +
           0.25 * h * h * (p->weight_torque - gain * p->K_i);
}

/* Most K_i likewise, whatever J is. */
static double most_K_i(const MotorConstants *p, double h) {
    return p->closed_loop ? (p->K_p + p->damping / p->torque_per_volt) / h : INFINITY;
}

/* Whether a motor is stable; says why not, with limits that are allowed as they are printed. */
static Status check_motor(const Instance *instance, const char *function, const char *whose,
                          const MotorConstants *p, double h) {
    const double J = least_J(p, h), K_i = most_K_i(p, h);
    if (p->K_i > K_i)
        return fail(instance, function,
                    "K_i%s cannot be %g: its speed would swing up in steps of step_size %g s; the "
                    "most for its other parameters is %.4g",
                    whose, p->K_i, h, 0.999 * K_i);
    if (p->J < J)
        return fail(instance, function,
                    "J%s cannot be %g: its speed would swing up in steps of step_size %g s; the "
                    "least for its other parameters is %.4g",
                    whose, p->J, h, 1.001 * J);
    return STATUS_OK;
}

#endif

/* An instance of one motor: what VibrationMotor offers beyond instance.h, Model Exchange
 * (motor_instance.c) and derivatives (derivatives.c). The shims fmi2.c, fmi3.c, fmi2_motor.c and
 * fmi3_motor.c only translate calls. */
#ifndef MOTOR_INSTANCE_H
#define MOTOR_INSTANCE_H

#include "single.h"

typedef Motor Plain;

#include "plain.h"

static Status instance_set_time(Instance *instance, const char *function, double time);
static Status instance_set_states(Instance *instance, const char *function, const double states[],
                                  size_t count);
static Status instance_get_states(const Instance *instance, const char *function, double states[],
                                  size_t count);
static Status instance_get_derivatives(const Instance *instance, const char *function,
                                       double derivatives[], size_t count);
static Status instance_get_nominals(const Instance *instance, const char *function,
                                    double nominals[], size_t count);
static Status instance_get_indicators(const Instance *instance, const char *function,
                                      double indicators[], size_t count);

/* Sensitivity of each unknown to a change `seed` of the knowns, or, adjoint, of each known. */
static Status instance_directional(const Instance *instance, const char *function,
                                   const uint32_t unknowns[], size_t unknown_count,
                                   const uint32_t knowns[], size_t known_count, const double seed[],
                                   double sensitivity[]);
static inline Status instance_adjoint(const Instance *instance, const char *function,
                                      const uint32_t unknowns[], size_t unknown_count,
                                      const uint32_t knowns[], size_t known_count,
                                      const double seed[], double sensitivity[]);
/* Time derivatives of outputs with the inputs held; only the first. */
static Status instance_output_derivatives(const Instance *instance, const char *function,
                                          const uint32_t references[], size_t count,
                                          const int32_t orders[], double values[]);

#endif

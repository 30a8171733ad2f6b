/* See instance.h and motor_instance.h: life cycle and steps of one motor, and its Model Exchange. */
#include "motor_instance.h"

#include <string.h>

#include "events.h"
#include "integrate.h"

static const size_t model_size = sizeof(MotorInstance);

Status model_reset(Instance *instance, const char *function) {
    (void)function;
    Motor *motor = motor_of(instance);
    memset(motor, 0, sizeof *motor);
    memcpy(motor->in.value, input_start, sizeof motor->in.value);
    memcpy(motor->p.value, parameter_start, sizeof motor->p.value);
    motor->p.closed_loop = START_closed_loop;
    motor->p.solver = START_solver;
    single_initialise(motor);
    return STATUS_OK;
}

void model_release(Instance *instance) { (void)instance; } /* a Motor is plain data */

void model_exit_initialization(Instance *instance) {
    instance->now.life_cycle = instance->now.model_exchange ? EVENT : STEP;
    if (instance->now.model_exchange)
        events_initialise(motor_of(instance));
}

Status model_do_step(Instance *instance, const char *function, double time, double step_size) {
    Motor *motor = motor_of(instance);
    const double h = motor->p.step_size;
    Plan plan;
    if (plan_step(instance, function, time, step_size, h, &plan) != STATUS_OK)
        return STATUS_ERROR;
    const MotorState before = motor->x;
    for (int64_t k = 0; k < plan.steps; k++)
        single_step(motor, h);
    if (plan.rest > 0.0)
        single_step(motor, plan.rest);
    if (!motor_is_bounded(motor->x)) {
        single_set_state(motor, before);
        return fail_growth(instance, function, "", time, h);
    }
    instance->now.time = time + step_size;
    instance->now.owed = plan.owed;
    return STATUS_OK;
}

Status instance_set_time(Instance *instance, const char *function, double time) {
    if (!isfinite(time))
        return fail(instance, function, "the time is %g; give a finite number", time);
    instance->now.time = time;
    return STATUS_OK;
}

static Status check_count(const Instance *instance, const char *function, const void *values,
                          size_t count, size_t wanted, const char *what) {
    if (count != wanted)
        return fail(instance, function, "room for %lu %s, but there are %lu", (unsigned long)count,
                    what, (unsigned long)wanted);
    if (!values)
        return fail(instance, function, "the array of %s is null", what);
    return STATUS_OK;
}

Status instance_set_states(Instance *instance, const char *function, const double states[],
                           size_t count) {
    if (check_count(instance, function, states, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++)
        if (!isfinite(states[k]))
            return fail(instance, function, "state %lu is %g; give finite numbers",
                        (unsigned long)k, states[k]);
    single_set_state(motor_of(instance), (MotorState){states[0], states[1], states[2]});
    return STATUS_OK;
}

Status instance_get_states(const Instance *instance, const char *function, double states[],
                           size_t count) {
    if (check_count(instance, function, states, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    const Motor *motor = motor_in(instance);
    states[0] = motor->x.theta;
    states[1] = motor->x.omega;
    states[2] = motor->x.integral;
    return STATUS_OK;
}

Status instance_get_derivatives(const Instance *instance, const char *function,
                                double derivatives[], size_t count) {
    if (check_count(instance, function, derivatives, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    const Motor *motor = motor_in(instance);
    derivatives[0] = motor->x.omega;
    derivatives[1] = single_omega_dot(motor);
    derivatives[2] = single_integral_dot(motor);
    return STATUS_OK;
}

Status instance_get_nominals(const Instance *instance, const char *function, double nominals[],
                             size_t count) {
    if (check_count(instance, function, nominals, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    nominals[0] = NOMINAL_theta;
    nominals[1] = NOMINAL_omega;
    nominals[2] = NOMINAL_integral;
    return STATUS_OK;
}

Status instance_get_indicators(const Instance *instance, const char *function, double indicators[],
                               size_t count) {
    if (check_count(instance, function, indicators, count, INDICATOR_COUNT, "event indicators") !=
        STATUS_OK)
        return STATUS_ERROR;
    const Motor *motor = motor_in(instance);
    indicators[0] = indicator_friction(motor);
    indicators[1] = indicator_saturation(motor, 1);
    indicators[2] = indicator_saturation(motor, -1);
    return STATUS_OK;
}

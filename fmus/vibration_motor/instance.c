/* See instance.h: life cycle, messages, stepping, and the states of Model Exchange. */
#include "instance.h"

#include <float.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "events.h"
#include "integrate.h"

enum { MESSAGE_SIZE = 512 };

static const char LOG_CATEGORY[] = "logStatusError";

/* Above this a communication step is a mistake in the importer: it would run for minutes. */
static const double MOST_STEPS = 1e9;

/* rad/s; beyond it derivatives and outputs overflow. */
static const double MOST_SPEED = 1e100;

/* How far a communication point may be off, in parts of the shorter of communication and internal step,
 * beside four units in the last place: importers round times, some to nanoseconds. */
static const double TIME_TOLERANCE = 1e-4;

Status fail(const Instance *instance, const char *function, const char *format, ...) {
    if (!instance->logging)
        return STATUS_ERROR;
    char message[MESSAGE_SIZE];
    const int length = snprintf(message, sizeof message, "%s: ", function);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(message + length, sizeof message - (size_t)length, format, arguments);
    va_end(arguments);
    instance->log(instance, STATUS_ERROR, LOG_CATEGORY, message);
    return STATUS_ERROR;
}

Status fail_state(const Instance *instance, const char *function) {
    const int state = instance->now.life_cycle;
    return fail(instance, function, "not allowed in %s",
                state == INSTANTIATED      ? "the state Instantiated"
                : state == INITIALIZATION  ? "Initialization Mode"
                : state == STEP            ? "Step Mode"
                : state == EVENT           ? "Event Mode"
                : state == CONTINUOUS_TIME ? "Continuous-Time Mode"
                                           : "the state Terminated");
}

void instance_reset(Instance *instance) {
    const int32_t model_exchange = instance->now.model_exchange;
    memset(&instance->now, 0, sizeof instance->now);
    Motor *motor = &instance->now.motor;
    memcpy(motor->input, input_start, sizeof motor->input);
    memcpy(motor->parameter, parameter_start, sizeof motor->parameter);
    motor->closed_loop = START_closed_loop;
    motor->solver = START_solver;
    motor_initialise(motor);
    instance->now.stop_time = INFINITY;
    instance->now.life_cycle = INSTANTIATED;
    instance->now.model_exchange = model_exchange;
}

Instance *instance_new(const char *name, const char *token, bool model_exchange, LogFunction *log,
                       void (*callback)(void), void *environment, bool logging) {
    static char no_name[] = "";
    Instance draft = {.log = log, .callback = callback, .environment = environment, .name = no_name,
                      .logging = logging};
    if (!name || !name[strspn(name, " \t\n\v\f\r")]) {
        fail(&draft, "instantiate", "the instance name is blank");
        return NULL;
    }
    if (!token || strcmp(token, INSTANTIATION_TOKEN) != 0) {
        fail(&draft, "instantiate",
             "the token \"%s\" is not \"%s\": model description and binary are of different builds",
             token ? token : "", INSTANTIATION_TOKEN);
        return NULL;
    }
    Instance *instance = malloc(sizeof *instance);
    char *copy = malloc(strlen(name) + 1);
    if (!instance || !copy) {
        free(instance);
        free(copy);
        fail(&draft, "instantiate", "out of memory");
        return NULL;
    }
    *instance = draft;
    instance->name = strcpy(copy, name);
    instance->now.model_exchange = model_exchange;
    instance_reset(instance);
    return instance;
}

void instance_free(Instance *instance) {
    if (!instance)
        return;
    free(instance->name);
    free(instance);
}

Status instance_set_logging(Instance *instance, const char *function, bool on, size_t count,
                            const char *const categories[]) {
    for (size_t k = 0; k < count; k++)
        if (!categories || !categories[k] || strcmp(categories[k], LOG_CATEGORY) != 0)
            return fail(instance, function, "there is no log category \"%s\"; use %s",
                        categories && categories[k] ? categories[k] : "", LOG_CATEGORY);
    instance->logging = on;
    return STATUS_OK;
}

Status instance_set_experiment(Instance *instance, const char *function, double start_time,
                               bool stop_time_defined, double stop_time) {
    if (!isfinite(start_time))
        return fail(instance, function, "the start time is %g; give a finite number", start_time);
    if (stop_time_defined && !(stop_time >= start_time))
        return fail(instance, function, "the stop time %g is before the start time %g", stop_time,
                    start_time);
    instance->now.motor.time = start_time;
    instance->now.stop_time = stop_time_defined ? stop_time : INFINITY;
    return STATUS_OK;
}

void instance_exit_initialization(Instance *instance) {
    instance->now.life_cycle = instance->now.model_exchange ? EVENT : STEP;
    if (instance->now.model_exchange)
        events_initialise(&instance->now.motor);
}

/* Whether a communication step can be made; says why not. */
static Status check_step(const Instance *instance, const char *function, double time,
                         double step_size) {
    const Motor *motor = &instance->now.motor;
    if (!(step_size > 0.0) || !(step_size <= MOST_STEPS * motor->step_size))
        return fail(instance, function,
                    "the communication step is %g s; give a positive one of at most %g s",
                    step_size, MOST_STEPS * motor->step_size);
    const double shorter = step_size < motor->step_size ? step_size : motor->step_size;
    const double rounding = TIME_TOLERANCE * shorter + 4.0 * DBL_EPSILON * fabs(motor->time);
    if (!(fabs(time - motor->time) <= rounding))
        return fail(instance, function,
                    "the communication point is %.17g s but the FMU is at %.17g s", time,
                    motor->time);
    /* Sums of steps may end a little late; half a step is a step too many. */
    if (!(time + step_size <= instance->now.stop_time + 0.5 * shorter))
        return fail(instance, function, "the step from %g s by %g s goes beyond the stop time %g s",
                    time, step_size, instance->now.stop_time);
    return STATUS_OK;
}

Status instance_do_step(Instance *instance, const char *function, double time, double step_size) {
    Motor *motor = &instance->now.motor;
    const double h = motor->step_size;
    if (check_step(instance, function, time, step_size) != STATUS_OK)
        return STATUS_ERROR;

    double rest = 0.0, owed = motor->owed;
    int64_t steps = 1;
    if (step_size != h) {
        const double ratio = step_size / h;
        steps = (int64_t)(ratio + 0.5);
        if (fabs(ratio - (double)steps) > WHOLE_STEPS_TOLERANCE) {
            steps = (int64_t)ratio;
            rest = step_size - (double)steps * h;
        } else {
            owed += step_size - (double)steps * h;
        }
    }
    if (fabs(owed) > WHOLE_STEPS_TOLERANCE * h) {
        if (owed < 0.0) { /* make the last whole step shorter */
            steps -= 1;
            rest = h;
        }
        rest += owed;
        owed = 0.0;
    }
    const MotorState before = {motor->theta, motor->omega, motor->integral};
    for (int64_t k = 0; k < steps; k++)
        motor_step(motor, h);
    if (rest > 0.0)
        motor_step(motor, rest);

    /* Infinities and NaNs do not go away again: checking at the end is enough. */
    if (!isfinite(motor->theta + motor->integral) || !(fabs(motor->omega) <= MOST_SPEED)) {
        motor_set_state(motor, before.theta, before.omega, before.integral);
        return fail(instance, function,
                    "the state grew beyond all bounds in the step from %g s; step_size %g s is too "
                    "long for these parameters",
                    time, h);
    }
    motor->time = time + step_size;
    motor->owed = owed;
    return STATUS_OK;
}

Status instance_set_time(Instance *instance, const char *function, double time) {
    if (!isfinite(time))
        return fail(instance, function, "the time is %g; give a finite number", time);
    instance->now.motor.time = time;
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
    motor_set_state(&instance->now.motor, states[0], states[1], states[2]);
    return STATUS_OK;
}

Status instance_get_states(const Instance *instance, const char *function, double states[],
                           size_t count) {
    if (check_count(instance, function, states, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    const Motor *motor = &instance->now.motor;
    states[0] = motor->theta;
    states[1] = motor->omega;
    states[2] = motor->integral;
    return STATUS_OK;
}

Status instance_get_derivatives(const Instance *instance, const char *function,
                                double derivatives[], size_t count) {
    if (check_count(instance, function, derivatives, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    const Motor *motor = &instance->now.motor;
    derivatives[0] = motor->omega;
    derivatives[1] = motor_omega_dot(motor);
    derivatives[2] = motor_integral_dot(motor);
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
    const Motor *motor = &instance->now.motor;
    indicators[0] = indicator_friction(motor);
    indicators[1] = indicator_saturation(motor, 1);
    indicators[2] = indicator_saturation(motor, -1);
    return STATUS_OK;
}

/* See instance.h. */
#include "instance.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MESSAGE_SIZE = 512 };

static const char LOG_CATEGORY[] = "logStatusError";

/* Above this a communication step is a mistake in the importer: it would run for minutes. */
static const double MOST_STEPS = 1e9;

/* A communication step this near a whole number of internal steps is meant to be one: importers
 * compute it as a difference of times. */
static const double WHOLE_STEPS_TOLERANCE = 1e-6;

Status fail(const Instance *instance, const char *function, const char *format, ...) {
    char message[MESSAGE_SIZE];
    int length = snprintf(message, sizeof message, "%s: ", function);
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
                state == INSTANTIATED     ? "the state Instantiated"
                : state == INITIALIZATION ? "Initialization Mode"
                : state == STEP           ? "Step Mode"
                                          : "the state Terminated");
}

void instance_reset(Instance *instance) {
    memset(&instance->now, 0, sizeof instance->now);
    Motor *motor = &instance->now.motor;
    memcpy(motor->input, input_start, sizeof motor->input);
    memcpy(motor->parameter, parameter_start, sizeof motor->parameter);
    motor->closed_loop = START_closed_loop;
    motor->solver = START_solver;
    motor_initialise(motor);
    instance->now.stop_time = INFINITY;
    instance->now.life_cycle = INSTANTIATED;
}

Instance *instance_new(const char *name, const char *token, LogFunction *log,
                       void (*callback)(void), void *environment) {
    Instance draft = {.log = log, .callback = callback, .environment = environment};
    if (!name || !*name) {
        fail(&draft, "instantiate", "the instance name is empty");
        return NULL;
    }
    if (!token || strcmp(token, INSTANTIATION_TOKEN) != 0) {
        fail(&draft, "instantiate", "the token \"%s\" is not this FMU's \"%s\": the model "
             "description and the binary are of different builds", token ? token : "",
             INSTANTIATION_TOKEN);
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
    instance_reset(instance);
    return instance;
}

void instance_free(Instance *instance) {
    if (!instance)
        return;
    free(instance->name);
    free(instance);
}

Status instance_check_categories(const Instance *instance, const char *function, size_t count,
                                 const char *const categories[]) {
    for (size_t k = 0; k < count; k++)
        if (!categories || !categories[k] || strcmp(categories[k], LOG_CATEGORY) != 0)
            return fail(instance, function, "there is no log category \"%s\"; use %s",
                        categories && categories[k] ? categories[k] : "", LOG_CATEGORY);
    return STATUS_OK;
}

Status instance_enter_initialization(Instance *instance, const char *function, double start_time,
                                     bool stop_time_defined, double stop_time) {
    if (!isfinite(start_time))
        return fail(instance, function, "the start time is %g; give a finite number", start_time);
    if (stop_time_defined && !(stop_time >= start_time))
        return fail(instance, function, "the stop time %g is before the start time %g", stop_time,
                    start_time);
    instance->now.motor.base_time = start_time;
    instance->now.stop_time = stop_time_defined ? stop_time : INFINITY;
    instance->now.life_cycle = INITIALIZATION;
    return STATUS_OK;
}

static inline bool read_double(const Motor *s, uint32_t reference, double *value) {
    switch (reference) {
    case VR_theta: *value = s->theta; return true;
    case VR_omega: *value = s->omega; return true;
    case VR_omega_dot: *value = motor_omega_dot(s); return true;
    case VR_V_s: *value = motor_voltage(s); return true;
    case VR_i: *value = motor_current(s); return true;
    case VR_time: *value = motor_time(s); return true;
    case VR_integral: *value = s->integral; return true;
    case VR_u: *value = motor_command(s, s->omega, s->integral); return true;
    default: break;
    }
    if (reference - INPUT_FIRST < INPUT_COUNT) {
        *value = s->input[reference - INPUT_FIRST];
        return true;
    }
    if (reference - PARAMETER_FIRST < PARAMETER_COUNT) {
        *value = s->parameter[reference - PARAMETER_FIRST];
        return true;
    }
    return false;
}

/* Why a reference is none of the wanted variables. */
static Status fail_reference(const Instance *instance, const char *function, uint32_t reference,
                             const char *wanted) {
    if (reference < VARIABLE_COUNT)
        return fail(instance, function, "%s is no %s", variable_name[reference], wanted);
    return fail(instance, function, "there is no variable with value reference %u",
                (unsigned)reference);
}

Status instance_get_double(const Instance *instance, const char *function, const uint32_t reference[],
                           size_t count, double value[]) {
    if (count && (!reference || !value))
        return fail(instance, function, "value references or values are missing");
    for (size_t k = 0; k < count; k++)
        if (!read_double(&instance->now.motor, reference[k], &value[k]))
            return fail_reference(instance, function, reference[k], "floating-point variable");
    return STATUS_OK;
}

/* Whether a variable may take a value now; says why not. */
static Status check_double(const Instance *instance, const char *function, uint32_t reference,
                           double value) {
    const bool is_input = reference - INPUT_FIRST < INPUT_COUNT;
    const uint32_t parameter = reference - PARAMETER_FIRST;
    if (!is_input && parameter >= PARAMETER_COUNT)
        return fail_reference(instance, function, reference, "floating-point variable that can be set");
    if (!is_input && !(instance->now.life_cycle & (INSTANTIATED | INITIALIZATION)))
        return fail(instance, function, "%s is a fixed parameter; set it before the simulation starts",
                    variable_name[reference]);
    if (!isfinite(value))
        return fail(instance, function, "%s cannot be %g; give a finite number",
                    variable_name[reference], value);
    if (!is_input && !(value >= parameter_min[parameter]))
        return fail(instance, function, "%s cannot be %g; the least is %g", variable_name[reference],
                    value, parameter_min[parameter]);
    if (!is_input && !(value <= parameter_max[parameter]))
        return fail(instance, function, "%s cannot be %g; the most is %g", variable_name[reference],
                    value, parameter_max[parameter]);
    return STATUS_OK;
}

Status instance_set_double(Instance *instance, const char *function, const uint32_t reference[],
                           size_t count, const double value[]) {
    if (count && (!reference || !value))
        return fail(instance, function, "value references or values are missing");
    Motor *motor = &instance->now.motor;
    bool only_inputs = true;
    for (size_t k = 0; k < count; k++) {
        if (reference[k] - INPUT_FIRST < INPUT_COUNT && isfinite(value[k]))
            continue;
        if (check_double(instance, function, reference[k], value[k]) != STATUS_OK)
            return STATUS_ERROR;
        only_inputs = false;
    }
    for (size_t k = 0; k < count; k++) {
        if (reference[k] - INPUT_FIRST < INPUT_COUNT)
            motor->input[reference[k] - INPUT_FIRST] = value[k];
        else
            motor->parameter[reference[k] - PARAMETER_FIRST] = value[k];
    }
    if (!only_inputs)
        motor_initialise(motor);
    return STATUS_OK;
}

/* The type's options: their references and where their values are. */
static int32_t *find_option(Motor *motor, uint32_t reference, const char *type, int64_t *least,
                            int64_t *most) {
    const bool boolean = reference == VR_closed_loop;
    if (!(boolean || reference == VR_solver) || strcmp(type, boolean ? "Boolean" : "Enumeration") != 0)
        return NULL;
    *least = boolean ? 0 : SOLVER_SEMI_IMPLICIT_EULER;
    *most = boolean ? 1 : SOLVER_RK4;
    return boolean ? &motor->closed_loop : &motor->solver;
}

Status instance_get_option(const Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t *value) {
    int64_t least, most;
    Motor motor = instance->now.motor;
    const int32_t *option = find_option(&motor, reference, type, &least, &most);
    if (!option)
        return fail_reference(instance, function, reference, type);
    *value = *option;
    return STATUS_OK;
}

Status instance_set_option(Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t value) {
    int64_t least, most;
    int32_t *option = find_option(&instance->now.motor, reference, type, &least, &most);
    if (!option)
        return fail_reference(instance, function, reference, type);
    if (!(instance->now.life_cycle & (INSTANTIATED | INITIALIZATION)))
        return fail(instance, function, "%s is a fixed parameter; set it before the simulation starts",
                    variable_name[reference]);
    if (value < least || value > most)
        return fail(instance, function, "%s cannot be %lld; use %lld to %lld",
                    variable_name[reference], (long long)value, (long long)least, (long long)most);
    *option = (int32_t)value;
    return STATUS_OK;
}

/* What is wrong with a communication step; NULL if nothing. */
static Status check_step(const Instance *instance, const char *function, double time,
                         double step_size) {
    const Motor *motor = &instance->now.motor;
    if (!(step_size > 0.0) || !(step_size / motor->step_size <= MOST_STEPS))
        return fail(instance, function,
                    "the communication step is %g s; give a positive one of at most %g s", step_size,
                    MOST_STEPS * motor->step_size);
    /* Importers accumulate rounding; half a step is a lost or a doubled step. */
    const double tolerance = 0.5 * fmin(step_size, motor->step_size);
    if (!(fabs(time - motor_time(motor)) <= tolerance))
        return fail(instance, function, "the communication point is %.17g s but the FMU is at %.17g s",
                    time, motor_time(motor));
    if (!(time + step_size <= instance->now.stop_time + tolerance))
        return fail(instance, function, "the step from %g s by %g s goes beyond the stop time %g s",
                    time, step_size, instance->now.stop_time);
    return STATUS_OK;
}

Status instance_do_step(Instance *instance, const char *function, double time, double step_size) {
    Motor *motor = &instance->now.motor;
    const double h = motor->step_size;
    if (check_step(instance, function, time, step_size) != STATUS_OK)
        return STATUS_ERROR;

    const MotorState before = {motor->theta, motor->omega, motor->integral};
    double rest = 0.0;
    int64_t steps = 1;
    if (step_size != h) {
        const double ratio = step_size / h;
        steps = (int64_t)(ratio + 0.5);
        if (fabs(ratio - (double)steps) > WHOLE_STEPS_TOLERANCE) {
            steps = (int64_t)ratio;
            rest = step_size - (double)steps * h;
        }
    }
    for (int64_t k = 0; k < steps; k++)
        motor_step(motor, h);
    if (rest > 0.0)
        motor_step(motor, rest);

    /* Infinities and NaNs do not go away again: checking at the end is enough. */
    if (!isfinite(motor->theta) || !isfinite(motor->omega) || !isfinite(motor->integral)) {
        motor_set_state(motor, before.theta, before.omega, before.integral);
        return fail(instance, function, "the state grew beyond all bounds in the step from %g s; "
                    "step_size %g s is too long for these parameters", time, h);
    }
    motor->steps += steps;
    if (rest > 0.0) {
        motor->base_time = motor_time(motor) + rest;
        motor->steps = 0;
    }
    return STATUS_OK;
}

/* See instance.h: access to variables by value reference, and their derivatives. */
#include <string.h>

#include "events.h"
#include "instance.h"
#include "sensitivity.h"

static inline bool read_double(const Motor *s, uint32_t reference, double *value) {
    switch (reference) {
    case VR_theta: *value = s->theta; return true;
    case VR_omega: *value = s->omega; return true;
    case VR_omega_dot: *value = motor_omega_dot(s); return true;
    case VR_V_s: *value = motor_voltage(s); return true;
    case VR_i: *value = motor_current(s); return true;
    case VR_time: *value = s->time; return true;
    case VR_integral: *value = s->integral; return true;
    case VR_u: *value = motor_present_command(s); return true;
    case VR_der_theta: *value = s->omega; return true;
    case VR_der_integral: *value = motor_integral_dot(s); return true;
    case VR_z_friction: *value = indicator_friction(s); return true;
    case VR_z_upper: *value = indicator_saturation(s, 1); return true;
    case VR_z_lower: *value = indicator_saturation(s, -1); return true;
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

static Status fail_arrays(const Instance *instance, const char *function) {
    return fail(instance, function, "an array of value references or values is null");
}

static Status fail_fixed(const Instance *instance, const char *function, uint32_t reference) {
    return fail(instance, function, "%s is a fixed parameter; set it before the simulation starts",
                variable_name[reference]);
}

Status instance_get_double(const Instance *instance, const char *function,
                           const uint32_t references[], size_t count, double values[]) {
    if (count && (!references || !values))
        return fail_arrays(instance, function);
    for (size_t k = 0; k < count; k++)
        if (!read_double(&instance->now.motor, references[k], &values[k]))
            return fail_reference(instance, function, references[k], "floating-point variable");
    return STATUS_OK;
}

/* Whether a variable may take a value now; says why not. */
static Status check_double(const Instance *instance, const char *function, uint32_t reference,
                           double value) {
    const bool is_input = reference - INPUT_FIRST < INPUT_COUNT;
    const uint32_t parameter = reference - PARAMETER_FIRST;
    if (!is_input && parameter >= PARAMETER_COUNT)
        return fail_reference(instance, function, reference,
                              "floating-point variable that can be set");
    if (!is_input && !(instance->now.life_cycle & STARTING))
        return fail_fixed(instance, function, reference);
    if (!isfinite(value))
        return fail(instance, function, "%s cannot be %g; give a finite number",
                    variable_name[reference], value);
    if (!is_input && !(value >= parameter_min[parameter]))
        return fail(instance, function, "%s cannot be %g; the least is %g",
                    variable_name[reference], value, parameter_min[parameter]);
    if (!is_input && !(value <= parameter_max[parameter]))
        return fail(instance, function, "%s cannot be %g; the most is %g",
                    variable_name[reference], value, parameter_max[parameter]);
    return STATUS_OK;
}

Status instance_set_double(Instance *instance, const char *function, const uint32_t references[],
                           size_t count, const double values[]) {
    if (count && (!references || !values))
        return fail_arrays(instance, function);
    Motor *motor = &instance->now.motor;
    bool only_inputs = true;
    for (size_t k = 0; k < count; k++) {
        if (references[k] - INPUT_FIRST < INPUT_COUNT && isfinite(values[k]))
            continue;
        if (check_double(instance, function, references[k], values[k]) != STATUS_OK)
            return STATUS_ERROR;
        only_inputs = false;
    }
    for (size_t k = 0; k < count; k++) {
        if (references[k] - INPUT_FIRST < INPUT_COUNT)
            motor->input[references[k] - INPUT_FIRST] = values[k];
        else
            motor->parameter[references[k] - PARAMETER_FIRST] = values[k];
    }
    if (instance->now.life_cycle == EVENT)
        motor->jumped = 1;
    if (!only_inputs)
        motor_initialise(motor);
    return STATUS_OK;
}

typedef struct {
    const char *type;
    int32_t value, least, most;
} Option;

/* False if the reference is no option of that type. */
static bool find_option(const Motor *motor, uint32_t reference, const char *type, Option *option) {
    if (reference == VR_closed_loop)
        *option = (Option){"Boolean", motor->closed_loop, 0, 1};
    else if (reference == VR_solver)
        *option = (Option){"Enumeration", motor->solver, SOLVER_SEMI_IMPLICIT_EULER, SOLVER_RK4};
    else
        return false;
    return strcmp(option->type, type) == 0;
}

Status instance_get_option(const Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t *value) {
    Option option;
    if (!find_option(&instance->now.motor, reference, type, &option))
        return fail_reference(instance, function, reference, type);
    *value = option.value;
    return STATUS_OK;
}

Status instance_set_option(Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t value) {
    Option option;
    if (!find_option(&instance->now.motor, reference, type, &option))
        return fail_reference(instance, function, reference, type);
    if (!(instance->now.life_cycle & STARTING))
        return fail_fixed(instance, function, reference);
    if (value < option.least || value > option.most)
        return fail(instance, function, "%s cannot be %lld; use %d to %d", variable_name[reference],
                    (long long)value, (int)option.least, (int)option.most);
    if (reference == VR_closed_loop)
        instance->now.motor.closed_loop = (int32_t)value;
    else
        instance->now.motor.solver = (int32_t)value;
    return STATUS_OK;
}

/* Derivative of an unknown by a known; says why there is none. */
static Status find_partial(const Instance *instance, const char *function, uint32_t unknown,
                           uint32_t known, double *value) {
    const bool starting = instance->now.life_cycle == INITIALIZATION;
    const bool is_parameter = known - PARAMETER_FIRST < PARAMETER_COUNT;
    const bool is_state = known == VR_theta || known == VR_omega || known == VR_integral;
    if (!(known - INPUT_FIRST < INPUT_COUNT || is_state || (starting && is_parameter)))
        return fail_reference(instance, function, known,
                              starting ? "input, state or floating-point parameter"
                                       : "input or state");
    if (known == VR_theta_start)
        known = VR_theta;
    if (known == VR_omega_start)
        known = VR_omega;
    if (!partial(&instance->now.motor, unknown, known, value))
        return fail_reference(instance, function, unknown, "unknown with partial derivatives");
    return STATUS_OK;
}

Status instance_directional(const Instance *instance, const char *function,
                            const uint32_t unknowns[], size_t unknown_count,
                            const uint32_t knowns[], size_t known_count, const double seed[],
                            double sensitivity[]) {
    if ((unknown_count && (!unknowns || !sensitivity)) || (known_count && (!knowns || !seed)))
        return fail_arrays(instance, function);
    for (size_t row = 0; row < unknown_count; row++) {
        double sum = 0.0, slope;
        for (size_t column = 0; column < known_count; column++) {
            if (find_partial(instance, function, unknowns[row], knowns[column], &slope) != STATUS_OK)
                return STATUS_ERROR;
            sum += slope * seed[column];
        }
        sensitivity[row] = sum;
    }
    return STATUS_OK;
}

Status instance_adjoint(const Instance *instance, const char *function, const uint32_t unknowns[],
                        size_t unknown_count, const uint32_t knowns[], size_t known_count,
                        const double seed[], double sensitivity[]) {
    if ((unknown_count && (!unknowns || !seed)) || (known_count && (!knowns || !sensitivity)))
        return fail_arrays(instance, function);
    for (size_t column = 0; column < known_count; column++) {
        double sum = 0.0, slope;
        for (size_t row = 0; row < unknown_count; row++) {
            if (find_partial(instance, function, unknowns[row], knowns[column], &slope) != STATUS_OK)
                return STATUS_ERROR;
            sum += slope * seed[row];
        }
        sensitivity[column] = sum;
    }
    return STATUS_OK;
}

Status instance_output_derivatives(const Instance *instance, const char *function,
                                   const uint32_t references[], size_t count,
                                   const int32_t orders[], double values[]) {
    if (count && (!references || !orders || !values))
        return fail_arrays(instance, function);
    const uint32_t states[] = {VR_theta, VR_omega, VR_integral};
    const Motor *motor = &instance->now.motor;
    const double rates[] = {motor->omega, motor_omega_dot(motor), motor_integral_dot(motor)};
    for (size_t k = 0; k < count; k++) {
        if (orders[k] != 1)
            return fail(instance, function, "order %d is not offered; only 1", (int)orders[k]);
        if (references[k] - OUTPUT_FIRST >= OUTPUT_COUNT)
            return fail_reference(instance, function, references[k], "output");
        if (instance_directional(instance, function, &references[k], 1, states, STATE_COUNT, rates,
                                 &values[k]) != STATUS_OK)
            return STATUS_ERROR;
    }
    return STATUS_OK;
}

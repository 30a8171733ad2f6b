/* See instance.h and motor_instance.h: access to variables of one motor by value reference, and their
 * derivatives. */
#include <string.h>

#include "events.h"
#include "motor_instance.h"
#include "sensitivity.h"

static inline bool read_double(const Instance *instance, uint32_t reference, double *value) {
    const Motor *s = motor_in(instance);
    switch (reference) {
    case VR_theta: *value = s->x.theta; return true;
    case VR_omega: *value = s->x.omega; return true;
    case VR_omega_dot: *value = single_omega_dot(s); return true;
    case VR_V_s: *value = single_voltage(s); return true;
    case VR_i: *value = single_current(s); return true;
    case VR_time: *value = instance->now.time; return true;
    case VR_integral: *value = s->x.integral; return true;
    case VR_u: *value = single_command(s); return true;
    case VR_der_theta: *value = s->x.omega; return true;
    case VR_der_integral: *value = single_integral_dot(s); return true;
    case VR_z_friction: *value = indicator_friction(s); return true;
    case VR_z_upper: *value = indicator_saturation(s, 1); return true;
    case VR_z_lower: *value = indicator_saturation(s, -1); return true;
    default: break;
    }
    if (reference - INPUT_FIRST < INPUT_COUNT) {
        *value = s->in.value[reference - INPUT_FIRST];
        return true;
    }
    if (reference - PARAMETER_FIRST < PARAMETER_COUNT) {
        *value = s->p.value[reference - PARAMETER_FIRST];
        return true;
    }
    return false;
}

/* Whether the arrays of a call go together; says why not. */
static inline Status check_arrays(const Instance *instance, const char *function,
                                  const uint32_t references[], size_t count, const double values[],
                                  size_t value_count) {
    if (count != value_count)
        return fail(instance, function, "%lu value references but %lu values",
                    (unsigned long)count, (unsigned long)value_count);
    return count && (!references || !values) ? fail_arrays(instance, function) : STATUS_OK;
}

Status model_get_double(const Instance *instance, const char *function, const uint32_t references[],
                        size_t count, double values[], size_t value_count) {
    if (check_arrays(instance, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++)
        if (!read_double(instance, references[k], &values[k]))
            return fail_reference(instance, function, references[k], "floating-point variable");
    return STATUS_OK;
}

Status model_set_double(Instance *instance, const char *function, const uint32_t references[],
                        size_t count, const double values[], size_t value_count) {
    if (check_arrays(instance, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    Motor *motor = motor_of(instance);
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
            motor->in.value[references[k] - INPUT_FIRST] = values[k];
        else
            motor->p.value[references[k] - PARAMETER_FIRST] = values[k];
    }
    if (instance->now.life_cycle == EVENT)
        motor->jumped = 1;
    if (!only_inputs)
        single_initialise(motor);
    return STATUS_OK;
}

typedef struct {
    const char *type;
    int32_t value, least, most;
} Option;

/* False if the reference is no option of that type. */
static bool find_option(const Motor *motor, uint32_t reference, const char *type, Option *option) {
    if (reference == VR_closed_loop)
        *option = (Option){"Boolean", motor->p.closed_loop, 0, 1};
    else if (reference == VR_solver)
        *option = (Option){"Enumeration", motor->p.solver, SOLVER_SEMI_IMPLICIT_EULER, SOLVER_RK4};
    else
        return false;
    return strcmp(option->type, type) == 0;
}

Status model_get_option(const Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t *value) {
    Option option;
    if (!find_option(motor_in(instance), reference, type, &option))
        return fail_reference(instance, function, reference, type);
    *value = option.value;
    return STATUS_OK;
}

Status model_set_option(Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t value) {
    Option option;
    if (!find_option(motor_in(instance), reference, type, &option))
        return fail_reference(instance, function, reference, type);
    if (!(instance->now.life_cycle & STARTING))
        return fail_fixed(instance, function, reference);
    if (value < option.least || value > option.most)
        return fail(instance, function, "%s cannot be %lld; use %d to %d", variable_name[reference],
                    (long long)value, (int)option.least, (int)option.most);
    if (reference == VR_closed_loop)
        motor_of(instance)->p.closed_loop = (int32_t)value;
    else
        motor_of(instance)->p.solver = (int32_t)value;
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
    if (!partial(motor_in(instance), unknown, known, value))
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
    const Motor *motor = motor_in(instance);
    const double rates[] = {motor->x.omega, single_omega_dot(motor), single_integral_dot(motor)};
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

/* See motor_instance.h: derivatives of one motor's variables by value reference. */
#include "events.h"
#include "motor_instance.h"
#include "sensitivity.h"

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
    if (!partial(plain_in(instance), unknown, known, value))
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
    const Motor *motor = plain_in(instance);
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

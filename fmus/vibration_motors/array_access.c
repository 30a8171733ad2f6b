/* See instance.h and array.h: access to variables of an array of motors by value reference. */
#include "array.h"

/* Where a block keeps a variable; ROW_COUNT if it does not. */
static inline size_t row_of(uint32_t reference) {
    if (reference - VR_theta <= VR_omega_dot - VR_theta)
        return ROW_THETA + (reference - VR_theta);
    if (reference - INPUT_FIRST < INPUT_COUNT)
        return ROW_INPUT + (reference - INPUT_FIRST);
    if (reference - PARAMETER_FIRST < MOTOR_PARAMETER_COUNT)
        return ROW_PARAMETER + (reference - PARAMETER_FIRST);
    return reference == VR_integral ? ROW_INTEGRAL : ROW_COUNT;
}

_Static_assert(VR_omega_dot - VR_theta == ROW_OMEGA_DOT - ROW_THETA, "rows as variables");

static inline bool is_sampled(uint32_t reference) {
    return reference - VR_theta_samples < SAMPLED;
}

/* How many values a variable has. */
static inline size_t length_of(const Motors *motors, uint32_t reference) {
    if (reference == VR_time || reference == VR_step_size)
        return 1;
    return is_sampled(reference) ? motors->samples * motors->n : motors->n;
}

static void read_samples(const Motors *motors, size_t output, double values[]) {
    const size_t n = motors->n, stride = sample_stride(n);
    const double *row = motors->sampled + output * motors->samples * stride;
    if (motors->samples == 1)
        motors_read(motors, ROW_THETA + output, values);
    else if (n == stride)
        memcpy(values, row, motors->samples * n * sizeof *values);
    else
        for (size_t part = 0; part < motors->samples; part++, row += stride, values += n)
            memcpy(values, row, n * sizeof *values);
}

static inline double electrical(const Motors *motors, size_t k, uint32_t reference) {
    const Block *b = &motors->blocks[k / LANES];
    const MotorInputs in = lane_inputs(b, k % LANES);
    const MotorConstants p = lane_constants(b, k % LANES, motors->closed_loop);
    const MotorState x = lane_state(b, k % LANES);
    const double u = motor_command(&p, &in, x.omega, x.integral), V_s = motor_saturate(&p, u);
    return reference == VR_u ? u : reference == VR_i ? motor_current(&p, x.omega, V_s) : V_s;
}

static bool read_doubles(const Motors *motors, uint32_t reference, double values[]) {
    const size_t row = row_of(reference);
    if (row < ROW_COUNT)
        motors_read(motors, row, values);
    else if (is_sampled(reference))
        read_samples(motors, reference - VR_theta_samples, values);
    else if (reference == VR_V_s || reference == VR_i || reference == VR_u)
        for (size_t k = 0; k < motors->n; k++)
            values[k] = electrical(motors, k, reference);
    else if (reference == VR_time)
        *values = motors->base.now.time;
    else if (reference == VR_step_size)
        *values = motors->step_size;
    else
        return false;
    return true;
}

/* Whether the arrays of a call go together; says why not. */
static Status check_arrays(const Motors *motors, const char *function, const uint32_t references[],
                           size_t count, const void *values, size_t value_count) {
    if (count && (!references || !values))
        return fail_arrays(&motors->base, function);
    size_t wanted = 0;
    for (size_t k = 0; k < count; k++)
        wanted += length_of(motors, references[k]);
    if (wanted != value_count)
        return fail(&motors->base, function, "%lu values, but the variables have %lu",
                    (unsigned long)value_count, (unsigned long)wanted);
    return STATUS_OK;
}

Status model_get_double(const Instance *instance, const char *function, const uint32_t references[],
                        size_t count, double values[], size_t value_count) {
    const Motors *motors = motors_in(instance);
    if (check_arrays(motors, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++) {
        if (!read_doubles(motors, references[k], values))
            return fail_reference(instance, function, references[k], "floating-point variable");
        values += length_of(motors, references[k]);
    }
    return STATUS_OK;
}

Status model_set_double(Instance *instance, const char *function, const uint32_t references[],
                        size_t count, const double values[], size_t value_count) {
    Motors *motors = motors_of(instance);
    if (check_arrays(motors, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    bool only_inputs = true;
    const double *value = values;
    for (size_t k = 0; k < count; k++) {
        const bool is_input = references[k] - INPUT_FIRST < INPUT_COUNT;
        only_inputs &= is_input;
        for (size_t j = length_of(motors, references[k]); j > 0; j--, value++)
            if (!(is_input && isfinite(*value)) &&
                check_double(instance, function, references[k], *value) != STATUS_OK)
                return STATUS_ERROR;
    }
    for (size_t k = 0; k < count; k++) {
        if (references[k] == VR_step_size)
            motors->step_size = *values;
        else
            motors_write(motors, row_of(references[k]), values);
        values += length_of(motors, references[k]);
    }
    if (only_inputs)
        motors_refresh(motors);
    else if (instance->now.life_cycle & STARTING)
        motors_initialise(motors);
    else
        motors_tune(motors);
    return STATUS_OK;
}

Status model_get_option(const Instance *instance, const char *function, uint32_t reference,
                        const char *type, int64_t *value) {
    if (reference != VR_closed_loop)
        return fail_reference(instance, function, reference, type);
    *value = motors_in(instance)->closed_loop;
    return STATUS_OK;
}

Status model_check_option(const Instance *instance, const char *function, uint32_t reference,
                          const char *type, int64_t value) {
    (void)value;
    if (reference != VR_closed_loop)
        return fail_reference(instance, function, reference, type);
    if (!(instance->now.life_cycle & STARTING))
        return fail_fixed(instance, function, reference);
    return STATUS_OK;
}

void model_set_option(Instance *instance, uint32_t reference, const char *type, int64_t value) {
    (void)reference, (void)type; /* there is one */
    motors_of(instance)->closed_loop = value != 0;
    motors_refresh(motors_of(instance));
}

static Status check_restart(const Motors *motors, const char *function, const uint32_t references[],
                            size_t count, const void *values, size_t value_count) {
    if (check_arrays(motors, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++)
        if (references[k] != VR_restart)
            return fail_reference(&motors->base, function, references[k], "Int64 variable");
    return STATUS_OK;
}

Status instance_get_restart(const Instance *instance, const char *function,
                            const uint32_t references[], size_t count, int64_t values[],
                            size_t value_count) {
    const Motors *motors = motors_in(instance);
    if (check_restart(motors, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < value_count; k++)
        values[k] = motors->blocks[k % motors->n / LANES].restart[k % motors->n % LANES];
    return STATUS_OK;
}

Status instance_set_restart(Instance *instance, const char *function, const uint32_t references[],
                            size_t count, const int64_t values[], size_t value_count) {
    Motors *motors = motors_of(instance);
    if (check_restart(motors, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < value_count; k++)
        motors->blocks[k % motors->n / LANES].restart[k % motors->n % LANES] = values[k];
    motors->restarting = true;
    return STATUS_OK;
}

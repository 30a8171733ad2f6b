/* The FMI 3.0 FMU of an array of motors in one translation unit: all that it shows to a linker are
 * the functions of the standard, with the model's name before theirs. A shared library has them
 * under their plain names: define FMI3_OVERRIDE_FUNCTION_PREFIX for it. */
#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX VibrationMotors_
#endif
#include "array.c"

#include "fmi3.c"

/* The calls that only this model has. */

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, INSTANTIATED);
    self->now.life_cycle = CONFIGURATION;
    return fmi3OK;
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, CONFIGURATION);
    self->now.life_cycle = INSTANTIATED;
    return fmi3OK;
}

/* The numbers of motors and of samples are the only UInt64. */
static fmi3Status check_sizes(const Instance *self, const char *function,
                              const fmi3ValueReference references[], size_t count,
                              const fmi3UInt64 values[]) {
    if (count && (!references || !values))
        return (fmi3Status)fail_arrays(self, function);
    for (size_t k = 0; k < count; k++)
        if (references[k] != VR_n && references[k] != VR_samples)
            return (fmi3Status)fail_reference(self, function, references[k], "UInt64 variable");
    return fmi3OK;
}

fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                         size_t nValueReferences, fmi3UInt64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, READABLE | CONFIGURATION);
    REQUIRE_EQUAL_COUNTS(self, nValueReferences, nValues);
    if (check_sizes(self, __func__, valueReferences, nValues, values) != fmi3OK)
        return fmi3Error;
    const Motors *motors = motors_in(self);
    for (size_t k = 0; k < nValues; k++)
        values[k] = valueReferences[k] == VR_n ? motors->n : motors->samples;
    return fmi3OK;
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                         size_t nValueReferences, const fmi3UInt64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, CONFIGURATION);
    REQUIRE_EQUAL_COUNTS(self, nValueReferences, nValues);
    if (check_sizes(self, __func__, valueReferences, nValues, values) != fmi3OK)
        return fmi3Error;
    Motors *motors = motors_of(self);
    uint64_t n = motors->n, samples = motors->samples;
    for (size_t k = 0; k < nValues; k++) {
        const bool is_n = valueReferences[k] == VR_n;
        const int least = is_n ? LEAST_n : LEAST_samples, most = is_n ? MOST_n : MOST_samples;
        if (values[k] < (uint64_t)least || values[k] > (uint64_t)most)
            return (fmi3Status)fail(self, __func__, "%s cannot be %llu; use %d to %d",
                                    variable_name[valueReferences[k]],
                                    (unsigned long long)values[k], least, most);
        *(is_n ? &n : &samples) = values[k];
    }
    return nValues ? (fmi3Status)motors_allocate(motors, __func__, n, samples) : fmi3OK;
}

/* The restarts are the only Int64. */
static Status check_restart(const Motors *motors, const char *function, const uint32_t references[],
                            size_t count, const void *values, size_t value_count) {
    if (check_arrays(motors, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++)
        if (references[k] != VR_restart)
            return fail_reference(&motors->base, function, references[k], "Int64 variable");
    return STATUS_OK;
}

fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, fmi3Int64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    const Motors *motors = motors_in(self);
    if (check_restart(motors, __func__, valueReferences, nValueReferences, values, nValues) !=
        STATUS_OK)
        return fmi3Error;
    for (size_t k = 0; k < nValues; k++)
        values[k] = motors->blocks[k % motors->n / LANES].restart[k % motors->n % LANES];
    return fmi3OK;
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, const fmi3Int64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, WRITABLE);
    Motors *motors = motors_of(self);
    if (check_restart(motors, __func__, valueReferences, nValueReferences, values, nValues) !=
        STATUS_OK)
        return fmi3Error;
    for (size_t k = 0; k < nValues; k++)
        motors->blocks[k % motors->n / LANES].restart[k % motors->n % LANES] = values[k];
    motors->restarting = true;
    return fmi3OK;
}

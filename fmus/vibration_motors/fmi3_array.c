/* FMI 3.0 shim of VibrationMotors: the calls that only this model has, after those of fmi3.c. */
#include "array.h"

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

fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, fmi3Int64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    return (fmi3Status)instance_get_restart(self, __func__, valueReferences, nValueReferences,
                                            values, nValues);
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, const fmi3Int64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, WRITABLE);
    return (fmi3Status)instance_set_restart(self, __func__, valueReferences, nValueReferences,
                                            values, nValues);
}

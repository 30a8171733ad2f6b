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

/* The number of motors is the only UInt64. */
static fmi3Status check_n(const Instance *self, const char *function,
                          const fmi3ValueReference references[], size_t count,
                          const fmi3UInt64 values[]) {
    if (count && (!references || !values))
        return (fmi3Status)fail_arrays(self, function);
    for (size_t k = 0; k < count; k++)
        if (references[k] != VR_n)
            return (fmi3Status)fail_reference(self, function, references[k], "UInt64 variable");
    return fmi3OK;
}

fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                         size_t nValueReferences, fmi3UInt64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, READABLE | CONFIGURATION);
    REQUIRE_EQUAL_COUNTS(self, nValueReferences, nValues);
    if (check_n(self, __func__, valueReferences, nValues, values) != fmi3OK)
        return fmi3Error;
    for (size_t k = 0; k < nValues; k++)
        values[k] = motors_of(self)->n;
    return fmi3OK;
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                         size_t nValueReferences, const fmi3UInt64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, CONFIGURATION);
    REQUIRE_EQUAL_COUNTS(self, nValueReferences, nValues);
    if (check_n(self, __func__, valueReferences, nValues, values) != fmi3OK)
        return fmi3Error;
    for (size_t k = 0; k < nValues; k++)
        if (values[k] < LEAST_n || values[k] > MOST_n)
            return (fmi3Status)fail(self, __func__, "n cannot be %llu; use %d to %d",
                                    (unsigned long long)values[k], LEAST_n, MOST_n);
    return nValues ? (fmi3Status)motors_allocate(motors_of(self), __func__, values[nValues - 1])
                   : fmi3OK;
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

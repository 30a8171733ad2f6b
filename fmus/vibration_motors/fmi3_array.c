/* FMI 3.0 shim of VibrationMotors: the calls that only this model has, after those of fmi3.c. */
#include "array.h"

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible,
                                          fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    return no_instance(__func__, loggingOn, instanceEnvironment, logMessage);
}

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

NOT_OFFERED(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[],
            size_t nValues)
NOT_OFFERED(fmi3GetDirectionalDerivative, const fmi3ValueReference unknowns[], size_t nUnknowns,
            const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
            size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
NOT_OFFERED(fmi3GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t nUnknowns,
            const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
            size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
NOT_OFFERED(fmi3EnterEventMode)
NOT_OFFERED(fmi3EnterContinuousTimeMode)
NOT_OFFERED(fmi3UpdateDiscreteStates, fmi3Boolean *discreteStatesNeedUpdate,
            fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
            fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
            fmi3Float64 *nextEventTime)
NOT_OFFERED(fmi3CompletedIntegratorStep, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
            fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
NOT_OFFERED(fmi3SetTime, fmi3Float64 time)
NOT_OFFERED(fmi3SetContinuousStates, const fmi3Float64 continuousStates[],
            size_t nContinuousStates)
NOT_OFFERED(fmi3GetContinuousStates, fmi3Float64 continuousStates[], size_t nContinuousStates)
NOT_OFFERED(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[],
            size_t nContinuousStates)
NOT_OFFERED(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t nContinuousStates)
NOT_OFFERED(fmi3GetEventIndicators, fmi3Float64 eventIndicators[], size_t nEventIndicators)
NOT_OFFERED(fmi3GetNumberOfContinuousStates, size_t *nContinuousStates)
NOT_OFFERED(fmi3GetNumberOfEventIndicators, size_t *nEventIndicators)

/* FMI 3.0 shim of VibrationMotor: the calls that only this model has, after those of fmi3.c. */
#include "events.h"
#include "motor_instance.h"

/* Enumerations are Int64 in FMI 3. */
OPTION_ACCESS(Int64, "Enumeration")

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance,
                                    const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[],
                                    fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, STEP | TERMINATED);
    REQUIRE_EQUAL_COUNTS(self, nValueReferences, nValues);
    return (fmi3Status)instance_output_derivatives(self, __func__, valueReferences, nValues, orders,
                                                   values);
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                        size_t nUnknowns, const fmi3ValueReference knowns[],
                                        size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                        fmi3Float64 sensitivity[], size_t nSensitivity) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    REQUIRE_EQUAL_COUNTS(self, nKnowns, nSeed);
    REQUIRE_EQUAL_COUNTS(self, nUnknowns, nSensitivity);
    return (fmi3Status)instance_directional(self, __func__, unknowns, nUnknowns, knowns, nKnowns,
                                            seed, sensitivity);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t nUnknowns, const fmi3ValueReference knowns[],
                                    size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                    fmi3Float64 sensitivity[], size_t nSensitivity) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    REQUIRE_EQUAL_COUNTS(self, nUnknowns, nSeed);
    REQUIRE_EQUAL_COUNTS(self, nKnowns, nSensitivity);
    return (fmi3Status)instance_adjoint(self, __func__, unknowns, nUnknowns, knowns, nKnowns, seed,
                                        sensitivity);
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, CONTINUOUS_TIME);
    self->now.life_cycle = EVENT;
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, EVENT);
    self->now.life_cycle = CONTINUOUS_TIME;
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime) {
    Instance *self = instance;
    REQUIRE(self, EVENT);
    REQUIRE_POINTER(self, discreteStatesNeedUpdate);
    REQUIRE_POINTER(self, terminateSimulation);
    REQUIRE_POINTER(self, nominalsOfContinuousStatesChanged);
    REQUIRE_POINTER(self, valuesOfContinuousStatesChanged);
    REQUIRE_POINTER(self, nextEventTimeDefined);
    REQUIRE_POINTER(self, nextEventTime);
    *valuesOfContinuousStatesChanged = events_update(plain_of(self));
    *discreteStatesNeedUpdate = fmi3False;
    *terminateSimulation = fmi3False;
    *nominalsOfContinuousStatesChanged = fmi3False;
    *nextEventTimeDefined = fmi3False;
    *nextEventTime = 0.0;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance,
                                       fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode,
                                       fmi3Boolean *terminateSimulation) {
    Instance *self = instance;
    REQUIRE(self, CONTINUOUS_TIME);
    REQUIRE_POINTER(self, enterEventMode);
    REQUIRE_POINTER(self, terminateSimulation);
    *enterEventMode = fmi3False;
    *terminateSimulation = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
    Instance *self = instance;
    REQUIRE(self, EVENT | CONTINUOUS_TIME);
    return (fmi3Status)instance_set_time(self, __func__, time);
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates) {
    Instance *self = instance;
    REQUIRE(self, CONTINUOUS_TIME);
    return (fmi3Status)instance_set_states(self, __func__, continuousStates, nContinuousStates);
}

#define STATE_GETTER(name, states, getter)                                                         \
    fmi3Status name(fmi3Instance instance, fmi3Float64 values[], size_t count) {                   \
        Instance *self = instance;                                                                 \
        REQUIRE(self, states);                                                                     \
        return (fmi3Status)getter(self, __func__, values, count);                                  \
    }

STATE_GETTER(fmi3GetContinuousStates, INITIALIZATION | EVENT | CONTINUOUS_TIME | TERMINATED,
             instance_get_states)
STATE_GETTER(fmi3GetContinuousStateDerivatives,
             INITIALIZATION | EVENT | CONTINUOUS_TIME | TERMINATED, instance_get_derivatives)
STATE_GETTER(fmi3GetNominalsOfContinuousStates, READABLE, instance_get_nominals)
STATE_GETTER(fmi3GetEventIndicators, INITIALIZATION | EVENT | CONTINUOUS_TIME | TERMINATED,
             instance_get_indicators)

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, nContinuousStates);
    *nContinuousStates = STATE_COUNT;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, nEventIndicators);
    *nEventIndicators = INDICATOR_COUNT;
    return fmi3OK;
}

NO_VARIABLES(UInt64)

NOT_OFFERED(fmi3EnterConfigurationMode)
NOT_OFFERED(fmi3ExitConfigurationMode)

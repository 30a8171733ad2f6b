/* FMI 3.0 shim: translates the calls of the standard to instance.h and nothing else.
 * The standard's header marks every function for export. */
#include "fmi3Functions.h"

#include "events.h"
#include "instance.h"

/* Refuse arrays of different lengths: no variable of this FMU is an array. */
#define REQUIRE_EQUAL_COUNTS(references, values)                                                   \
    do {                                                                                           \
        if ((references) != (values))                                                              \
            return (fmi3Status)fail(self, __func__, "%lu value references but %lu values",         \
                                    (unsigned long)(references), (unsigned long)(values));         \
    } while (0)

static void log_fmi3(const Instance *self, Status status, const char *category,
                     const char *message) {
    const fmi3LogMessageCallback callback = (fmi3LogMessageCallback)self->callback;
    if (callback)
        callback(self->environment, (fmi3Status)status, category, message);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[]) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    return (fmi3Status)instance_set_logging(self, __func__, loggingOn, nCategories, categories);
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
    fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate) {
    Instance *self = instance_new(instanceName, instantiationToken, false, log_fmi3,
                                  (void (*)(void))logMessage, instanceEnvironment, loggingOn);
    if (!self)
        return NULL;
    if (eventModeUsed || nRequiredIntermediateVariables) {
        fail(self, __func__, "this FMU has no Event Mode and no intermediate updates in co-simulation");
        instance_free(self);
        return NULL;
    }
    return self;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible,
                                          fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    return instance_new(instanceName, instantiationToken, true, log_fmi3,
                        (void (*)(void))logMessage, instanceEnvironment, loggingOn);
}

void fmi3FreeInstance(fmi3Instance instance) { instance_free(instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    Instance *self = instance;
    REQUIRE(self, INSTANTIATED);
    if (instance_set_experiment(self, __func__, startTime, stopTimeDefined, stopTime) != STATUS_OK)
        return fmi3Error;
    self->now.life_cycle = INITIALIZATION;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, INITIALIZATION);
    instance_exit_initialization(self);
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, RUNNING);
    self->now.life_cycle = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    instance_reset(self);
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    REQUIRE_EQUAL_COUNTS(nValueReferences, nValues);
    return (fmi3Status)instance_get_double(self, __func__, valueReferences, nValues, values);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, WRITABLE);
    REQUIRE_EQUAL_COUNTS(nValueReferences, nValues);
    return (fmi3Status)instance_set_double(self, __func__, valueReferences, nValues, values);
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Boolean values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    REQUIRE_EQUAL_COUNTS(nValueReferences, nValues);
    if (nValues) {
        REQUIRE_POINTER(self, valueReferences);
        REQUIRE_POINTER(self, values);
    }
    for (size_t k = 0; k < nValues; k++) {
        int64_t value;
        if (instance_get_option(self, __func__, valueReferences[k], "Boolean", &value) != STATUS_OK)
            return fmi3Error;
        values[k] = value != 0;
    }
    return fmi3OK;
}

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Boolean values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, WRITABLE);
    REQUIRE_EQUAL_COUNTS(nValueReferences, nValues);
    if (nValues) {
        REQUIRE_POINTER(self, valueReferences);
        REQUIRE_POINTER(self, values);
    }
    for (size_t k = 0; k < nValues; k++)
        if (instance_set_option(self, __func__, valueReferences[k], "Boolean", values[k]) != STATUS_OK)
            return fmi3Error;
    return fmi3OK;
}

/* Enumerations are Int64 in FMI 3. */
fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, fmi3Int64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    REQUIRE_EQUAL_COUNTS(nValueReferences, nValues);
    if (nValues) {
        REQUIRE_POINTER(self, valueReferences);
        REQUIRE_POINTER(self, values);
    }
    for (size_t k = 0; k < nValues; k++) {
        int64_t value;
        if (instance_get_option(self, __func__, valueReferences[k], "Enumeration", &value) != STATUS_OK)
            return fmi3Error;
        values[k] = value;
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                        size_t nValueReferences, const fmi3Int64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, WRITABLE);
    REQUIRE_EQUAL_COUNTS(nValueReferences, nValues);
    if (nValues) {
        REQUIRE_POINTER(self, valueReferences);
        REQUIRE_POINTER(self, values);
    }
    for (size_t k = 0; k < nValues; k++)
        if (instance_set_option(self, __func__, valueReferences[k], "Enumeration", values[k]) !=
            STATUS_OK)
            return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    Instance *self = instance;
    REQUIRE(self, STEP);
    const Status status =
        instance_do_step(self, __func__, currentCommunicationPoint, communicationStepSize);
    if (eventHandlingNeeded)
        *eventHandlingNeeded = fmi3False;
    if (terminateSimulation)
        *terminateSimulation = fmi3False;
    if (earlyReturn)
        *earlyReturn = fmi3False;
    if (lastSuccessfulTime)
        *lastSuccessfulTime = self->now.motor.time;
    return (fmi3Status)status;
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance,
                                    const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[],
                                    fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, STEP | TERMINATED);
    REQUIRE_EQUAL_COUNTS(nValueReferences, nValues);
    return (fmi3Status)instance_output_derivatives(self, __func__, valueReferences, nValues, orders,
                                                   values);
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                        size_t nUnknowns, const fmi3ValueReference knowns[],
                                        size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                        fmi3Float64 sensitivity[], size_t nSensitivity) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    REQUIRE_EQUAL_COUNTS(nKnowns, nSeed);
    REQUIRE_EQUAL_COUNTS(nUnknowns, nSensitivity);
    return (fmi3Status)instance_directional(self, __func__, unknowns, nUnknowns, knowns, nKnowns,
                                            seed, sensitivity);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t nUnknowns, const fmi3ValueReference knowns[],
                                    size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                    fmi3Float64 sensitivity[], size_t nSensitivity) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    REQUIRE_EQUAL_COUNTS(nUnknowns, nSeed);
    REQUIRE_EQUAL_COUNTS(nKnowns, nSensitivity);
    return (fmi3Status)instance_adjoint(self, __func__, unknowns, nUnknowns, knowns, nKnowns, seed,
                                        sensitivity);
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUState);
    return (fmi3Status)instance_save(self, __func__, FMUState);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUState);
    return (fmi3Status)instance_restore(self, __func__, FMUState);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    if (FMUState) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUState);
    REQUIRE_POINTER(self, size);
    *size = instance_serialized_size();
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState,
                                 fmi3Byte serializedState[], size_t size) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUState);
    REQUIRE_POINTER(self, serializedState);
    return (fmi3Status)instance_serialize(self, __func__, FMUState, serializedState, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[],
                                   size_t size, fmi3FMUState *FMUState) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, serializedState);
    REQUIRE_POINTER(self, FMUState);
    return (fmi3Status)instance_deserialize(self, __func__, serializedState, size, FMUState);
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
    *valuesOfContinuousStatesChanged = events_update(&self->now.motor);
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

#define STATE_GETTER(name, states, getter)                                                             fmi3Status name(fmi3Instance instance, fmi3Float64 values[], size_t count) {                           Instance *self = instance;                                                                         REQUIRE(self, states);                                                                             return (fmi3Status)getter(self, __func__, values, count);                                      }

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

/* Types without variables: a call for no variable at all is right, any other an error. */
static fmi3Status no_variables(fmi3Instance instance, const char *function,
                               const fmi3ValueReference references[], size_t count) {
    Instance *self = instance;
    if (!self)
        return fmi3Error;
    if (!count)
        return fmi3OK;
    return (fmi3Status)fail(self, function, "this FMU has no variable of that type");
}

#define NO_VARIABLES(Type)                                                                         \
    fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference references[],         \
                             size_t count, fmi3##Type values[], size_t nValues) {                  \
        return no_variables(instance, __func__, references, count);                                \
    }                                                                                              \
    fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference references[],         \
                             size_t count, const fmi3##Type values[], size_t nValues) {            \
        return no_variables(instance, __func__, references, count);                                \
    }

NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(UInt64)
NO_VARIABLES(String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                         size_t sizes[], fmi3Binary values[], size_t nValues) {
    return no_variables(instance, __func__, references, count);
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                         const size_t sizes[], const fmi3Binary values[], size_t nValues) {
    return no_variables(instance, __func__, references, count);
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                        fmi3Clock values[]) {
    return no_variables(instance, __func__, references, count);
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                        const fmi3Clock values[]) {
    return no_variables(instance, __func__, references, count);
}

/* What the model description does not offer. */
#define NOT_OFFERED(name, ...)                                                                     \
    fmi3Status name(fmi3Instance instance, ##__VA_ARGS__) {                                        \
        Instance *self = instance;                                                                 \
        if (!self)                                                                                 \
            return fmi3Error;                                                                      \
        return (fmi3Status)fail(self, __func__, "this FMU does not offer it");                     \
    }

#define REFERENCES const fmi3ValueReference references[], size_t count

NOT_OFFERED(fmi3EnterConfigurationMode)
NOT_OFFERED(fmi3ExitConfigurationMode)
NOT_OFFERED(fmi3EnterStepMode)
NOT_OFFERED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference reference, size_t *count)
NOT_OFFERED(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t elements[],
            fmi3ValueReference independents[], size_t independentElements[],
            fmi3DependencyKind kinds[], size_t count)
NOT_OFFERED(fmi3EvaluateDiscreteStates)
NOT_OFFERED(fmi3GetIntervalDecimal, REFERENCES, fmi3Float64 intervals[],
            fmi3IntervalQualifier qualifiers[])
NOT_OFFERED(fmi3GetIntervalFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
            fmi3IntervalQualifier qualifiers[])
NOT_OFFERED(fmi3GetShiftDecimal, REFERENCES, fmi3Float64 shifts[])
NOT_OFFERED(fmi3GetShiftFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3SetIntervalDecimal, REFERENCES, const fmi3Float64 intervals[])
NOT_OFFERED(fmi3SetIntervalFraction, REFERENCES, const fmi3UInt64 counters[],
            const fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3SetShiftDecimal, REFERENCES, const fmi3Float64 shifts[])
NOT_OFFERED(fmi3SetShiftFraction, REFERENCES, const fmi3UInt64 counters[],
            const fmi3UInt64 resolutions[])
NOT_OFFERED(fmi3ActivateModelPartition, fmi3ValueReference clockReference,
            fmi3Float64 activationTime)

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
    fmi3LockPreemptionCallback lockPreemption, fmi3UnlockPreemptionCallback unlockPreemption) {
    if (logMessage && loggingOn)
        logMessage(instanceEnvironment, fmi3Error, "logStatusError",
                   "fmi3InstantiateScheduledExecution: this FMU does not offer it");
    return NULL;
}

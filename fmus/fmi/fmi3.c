/* FMI 3.0 shim: translates the calls of the standard that every model has to instance.h and nothing
 * else; what a model has beside them is in a shim of its own, which comes after this one.
 * The standard's header marks every function for export. */
#include "fmi3Functions.h"

#include "instance.h"

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
    Instance *self = instance_new(instanceName, instantiationToken, log_fmi3,
                                  (void (*)(void))logMessage, instanceEnvironment, loggingOn);
    if (!self)
        return NULL;
    if (eventModeUsed || nRequiredIntermediateVariables) {
        fail(self, __func__,
             "this FMU has no Event Mode and no intermediate updates in co-simulation");
        instance_free(self);
        return NULL;
    }
    return self;
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
    self->now.life_cycle = STEP;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, STEP);
    self->now.life_cycle = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    return (fmi3Status)instance_reset(self, __func__);
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, READABLE);
    return (fmi3Status)model_get_double(self, __func__, valueReferences, nValueReferences, values,
                                        nValues);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[], size_t nValues) {
    Instance *self = instance;
    REQUIRE(self, WRITABLE);
    return (fmi3Status)model_set_double(self, __func__, valueReferences, nValueReferences, values,
                                        nValues);
}

/* Access to variables that a model has as options, see instance.h, one by one. */
#define OPTION_ACCESS(Type, name)                                                                  \
    fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference valueReferences[],    \
                             size_t nValueReferences, fmi3##Type values[], size_t nValues) {       \
        Instance *self = instance;                                                                 \
        REQUIRE(self, READABLE);                                                                   \
        REQUIRE_EQUAL_COUNTS(self, nValueReferences, nValues);                                     \
        if (nValues) {                                                                             \
            REQUIRE_POINTER(self, valueReferences);                                                \
            REQUIRE_POINTER(self, values);                                                         \
        }                                                                                          \
        for (size_t k = 0; k < nValues; k++) {                                                     \
            int64_t value = 0;                                                                     \
            if (model_get_option(self, __func__, valueReferences[k], name, &value) != STATUS_OK)   \
                return fmi3Error;                                                                  \
            values[k] = (fmi3##Type)value;                                                         \
        }                                                                                          \
        return fmi3OK;                                                                             \
    }                                                                                              \
    fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference valueReferences[],    \
                             size_t nValueReferences, const fmi3##Type values[], size_t nValues) { \
        Instance *self = instance;                                                                 \
        REQUIRE(self, WRITABLE);                                                                   \
        REQUIRE_EQUAL_COUNTS(self, nValueReferences, nValues);                                     \
        if (nValues) {                                                                             \
            REQUIRE_POINTER(self, valueReferences);                                                \
            REQUIRE_POINTER(self, values);                                                         \
        }                                                                                          \
        for (size_t k = 0; k < nValues; k++)                                                       \
            if (model_check_option(self, __func__, valueReferences[k], name, values[k]) !=         \
                STATUS_OK)                                                                         \
                return fmi3Error;                                                                  \
        for (size_t k = 0; k < nValues; k++)                                                       \
            model_set_option(self, valueReferences[k], name, values[k]);                           \
        return fmi3OK;                                                                             \
    }

OPTION_ACCESS(Boolean, "Boolean")

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    Instance *self = instance;
    REQUIRE(self, STEP);
    const Status status =
        model_do_step(self, __func__, currentCommunicationPoint, communicationStepSize);
    if (eventHandlingNeeded)
        *eventHandlingNeeded = fmi3False;
    if (terminateSimulation)
        *terminateSimulation = fmi3False;
    if (earlyReturn)
        *earlyReturn = fmi3False;
    if (lastSuccessfulTime)
        *lastSuccessfulTime = self->now.time;
    return (fmi3Status)status;
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUState);
    return (fmi3Status)model_save(self, __func__, FMUState);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUState);
    return (fmi3Status)model_restore(self, __func__, FMUState);
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
    *size = sealed_size(model_state_size(FMUState));
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState,
                                 fmi3Byte serializedState[], size_t size) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUState);
    REQUIRE_POINTER(self, serializedState);
    return (fmi3Status)seal(self, __func__, FMUState, model_state_size(FMUState), serializedState,
                            size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[],
                                   size_t size, fmi3FMUState *FMUState) {
    Instance *self = instance;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, serializedState);
    REQUIRE_POINTER(self, FMUState);
    return (fmi3Status)model_deserialize(self, __func__, serializedState, size, FMUState);
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
NOT_OFFERED(fmi3SetContinuousStates, const fmi3Float64 continuousStates[], size_t nContinuousStates)
NOT_OFFERED(fmi3GetContinuousStates, fmi3Float64 continuousStates[], size_t nContinuousStates)
NOT_OFFERED(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t nContinuousStates)
NOT_OFFERED(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t nContinuousStates)
NOT_OFFERED(fmi3GetEventIndicators, fmi3Float64 eventIndicators[], size_t nEventIndicators)
NOT_OFFERED(fmi3GetNumberOfContinuousStates, size_t *nContinuousStates)
NOT_OFFERED(fmi3GetNumberOfEventIndicators, size_t *nEventIndicators)

/* The same of a whole interface, where there is no instance yet. */
static fmi3Instance no_instance(const char *function, fmi3Boolean loggingOn,
                                fmi3InstanceEnvironment instanceEnvironment,
                                fmi3LogMessageCallback logMessage) {
    const Instance draft = {.log = log_fmi3,
                            .callback = (void (*)(void))logMessage,
                            .environment = instanceEnvironment,
                            .logging = loggingOn};
    fail(&draft, function, "this FMU does not offer it");
    return NULL;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible,
                                          fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    return no_instance(__func__, loggingOn, instanceEnvironment, logMessage);
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
    fmi3LockPreemptionCallback lockPreemption, fmi3UnlockPreemptionCallback unlockPreemption) {
    return no_instance(__func__, loggingOn, instanceEnvironment, logMessage);
}

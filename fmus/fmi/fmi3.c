/* FMI 3.0 shim: translates the calls of the standard that every model has to instance.h and nothing
 * else; what a model has beside them is in a shim of its own, which comes after this one.
 * The standard's header marks every function for export. */
#include "fmi3Functions.h"

#include "instance.h"

#define FMI(name) fmi3##name
#define STATE(before, after) fmi3##before##FMUState##after
#define DESERIALIZE fmi3DeserializeFMUState
#define VALUE_COUNT , size_t nValues
#define REQUIRE_VALUES(self, references, count, values)                                            \
    REQUIRE_EQUAL_COUNTS(self, count, nValues);                                                    \
    if ((count) && (!(references) || !(values)))                                                   \
    return (fmi3Status)fail_arrays(self, __func__)

#include "shim.c"

static void log_fmi3(const Instance *self, Status status, const char *category,
                     const char *message) {
    const fmi3LogMessageCallback callback = (fmi3LogMessageCallback)self->callback;
    if (callback)
        callback(self->environment, (fmi3Status)status, category, message);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

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

#define REFERENCES const fmi3ValueReference references[], size_t count
#define VALUES fmi3Float64 values[], size_t nValues

NOT_OFFERED(EnterStepMode)
NOT_OFFERED(GetNumberOfVariableDependencies, fmi3ValueReference reference, size_t *n)
NOT_OFFERED(GetVariableDependencies, fmi3ValueReference dependent, size_t elements[],
            fmi3ValueReference independents[], size_t independentElements[],
            fmi3DependencyKind kinds[], size_t count)
NOT_OFFERED(EvaluateDiscreteStates)
NOT_OFFERED(GetIntervalDecimal, REFERENCES, fmi3Float64 values[], fmi3IntervalQualifier kinds[])
NOT_OFFERED(GetIntervalFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
            fmi3IntervalQualifier kinds[])
NOT_OFFERED(GetShiftDecimal, REFERENCES, fmi3Float64 shifts[])
NOT_OFFERED(GetShiftFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NOT_OFFERED(SetIntervalDecimal, REFERENCES, const fmi3Float64 intervals[])
NOT_OFFERED(SetIntervalFraction, REFERENCES, const fmi3UInt64 c[], const fmi3UInt64 r[])
NOT_OFFERED(SetShiftDecimal, REFERENCES, const fmi3Float64 shifts[])
NOT_OFFERED(SetShiftFraction, REFERENCES, const fmi3UInt64 c[], const fmi3UInt64 r[])
NOT_OFFERED(ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)
NOT_OFFERED(GetOutputDerivatives, REFERENCES, const fmi3Int32 orders[], VALUES)
NOT_OFFERED(GetDirectionalDerivative, REFERENCES, const fmi3ValueReference knowns[], size_t nKnowns,
            const fmi3Float64 seed[], size_t nSeed, VALUES)
NOT_OFFERED(GetAdjointDerivative, REFERENCES, const fmi3ValueReference knowns[], size_t nKnowns,
            const fmi3Float64 seed[], size_t nSeed, VALUES)
NOT_OFFERED(EnterEventMode)
NOT_OFFERED(EnterContinuousTimeMode)
NOT_OFFERED(UpdateDiscreteStates, fmi3Boolean *update, fmi3Boolean *terminate,
            fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *next, fmi3Float64 *time)
NOT_OFFERED(CompletedIntegratorStep, fmi3Boolean a, fmi3Boolean *enter, fmi3Boolean *terminate)
NOT_OFFERED(SetTime, fmi3Float64 time)
NOT_OFFERED(SetContinuousStates, const fmi3Float64 states[], size_t count)
NOT_OFFERED(GetContinuousStates, VALUES)
NOT_OFFERED(GetContinuousStateDerivatives, VALUES)
NOT_OFFERED(GetNominalsOfContinuousStates, VALUES)
NOT_OFFERED(GetEventIndicators, VALUES)
NOT_OFFERED(GetNumberOfContinuousStates, size_t *count)
NOT_OFFERED(GetNumberOfEventIndicators, size_t *count)

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

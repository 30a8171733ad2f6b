/* FMI 2.0 shim of VibrationMotor: translates the calls of the standard to instance.h and nothing
 * else. The functions of Model Exchange alone are missing, as the standard allows. The standard's
 * header marks every function for export. */
#include "fmi2Functions.h"

#include "instance.h"

static void log_fmi2(const Instance *self, Status status, const char *category,
                     const char *message) {
    const fmi2CallbackLogger callback = (fmi2CallbackLogger)self->callback;
    if (!callback)
        return;
    /* The message is a printf format to the importer. */
    char format[1024];
    size_t end = 0;
    for (; *message && end + 2 < sizeof format; message++) {
        if (*message == '%')
            format[end++] = '%';
        format[end++] = *message;
    }
    format[end] = '\0';
    callback(self->environment, self->name, (fmi2Status)status, category, format);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    Instance *self = c;
    REQUIRE(self, ANY_STATE);
    return (fmi2Status)instance_set_logging(self, __func__, loggingOn != 0, nCategories,
                                            categories);
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean loggingOn) {
    Instance *self = instance_new(
        instanceName, fmuGUID, log_fmi2, functions ? (void (*)(void))functions->logger : NULL,
        functions ? functions->componentEnvironment : NULL, loggingOn != 0);
    if (self && fmuType != fmi2CoSimulation) {
        fail(self, __func__, "this FMU does not offer Model Exchange");
        instance_free(self);
        return NULL;
    }
    return self;
}

void fmi2FreeInstance(fmi2Component c) { instance_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    Instance *self = c;
    REQUIRE(self, INSTANTIATED);
    return (fmi2Status)instance_set_experiment(self, __func__, startTime, stopTimeDefined != 0,
                                               stopTime);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *self = c;
    REQUIRE(self, INSTANTIATED);
    self->now.life_cycle = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *self = c;
    REQUIRE(self, INITIALIZATION);
    self->now.life_cycle = STEP;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    Instance *self = c;
    REQUIRE(self, STEP);
    self->now.life_cycle = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    Instance *self = c;
    REQUIRE(self, ANY_STATE);
    return (fmi2Status)instance_reset(self, __func__);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       fmi2Real value[]) {
    Instance *self = c;
    REQUIRE(self, READABLE);
    return (fmi2Status)model_get_double(self, __func__, vr, nvr, value, nvr);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       const fmi2Real value[]) {
    Instance *self = c;
    REQUIRE(self, WRITABLE);
    return (fmi2Status)model_set_double(self, __func__, vr, nvr, value, nvr);
}

/* Boolean and, as Integer, enumeration variables: fmi2Boolean and fmi2Integer are both int. */
static fmi2Status get_options(const Instance *self, const char *function, const char *type,
                              const fmi2ValueReference vr[], size_t nvr, int value[]) {
    if (nvr && (!vr || !value))
        return (fmi2Status)fail(self, function, "an array of value references or values is null");
    for (size_t k = 0; k < nvr; k++) {
        int64_t option;
        if (model_get_option(self, function, vr[k], type, &option) != STATUS_OK)
            return fmi2Error;
        value[k] = (int)option;
    }
    return fmi2OK;
}

static fmi2Status set_options(Instance *self, const char *function, const char *type,
                              const fmi2ValueReference vr[], size_t nvr, const int value[]) {
    if (nvr && (!vr || !value))
        return (fmi2Status)fail(self, function, "an array of value references or values is null");
    for (size_t k = 0; k < nvr; k++)
        if (model_check_option(self, function, vr[k], type, value[k]) != STATUS_OK)
            return fmi2Error;
    for (size_t k = 0; k < nvr; k++)
        model_set_option(self, vr[k], type, value[k]);
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Boolean value[]) {
    Instance *self = c;
    REQUIRE(self, READABLE);
    return get_options(self, __func__, "Boolean", vr, nvr, value);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Boolean value[]) {
    Instance *self = c;
    REQUIRE(self, WRITABLE);
    return set_options(self, __func__, "Boolean", vr, nvr, value);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Integer value[]) {
    Instance *self = c;
    REQUIRE(self, READABLE);
    return get_options(self, __func__, "Enumeration", vr, nvr, value);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Integer value[]) {
    Instance *self = c;
    REQUIRE(self, WRITABLE);
    return set_options(self, __func__, "Enumeration", vr, nvr, value);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         fmi2String value[]) {
    Instance *self = c;
    REQUIRE(self, READABLE);
    return nvr ? (fmi2Status)fail(self, __func__, "this FMU has no String variable") : fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         const fmi2String value[]) {
    Instance *self = c;
    REQUIRE(self, WRITABLE);
    return nvr ? (fmi2Status)fail(self, __func__, "this FMU has no String variable") : fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *self = c;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUstate);
    return (fmi2Status)model_save(self, __func__, FMUstate);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    Instance *self = c;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUstate);
    return (fmi2Status)model_restore(self, __func__, FMUstate);
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *self = c;
    REQUIRE(self, ANY_STATE);
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    Instance *self = c;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUstate);
    REQUIRE_POINTER(self, size);
    *size = sealed_size(model_state_size(FMUstate));
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size) {
    Instance *self = c;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, FMUstate);
    REQUIRE_POINTER(self, serializedState);
    return (fmi2Status)seal(self, __func__, FMUstate, model_state_size(FMUstate),
                            (unsigned char *)serializedState, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    Instance *self = c;
    REQUIRE(self, ANY_STATE);
    REQUIRE_POINTER(self, serializedState);
    REQUIRE_POINTER(self, FMUstate);
    return (fmi2Status)model_deserialize(self, __func__, (const unsigned char *)serializedState,
                                         size, FMUstate);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint,
                      fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    Instance *self = c;
    REQUIRE(self, STEP);
    return (fmi2Status)model_do_step(self, __func__, currentCommunicationPoint,
                                     communicationStepSize);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *self = c;
    REQUIRE(self, STEP | TERMINATED);
    REQUIRE_POINTER(self, value);
    if (kind != fmi2LastSuccessfulTime)
        return (fmi2Status)fail(self, __func__, "there is no Real status of kind %d", (int)kind);
    *value = self->now.time;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    Instance *self = c;
    REQUIRE(self, STEP | TERMINATED);
    REQUIRE_POINTER(self, value);
    if (kind != fmi2Terminated)
        return (fmi2Status)fail(self, __func__, "there is no Boolean status of kind %d", (int)kind);
    *value = fmi2False; /* the FMU never ends a simulation */
    return fmi2OK;
}

/* What the model description does not offer: steps are never pending, inputs are held. */
#define NOT_OFFERED(name, ...)                                                                     \
    fmi2Status name(fmi2Component c, ##__VA_ARGS__) {                                              \
        Instance *self = c;                                                                        \
        if (!self)                                                                                 \
            return fmi2Error;                                                                      \
        return (fmi2Status)fail(self, __func__, "this FMU does not offer it");                     \
    }

NOT_OFFERED(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t nvr,
            const fmi2Integer order[], const fmi2Real value[])
NOT_OFFERED(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t nvr,
            const fmi2Integer order[], fmi2Real value[])
NOT_OFFERED(fmi2GetDirectionalDerivative, const fmi2ValueReference unknowns[], size_t nUnknowns,
            const fmi2ValueReference knowns[], size_t nKnowns, const fmi2Real seed[],
            fmi2Real sensitivity[])
NOT_OFFERED(fmi2CancelStep)
NOT_OFFERED(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
NOT_OFFERED(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
NOT_OFFERED(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)

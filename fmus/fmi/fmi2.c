/* FMI 2.0 shim of VibrationMotor: translates the calls of the standard to instance.h and nothing
 * else. The functions of Model Exchange alone are missing, as the standard allows. The standard's
 * header marks every function for export. */
#include "fmi2Functions.h"

#include "instance.h"

#define FMI(name) fmi2##name
#define STATE(before, after) fmi2##before##FMUstate##after
#define DESERIALIZE fmi2DeSerializeFMUstate
#define VALUE_COUNT
#define REQUIRE_VALUES(self, references, count, values)                                            \
    if ((count) && (!(references) || !(values)))                                                   \
    return (fmi2Status)fail_arrays(self, __func__)

#include "shim.c"

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

/* Enumerations are Integer in FMI 2. */
OPTION_ACCESS(Boolean, "Boolean")
OPTION_ACCESS(Integer, "Enumeration")

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

/* Steps are never pending, inputs are held. */
NOT_OFFERED(SetRealInputDerivatives, const fmi2ValueReference vr[], size_t nvr,
            const fmi2Integer order[], const fmi2Real value[])
NOT_OFFERED(GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t nvr,
            const fmi2Integer order[], fmi2Real value[])
NOT_OFFERED(GetDirectionalDerivative, const fmi2ValueReference unknowns[], size_t nUnknowns,
            const fmi2ValueReference knowns[], size_t nKnowns, const fmi2Real seed[],
            fmi2Real sensitivity[])
NOT_OFFERED(CancelStep)
NOT_OFFERED(GetStatus, const fmi2StatusKind kind, fmi2Status *value)
NOT_OFFERED(GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
NOT_OFFERED(GetStringStatus, const fmi2StatusKind kind, fmi2String *value)

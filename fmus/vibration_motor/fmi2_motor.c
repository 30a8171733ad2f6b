/* FMI 2.0 shim of VibrationMotor: the calls that only this model has, after those of fmi2.c. */
#include <string.h>

#include "events.h"
#include "motor_instance.h"

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[],
                                        size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    Instance *self = c;
    REQUIRE(self, READABLE);
    return (fmi2Status)instance_directional(self, __func__, vUnknown_ref, nUnknown, vKnown_ref,
                                            nKnown, dvKnown, dvUnknown);
}

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    Instance *self = c;
    REQUIRE(self, EVENT | CONTINUOUS_TIME);
    self->now.life_cycle = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo) {
    Instance *self = c;
    REQUIRE(self, EVENT);
    REQUIRE_POINTER(self, eventInfo);
    memset(eventInfo, 0, sizeof *eventInfo);
    eventInfo->valuesOfContinuousStatesChanged = events_update(plain_of(self));
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    Instance *self = c;
    REQUIRE(self, EVENT);
    self->now.life_cycle = CONTINUOUS_TIME;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode,
                                       fmi2Boolean *terminateSimulation) {
    Instance *self = c;
    REQUIRE(self, CONTINUOUS_TIME);
    REQUIRE_POINTER(self, enterEventMode);
    REQUIRE_POINTER(self, terminateSimulation);
    *enterEventMode = fmi2False;
    *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Instance *self = c;
    REQUIRE(self, EVENT | CONTINUOUS_TIME);
    return (fmi2Status)instance_set_time(self, __func__, time);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    Instance *self = c;
    REQUIRE(self, CONTINUOUS_TIME);
    return (fmi2Status)instance_set_states(self, __func__, x, nx);
}

#define STATE_GETTER(name, states, getter)                                                         \
    fmi2Status name(fmi2Component c, fmi2Real values[], size_t count) {                            \
        Instance *self = c;                                                                        \
        REQUIRE(self, states);                                                                     \
        return (fmi2Status)getter(self, __func__, values, count);                                  \
    }

STATE_GETTER(fmi2GetContinuousStates, INITIALIZATION | EVENT | CONTINUOUS_TIME | TERMINATED,
             instance_get_states)
STATE_GETTER(fmi2GetDerivatives, INITIALIZATION | EVENT | CONTINUOUS_TIME | TERMINATED,
             instance_get_derivatives)
STATE_GETTER(fmi2GetNominalsOfContinuousStates, ANY_STATE, instance_get_nominals)
STATE_GETTER(fmi2GetEventIndicators, INITIALIZATION | EVENT | CONTINUOUS_TIME | TERMINATED,
             instance_get_indicators)

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Instance *self = c;
    REQUIRE(self, STEP | TERMINATED);
    return (fmi2Status)instance_output_derivatives(self, __func__, vr, nvr, order, value);
}

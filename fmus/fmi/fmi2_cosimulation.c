/* FMI 2.0 shim of models for co-simulation alone, after fmi2.c: what they do not offer. */
#include "instance.h"

#define NO_STATES(name) NOT_OFFERED(name, fmi2Real values[], size_t count)

NOT_OFFERED(fmi2GetDirectionalDerivative, const fmi2ValueReference unknowns[], size_t nUnknowns,
            const fmi2ValueReference knowns[], size_t nKnowns, const fmi2Real seed[],
            fmi2Real sensitivity[])
NOT_OFFERED(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t nvr,
            const fmi2Integer order[], fmi2Real value[])
NOT_OFFERED(fmi2EnterEventMode)
NOT_OFFERED(fmi2NewDiscreteStates, fmi2EventInfo *eventInfo)
NOT_OFFERED(fmi2EnterContinuousTimeMode)
NOT_OFFERED(fmi2CompletedIntegratorStep, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
            fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
NOT_OFFERED(fmi2SetTime, fmi2Real time)
NOT_OFFERED(fmi2SetContinuousStates, const fmi2Real states[], size_t count)
NO_STATES(fmi2GetContinuousStates)
NO_STATES(fmi2GetDerivatives)
NO_STATES(fmi2GetNominalsOfContinuousStates)
NO_STATES(fmi2GetEventIndicators)

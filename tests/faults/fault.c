/* A motor FMU with faults: three of its functions (renamed to sound_…) stand behind those below,
   which go wrong from FAULT_FROM seconds on as FAULT says. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#undef fmi3DoStep
#undef fmi3GetFloat64
#undef fmi3InstantiateCoSimulation
#define fmi3DoStep sound_fmi3DoStep
#define fmi3GetFloat64 sound_fmi3GetFloat64
#define fmi3InstantiateCoSimulation sound_fmi3InstantiateCoSimulation
#include SOUND
#undef fmi3DoStep
#undef fmi3GetFloat64
#undef fmi3InstantiateCoSimulation

static const char *fault;
static double from, now;
static fmi3InstanceEnvironment environment;
static fmi3LogMessageCallback say;

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t count,
    fmi3InstanceEnvironment given, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback intermediate) {
    fault = getenv("FAULT") ? getenv("FAULT") : "none";
    from = getenv("FAULT_FROM") ? atof(getenv("FAULT_FROM")) : 0.0;
    environment = given;
    say = log;
    return sound_fmi3InstantiateCoSimulation(name, token, path, visible, logging, events, early,
                                             required, count, given, log, intermediate);
}

static int is(const char *name) { return now >= from && strcmp(fault, name) == 0; }

FMI3_Export fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step,
                                  fmi3Boolean final, fmi3Boolean *event, fmi3Boolean *terminate,
                                  fmi3Boolean *early, fmi3Float64 *last) {
    now = time;
    if (is("discard")) return fmi3Discard;
    if (is("error")) return fmi3Error;
    if (is("fatal")) return fmi3Fatal;
    if (is("crash")) *(volatile int *)8 = 1;
    if (is("exit")) exit(0);
    if (is("free")) free((char *)instance + 24);
    while (is("hang")) {
    }
    for (int k = 0; is("flood") && k < 100000; k++) say(environment, fmi3Warning, "logEvents", "flood");
    if (is("flood")) return fmi3Error;
    return sound_fmi3DoStep(instance, time, step, final, event, terminate, early, last);
}

FMI3_Export fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[],
                                      size_t count, fmi3Float64 values[], size_t size) {
    const fmi3Status status = sound_fmi3GetFloat64(instance, references, count, values, size);
    if (is("nan")) values[1] = NAN;
    if (is("inf")) values[1] = INFINITY;
    return status;
}

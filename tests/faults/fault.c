/* A motor FMU with faults: three of its functions (renamed to sound_…) stand behind those below,
   which go wrong from FAULT_FROM seconds on as FAULT says, once there were FAULT_AFTER instances. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#undef fmi3DoStep
#undef fmi3GetFloat64
#undef fmi3InstantiateCoSimulation
#undef fmi3Terminate
#undef fmi3FreeInstance
#define fmi3Terminate sound_fmi3Terminate
#define fmi3FreeInstance sound_fmi3FreeInstance
#define fmi3DoStep sound_fmi3DoStep
#define fmi3GetFloat64 sound_fmi3GetFloat64
#define fmi3InstantiateCoSimulation sound_fmi3InstantiateCoSimulation
#include SOUND
#undef fmi3Terminate
#undef fmi3FreeInstance
#undef fmi3DoStep
#undef fmi3GetFloat64
#undef fmi3InstantiateCoSimulation

static const char *fault;
static double from, now;
static int instances;
static fmi3InstanceEnvironment environment;
static fmi3LogMessageCallback say;
static fmi3Instance broken; /* the instance that has failed */

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t count,
    fmi3InstanceEnvironment given, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback intermediate) {
    fault = getenv("FAULT") ? getenv("FAULT") : "none";
    from = getenv("FAULT_FROM") ? atof(getenv("FAULT_FROM")) : 0.0;
    instances++;
    now = 0.0;
    environment = given;
    say = log;
    return sound_fmi3InstantiateCoSimulation(name, token, path, visible, logging, events, early,
                                             required, count, given, log, intermediate);
}

static int is(const char *name) {
    const char *after = getenv("FAULT_AFTER");
    return now >= from && strcmp(fault, name) == 0 && (!after || instances > atoi(after));
}

FMI3_Export fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step,
                                  fmi3Boolean final, fmi3Boolean *event, fmi3Boolean *terminate,
                                  fmi3Boolean *early, fmi3Float64 *last) {
    now = time;
    if (is("discard")) return fmi3Discard;
    if (is("error")) broken = instance;
    if (is("error")) return fmi3Error;
    if (is("fatal")) return fmi3Fatal;
    if (is("crash")) *(volatile int *)8 = 1;
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

/* The standards forbid to terminate after an error, and to call anything after a fatal one. */
FMI3_Export fmi3Status fmi3Terminate(fmi3Instance instance) {
    if (is("fatal") || (is("error") && instance == broken)) abort();
    return sound_fmi3Terminate(instance);
}

FMI3_Export void fmi3FreeInstance(fmi3Instance instance) {
    if (is("fatal")) abort();
    sound_fmi3FreeInstance(instance);
}

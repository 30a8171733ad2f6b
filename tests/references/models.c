/* Small models with closed-form steps, as FMUs of FMI 2.0 and 3.0 in one library.

Which model an instance is, its GUID or instantiation token says. Every variable has a slot, whose
number is its value reference (see small.py); inputs hold over a step. Of those that are for Model
Exchange too, the derivatives are here. */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

#pragma GCC visibility push(default)

enum { SLOTS = 48, MOST = 8 };
enum { OK, WARNING, DISCARD, ERROR };
enum { DERIVATIVES = 40, FREE = 0, EVENT, CONTINUOUS };
enum { CLOCKS = 3, UNKNOWN = 0, UNCHANGED, CHANGED };

typedef struct {
    double real[SLOTS];
    int64_t whole[SLOTS];
    double array[2][MOST];
    double time;
    bool ends;
    bool active[CLOCKS]; /* by value reference */
    int told; /* of the interval of clock 1: its qualifier */
    char text[64];
} State;

typedef struct {
    char model;
    bool events;
    bool exchange;
    int mode; /* EVENT and CONTINUOUS for Model Exchange and the ticker only */
    fmi3LogMessageCallback log_3;
    fmi2CallbackLogger log_2;
    void *environment;
    char told[64]; /* the text that was got last, which does not stay */
    State s;
} Instance;

static int say(Instance *c, int status, const char *text) {
    if (c->log_3) c->log_3(c->environment, (fmi3Status)status, "logStatusError", text);
    if (c->log_2) c->log_2(c->environment, "", (fmi2Status)status, "logStatusError", text);
    return status;
}

static Instance *make(const char *token) {
    Instance *c = calloc(1, sizeof *c);
    if (!c) return NULL;
    double *r = c->s.real;
    c->model = token[0];
    switch (c->model) {
    case 'o': r[1] = 1, r[2] = 1, r[4] = 1; break;                        /* oscillator */
    case 'd': r[1] = 1, r[2] = 1, r[4] = r[5] = r[6] = INFINITY; break;   /* dahlquist */
    case 'b': r[1] = 1, r[3] = 9.81, r[4] = 0.7; break;                   /* ball */
    case 's': c->s.whole[1] = 1, c->s.whole[2] = 10; break;               /* stair */
    case 'f': c->s.whole[8] = 1; break;                                   /* feedthrough */
    case 'a': c->s.whole[1] = 3; break;                                   /* array */
    case 'r': break;                                                      /* restless */
    case 'c': r[2] = 1; break;                                            /* curve */
    case 'n': break;                                                      /* namer */
    case 'v': r[1] = 2, r[3] = 1, r[4] = INFINITY; break;                 /* van der pol */
    case 't': r[11] = 0.1, r[19] = INFINITY; break;                       /* ticker */
    default: free(c); return NULL;
    }
    return c;
}

/* The ball flies until the end or the floor; returns whether it has reached the floor. */
static bool fly(State *s, double end) {
    double *h = &s->real[1], *v = &s->real[2], g = s->real[3], left = end - s->time;
    double hit = (*v + sqrt(*v * *v + 2 * g * *h)) / g;
    bool floor = hit <= left;
    double t = floor ? hit : left;
    *h = floor ? 0 : *h + *v * t - 0.5 * g * t * t;
    *v -= g * t;
    s->time = floor ? s->time + t : end;
    return floor;
}

static void bounce(State *s) { s->real[2] *= -s->real[4]; }

static int step(Instance *c, double time, double h, bool *event) {
    State *s = &c->s;
    double *r = s->real;
    double end = time + h;
    *event = false;
    memset(c->told, '?', sizeof c->told - 1);
    if (c->model == 'n') snprintf(s->text, sizeof s->text, "step %d", (int)(end + 1e-9));
    s->time = time;
    switch (c->model) {
    case 'o': {
        double w = sqrt((r[2] + r[3]) / r[1]), rest = (r[6] + r[3] * r[7]) / (r[2] + r[3]);
        double moved = r[11] > 0 ? r[10] : 0, drift = moved * r[3] / (r[2] + r[3]);
        double x = r[4] - rest, v = r[5] - drift, co = cos(w * h), si = sin(w * h);
        if (r[9] > 0) { /* damped by the coupling: about another place of rest, or slower */
            double a = r[9] / (2 * r[1]), b = w * w - a * a, q = sqrt(fabs(b)), e = exp(-a * h);
            rest += r[9] * r[10] / (r[2] + r[3]), x = r[4] - rest;
            co = e * (b > 0 ? cos(q * h) : cosh(q * h));
            si = e * (b > 0 ? sin(q * h) : sinh(q * h)) / q;
            r[4] = rest + x * co + (v + a * x) * si;
            r[5] = v * co - (a * v + w * w * x) * si;
            break;
        }
        r[4] = rest + drift * h + x * co + v / w * si;
        r[5] = drift + v * co - w * x * si;
        r[7] += moved * h;
        break;
    }
    case 'd':
        if (h > r[5] * (1 + 1e-9)) return say(c, DISCARD, "the step is too long");
        if (end > r[4] * (1 + 1e-9)) return say(c, ERROR, "cannot go on");
        r[2] = r[3] / r[1] + (r[2] - r[3] / r[1]) * exp(-r[1] * h);
        break;
    case 'b':
        while (s->time < end && fly(s, end)) {
            if (c->events) {
                *event = true;
                return OK;
            }
            bounce(s);
            if (s->real[2] < 1e-3) return say(c, ERROR, "the ball has come to rest");
        }
        break;
    case 's':
        s->whole[1] = 1 + (int64_t)floor(end + 1e-9);
        if (s->whole[1] >= s->whole[2]) s->ends = true;
        break;
    case 't': /* an event of its own */
        *event = time < r[19] && r[19] <= end;
        if (*event) end = r[19], s->whole[21] = 1;
    }
    s->time = end;
    if (c->model == 'd' && r[2] > r[6]) {
        if (c->log_3) c->log_3(c->environment, fmi3Warning, "logStatusWarning", "x is large");
        if (c->log_2)
            c->log_2(c->environment, "", fmi2Warning, "logStatusWarning", "x is %.3f of %d %s", r[2], 7, "m");
        return WARNING;
    }
    return OK;
}

/* Model Exchange: slots of the states and their derivatives, the number of indicators. */
static size_t states(const Instance *c, unsigned slots[2]) {
    bool second = c->model == 'o' || c->model == 'b' || c->model == 'v';
    slots[0] = c->model == 'o' ? 4 : c->model == 'd' ? 2 : 1;
    slots[1] = slots[0] + 1;
    return second ? 2 : c->model == 'd';
}

static double derivative(const Instance *c, size_t k) {
    const double *r = c->s.real;
    switch (c->model) {
    case 'o':
        return k ? (r[6] - r[2] * r[4] - r[3] * (r[4] - r[7]) - r[9] * (r[5] - r[10])) / r[1] : r[5];
    case 'd': return r[3] - r[1] * r[2];
    case 'b': return k ? -r[3] : r[2];
    case 'v': return k ? r[3] * (1 - r[1] * r[1]) * r[2] - r[1] : r[2];
    }
    return 0;
}

/* Values that are set where they may not be. */
static bool refuses(Instance *c, const char *type) {
    return c->mode == CONTINUOUS && strcmp(type, "Real") && strncmp(type, "Float", 5);
}

/* The ticker: a PI controller with clock 1, and a counter of clock 2. What is tied to a clock is
   there in Event Mode while the clock is active, and before. */
static bool closed(const Instance *c, const unsigned vr[], size_t n) {
    for (size_t k = 0; c->model == 't' && c->mode && k < n; k++) {
        unsigned v = vr[k];
        int clock = v == 3 || v == 4 || v == 8 || v == 17 ? 1 : v == 9 ? 2 : 0;
        if (clock && !c->s.active[clock]) return true;
    }
    return false;
}
static void plan(State *s, double interval) { s->real[20] = interval, s->told = CHANGED; }
static void tick(State *s) {
    double *r = s->real, e = r[5] - r[3];
    int64_t *w = s->whole, kind = w[13];
    w[10] += s->active[1] && s->active[2];
    if (s->active[1]) {
        r[4] = r[6] * e + r[18] + r[7] * e, r[18] += r[7] * e, r[17] = r[16] = s->time, w[8]++;
        s->told = UNCHANGED;
        if (kind == 1) plan(s, (double)w[8] * r[11]);       /* changing: ever longer */
        if (kind == 2) plan(s, r[11] * sqrt((double)w[8])); /* countdown: known at once */
        if (kind == 3) s->told = UNKNOWN;                   /* countdown: known after an event */
        if (kind == 5 && w[8] == 3) plan(s, r[11] / 2);     /* tunable: halved */
        if (kind == 6) plan(s, w[8] % 3 ? 0 : r[11]);       /* changing: three at once */
        if (kind == 7) plan(s, 0);                          /* for ever */
    }
    w[9] += s->active[2];
    if (kind == 3 && (w[14] != w[15] || w[21])) plan(s, r[11]);
    w[15] = w[14], w[21] = 0;
    memset(s->active, 0, sizeof s->active);
}

static double real_of(const Instance *c, unsigned vr) {
    const double *r = c->s.real;
    if (c->model == 't') {
        if (vr == 0 || (vr == 17 && c->s.active[1])) return c->s.time;
        double e = r[5] - r[3];
        return vr == 4 && c->s.active[1] ? r[6] * e + r[18] + r[7] * e : r[vr];
    }
    if (vr >= DERIVATIVES && c->model != 'f') return derivative(c, vr - DERIVATIVES);
    if (c->model == 'o' && vr == 8) return r[3] * (r[4] - r[7]) + r[9] * (r[5] - r[10]);
    if (c->model == 'f' && vr % 2) return r[vr - 1];
    if (c->model == 'd' && vr == 8) return 2 * r[1];
    if (c->model == 'c' && vr == 5) {
        double u = r[3], kind = (double)c->s.whole[1];
        return r[2] * (kind == 1 ? cos(u) : kind == 2 ? u * u : kind == 3 ? sqrt(u) : u) + r[4];
    }
    return r[vr];
}

static int64_t whole_of(const Instance *c, unsigned vr) {
    if (c->model == 'c' && vr == 7) return c->s.whole[6] + 1;
    if (c->model == 't' && vr < 10) return c->s.whole[vr] + c->s.active[vr - 7];
    return c->model == 'f' && vr % 2 ? c->s.whole[vr - 1] : c->s.whole[vr];
}

/* Getters and setters: of FMI 2.0 without the number of values, of 3.0 with it. */
#define ACCESS_2(NAME, TYPE, OF, FIELD)                                                            \
    fmi2Status fmi2Get##NAME(fmi2Component c, const fmi2ValueReference vr[], size_t n,             \
                             TYPE values[]) {                                                      \
        for (size_t k = 0; k < n; k++) values[k] = (TYPE)OF(c, vr[k]);                             \
        return fmi2OK;                                                                             \
    }                                                                                              \
    fmi2Status fmi2Set##NAME(fmi2Component c, const fmi2ValueReference vr[], size_t n,             \
                             const TYPE values[]) {                                                \
        if (refuses(c, #NAME)) return fmi2Error;                                                   \
        for (size_t k = 0; k < n; k++) ((Instance *)c)->s.FIELD[vr[k]] = values[k];                \
        return fmi2OK;                                                                             \
    }
ACCESS_2(Real, fmi2Real, real_of, real)
ACCESS_2(Integer, fmi2Integer, whole_of, whole)
ACCESS_2(Boolean, fmi2Boolean, whole_of, whole)

#define ACCESS_3(NAME, TYPE, OF, FIELD)                                                            \
    fmi3Status fmi3Get##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n,              \
                             TYPE values[], size_t size) {                                         \
        if (n != size) return fmi3Error;                                                           \
        for (size_t k = 0; k < n; k++) values[k] = (TYPE)OF(c, vr[k]);                             \
        return closed(c, vr, n) ? fmi3Error : fmi3OK;                                              \
    }                                                                                              \
    fmi3Status fmi3Set##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n,              \
                             const TYPE values[], size_t size) {                                   \
        if (n != size || refuses(c, #NAME)) return fmi3Error;                                      \
        for (size_t k = 0; k < n; k++) ((Instance *)c)->s.FIELD[vr[k]] = values[k];                \
        return fmi3OK;                                                                             \
    }
ACCESS_3(Float32, fmi3Float32, real_of, real)
ACCESS_3(Int8, fmi3Int8, whole_of, whole)
ACCESS_3(UInt8, fmi3UInt8, whole_of, whole)
ACCESS_3(Int16, fmi3Int16, whole_of, whole)
ACCESS_3(UInt16, fmi3UInt16, whole_of, whole)
ACCESS_3(Int32, fmi3Int32, whole_of, whole)
ACCESS_3(UInt32, fmi3UInt32, whole_of, whole)
ACCESS_3(Int64, fmi3Int64, whole_of, whole)
ACCESS_3(UInt64, fmi3UInt64, whole_of, whole)
ACCESS_3(Boolean, fmi3Boolean, whole_of, whole)

/* Texts: of the models feedthrough and namer only. */
static const char *text_of(Instance *c) { return strcpy(c->told, c->s.text); }
static int set_text(Instance *c, const char *text) {
    if (c->mode == CONTINUOUS || strlen(text) >= sizeof c->s.text) return ERROR;
    strcpy(c->s.text, text);
    return OK;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                         fmi2String values[]) {
    for (size_t k = 0; k < n; k++) values[k] = text_of(c);
    return fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                         const fmi2String values[]) {
    return (fmi2Status)set_text(c, values[0]);
}
fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                         fmi3String values[], size_t size) {
    return (fmi3Status)fmi2GetString(c, vr, n, values);
}
fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                         const fmi3String values[], size_t size) {
    return (fmi3Status)set_text(c, values[0]);
}

/* Float64 may be arrays: input 2 and output 3 of the model array, of the size that 1 says. */
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                          fmi3Float64 values[], size_t size) {
    Instance *i = c;
    size_t place = 0;
    if (closed(i, vr, n)) return fmi3Error;
    for (size_t k = 0; k < n; k++) {
        size_t length = i->model == 'a' ? (size_t)i->s.whole[1] : 1;
        if (place + length > size) return fmi3Error;
        for (size_t j = 0; j < length; j++)
            values[place++] = i->model != 'a' ? real_of(i, vr[k])
                                              : (1 + (vr[k] == 3)) * i->s.array[0][j];
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                          const fmi3Float64 values[], size_t size) {
    Instance *i = c;
    size_t place = 0;
    if (closed(i, vr, n)) return fmi3Error;
    for (size_t k = 0; k < n; k++) {
        size_t length = i->model == 'a' ? (size_t)i->s.whole[1] : 1;
        if (place + length > size) return fmi3Error;
        for (size_t j = 0; j < length; j++)
            *(i->model == 'a' ? &i->s.array[0][j] : &i->s.real[vr[k]]) = values[place++];
    }
    return fmi3OK;
}

/* Model Exchange, for both standards: the ball bounces below its floor; the stair rises at whole
   seconds; van der Pol's place changes its sign at the end of a step of the solver. */
static int update(Instance *c, bool *again, bool *ends, bool *defined, double *next) {
    State *s = &c->s;
    *again = *ends = *defined = false;
    if (c->exchange && c->mode != EVENT) return say(c, ERROR, "this is no Event Mode");
    if (c->model == 'r') *again = s->whole[1] == 1, *ends = s->whole[1] == 2;
    if (c->model == 'b' && s->real[1] <= 0 && s->real[2] < 0) s->real[1] = 1e-300, bounce(s);
    if (c->model == 's' && c->exchange) {
        while (s->time >= (double)s->whole[1]) s->whole[1]++;
        *ends = s->whole[1] >= s->whole[2];
        *defined = true, *next = (double)s->whole[1];
    }
    if (c->model == 'v' && (s->real[1] < 0) != s->whole[6]) s->whole[5]++, s->whole[6] ^= 1;
    if (c->model == 't') {
        if (c->exchange && s->time >= s->real[19]) s->real[19] = INFINITY, s->whole[21] = 1;
        tick(s);
        *defined = s->real[19] < INFINITY, *next = s->real[19];
    }
    return OK;
}

static int enter(Instance *c, int mode) {
    bool kept = c->exchange || c->model == 't';
    if (kept && c->mode == mode) return say(c, ERROR, "this is that mode");
    c->mode = kept ? mode : FREE;
    return OK;
}

static int get_derivatives(Instance *c, double values[], size_t n) {
    if (c->model == 'd' && c->s.time > c->s.real[4] * (1 + 1e-9))
        return say(c, ERROR, "cannot go on");
    for (size_t k = 0; k < n; k++) values[k] = derivative(c, k);
    return OK;
}

static int completed(Instance *c, bool *event, bool *ends) {
    State *s = &c->s;
    *event = c->model == 'v' && (s->real[1] < 0) != s->whole[6];
    *ends = c->model == 'v' && s->time >= s->real[4];
    return OK;
}

#define EXCHANGE(S, C, NAME)                                                                       \
    fmi##S##Status fmi##S##EnterEventMode(C c) { return (fmi##S##Status)enter(c, EVENT); }         \
    fmi##S##Status fmi##S##EnterContinuousTimeMode(C c) {                                          \
        return (fmi##S##Status)enter(c, CONTINUOUS);                                               \
    }                                                                                              \
    fmi##S##Status fmi##S##SetTime(C c, double time) {                                             \
        ((Instance *)c)->s.time = time;                                                            \
        return fmi##S##OK;                                                                         \
    }                                                                                              \
    fmi##S##Status fmi##S##SetContinuousStates(C c, const double x[], size_t n) {                  \
        unsigned slots[2];                                                                         \
        states(c, slots);                                                                          \
        for (size_t k = 0; k < n; k++) ((Instance *)c)->s.real[slots[k]] = x[k];                   \
        return fmi##S##OK;                                                                         \
    }                                                                                              \
    fmi##S##Status fmi##S##GetContinuousStates(C c, double x[], size_t n) {                        \
        unsigned slots[2];                                                                         \
        states(c, slots);                                                                          \
        for (size_t k = 0; k < n; k++) x[k] = ((Instance *)c)->s.real[slots[k]];                   \
        return fmi##S##OK;                                                                         \
    }                                                                                              \
    fmi##S##Status fmi##S##GetNominalsOfContinuousStates(C c, double x[], size_t n) {              \
        for (size_t k = 0; k < n; k++) x[k] = 1;                                                   \
        return fmi##S##OK;                                                                         \
    }                                                                                              \
    fmi##S##Status NAME(C c, double values[], size_t n) {                                          \
        return (fmi##S##Status)get_derivatives(c, values, n);                                      \
    }                                                                                              \
    fmi##S##Status fmi##S##GetEventIndicators(C c, double z[], size_t n) {                         \
        const double *r = ((Instance *)c)->s.real; /* below the floor with some width */           \
        if (n) z[0] = r[1] > -1e-10 && r[1] <= 0 && r[2] > 0 ? -1e-10 : r[1];                      \
        return fmi##S##OK;                                                                         \
    }
EXCHANGE(2, fmi2Component, fmi2GetDerivatives)
EXCHANGE(3, fmi3Instance, fmi3GetContinuousStateDerivatives)

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean final, fmi2Boolean *event,
                                       fmi2Boolean *ends) {
    bool told[2];
    int status = completed(c, &told[0], &told[1]);
    *event = told[0], *ends = told[1];
    return (fmi2Status)status;
}
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean final, fmi3Boolean *event,
                                       fmi3Boolean *ends) {
    return (fmi3Status)completed(c, event, ends);
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    bool told[3];
    int status = update(c, &told[0], &told[1], &told[2], &info->nextEventTime);
    info->newDiscreteStatesNeeded = told[0], info->terminateSimulation = told[1];
    info->nextEventTimeDefined = told[2];
    info->valuesOfContinuousStatesChanged = info->nominalsOfContinuousStatesChanged = false;
    return (fmi2Status)status;
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
    Instance *c = make(token);
    if (c && logging) c->log_3 = log, c->environment = environment;
    if (c) c->exchange = true;
    return c;
}
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    unsigned slots[2];
    *n = states(c, slots);
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    *n = ((Instance *)c)->model == 'b';
    return fmi3OK;
}

/* FMI 2.0 */
static bool needs_stop(Instance *c) { return c->model == 'd' && c->s.real[7] > 0; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Instance *c = make(guid);
    if (c) c->exchange = type == fmi2ModelExchange;
    if (c && logging) c->log_2 = functions->logger, c->environment = functions->componentEnvironment;
    return c;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stops, fmi2Real stop) {
    ((Instance *)c)->s.time = start;
    return needs_stop(c) && !stops ? fmi2Error : fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    if (((Instance *)c)->exchange || ((Instance *)c)->model == 't') ((Instance *)c)->mode = EVENT;
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean final) {
    bool event;
    int status = step(c, time, h, &event);
    return (fmi2Status)(status == OK && ((Instance *)c)->s.ends ? DISCARD : status);
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    *value = ((Instance *)c)->s.ends;
    return fmi2OK;
}

/* FMI 3.0 */
fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
    const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Instance *c = make(token);
    if (c) c->events = events && early;
    if (c && logging) c->log_3 = log, c->environment = environment;
    return c;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) {
    int64_t n = ((Instance *)c)->s.whole[1];
    return ((Instance *)c)->model == 'a' && (n < 1 || n > MOST) ? fmi3Error : fmi3OK;
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop) {
    ((Instance *)c)->s.time = start;
    return needs_stop(c) && !stops ? fmi3Error : fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    return (fmi3Status)fmi2ExitInitializationMode(c);
}
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { return (fmi3Status)enter(c, CONTINUOUS); }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *ends,
                                    fmi3Boolean *nominals, fmi3Boolean *values,
                                    fmi3Boolean *defined, fmi3Float64 *next) {
    *nominals = *values = false;
    return (fmi3Status)update(c, again, ends, defined, next);
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 h, fmi3Boolean final,
                      fmi3Boolean *event, fmi3Boolean *ends, fmi3Boolean *early,
                      fmi3Float64 *reached) {
    Instance *i = c;
    int status = step(i, time, h, event);
    *ends = i->s.ends;
    *early = *event;
    *reached = i->s.time;
    return (fmi3Status)status;
}

/* Clocks, of the model ticker only. */
fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                        const fmi3Clock values[]) {
    Instance *i = c;
    if (i->model != 't' || i->mode != EVENT) return fmi3Error;
    for (size_t k = 0; k < n; k++) i->s.active[vr[k]] = values[k];
    return fmi3OK;
}
static int get_interval(Instance *c, const fmi3ValueReference vr[], size_t n, double *value,
                        fmi3IntervalQualifier *told) {
    State *s = &c->s;
    if (c->mode == CONTINUOUS || n != 1 || vr[0] != 1) return ERROR;
    if (!c->mode && s->whole[13] != 3) plan(s, s->real[11]);
    *value = s->real[20], *told = (fmi3IntervalQualifier)s->told;
    if (s->told == CHANGED) s->told = UNCHANGED;
    return OK;
}
fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                  fmi3Float64 values[], fmi3IntervalQualifier told[]) {
    return (fmi3Status)get_interval(c, vr, n, values, told);
}
fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier told[]) {
    double value;
    int status = get_interval(c, vr, n, &value, told);
    counters[0] = 1, resolutions[0] = (uint64_t)round(1 / value);
    return (fmi3Status)status;
}
fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                               fmi3Float64 values[]) {
    values[0] = ((Instance *)c)->s.real[12];
    return fmi3OK;
}
fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                fmi3UInt64 counters[], fmi3UInt64 resolutions[]) {
    counters[0] = 0, resolutions[0] = 1;
    return fmi3OK;
}

/* States are plain data. */
#define STATES(S, N, TYPE)                                                                         \
    fmi##S##Status fmi##S##GetFMU##N(TYPE c, fmi##S##FMU##N *state) {                              \
        if (!*state) *state = malloc(sizeof(State));                                               \
        memcpy(*state, &((Instance *)c)->s, sizeof(State));                                        \
        return fmi##S##OK;                                                                         \
    }                                                                                              \
    fmi##S##Status fmi##S##SetFMU##N(TYPE c, fmi##S##FMU##N state) {                               \
        memcpy(&((Instance *)c)->s, state, sizeof(State));                                         \
        return fmi##S##OK;                                                                         \
    }                                                                                              \
    fmi##S##Status fmi##S##FreeFMU##N(TYPE c, fmi##S##FMU##N *state) {                             \
        free(*state);                                                                              \
        *state = NULL;                                                                             \
        return fmi##S##OK;                                                                         \
    }
STATES(2, state, fmi2Component)
STATES(3, State, fmi3Instance)

/* The rest is there because importers look for it. */
#define NONE(NAME) int NAME(void) { return ERROR; }
NONE(fmi2GetTypesPlatform) NONE(fmi2GetVersion) NONE(fmi2SetDebugLogging) NONE(fmi2Reset)
NONE(fmi2SerializedFMUstateSize)
NONE(fmi2SerializeFMUstate) NONE(fmi2DeSerializeFMUstate) NONE(fmi2GetDirectionalDerivative)
NONE(fmi2SetRealInputDerivatives)
NONE(fmi2GetRealOutputDerivatives) NONE(fmi2CancelStep) NONE(fmi2GetStatus)
NONE(fmi2GetRealStatus) NONE(fmi2GetIntegerStatus) NONE(fmi2GetStringStatus) NONE(fmi3GetVersion)
NONE(fmi3SetDebugLogging)
NONE(fmi3InstantiateScheduledExecution) NONE(fmi3Reset) NONE(fmi3GetBinary)
NONE(fmi3GetClock) NONE(fmi3SetBinary)
NONE(fmi3GetNumberOfVariableDependencies) NONE(fmi3GetVariableDependencies)
NONE(fmi3SerializedFMUStateSize) NONE(fmi3SerializeFMUState) NONE(fmi3DeserializeFMUState)
NONE(fmi3GetDirectionalDerivative) NONE(fmi3GetAdjointDerivative)
NONE(fmi3SetIntervalDecimal) NONE(fmi3SetIntervalFraction) NONE(fmi3SetShiftDecimal)
NONE(fmi3SetShiftFraction) NONE(fmi3EvaluateDiscreteStates) NONE(fmi3GetOutputDerivatives)
NONE(fmi3ActivateModelPartition)

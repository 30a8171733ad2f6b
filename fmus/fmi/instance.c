/* See instance.h: life cycle, messages, time and its steps, seal of serialised states. */
#include "instance.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "variables.h"

enum { MESSAGE_SIZE = 512 };

static const char LOG_CATEGORY[] = "logStatusError";

/* Above this a communication step is a mistake in the importer: it would run for minutes. */
static const double MOST_STEPS = 1e9;

/* How far a communication point may be off, in parts of the shorter of communication and internal step,
 * beside four units in the last place: importers round times, some to nanoseconds. */
static const double TIME_TOLERANCE = 1e-4;

Status fail(const Instance *instance, const char *function, const char *format, ...) {
    if (!instance->logging)
        return STATUS_ERROR;
    char message[MESSAGE_SIZE];
    const int length = snprintf(message, sizeof message, "%s: ", function);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(message + length, sizeof message - (size_t)length, format, arguments);
    va_end(arguments);
    instance->log(instance, STATUS_ERROR, LOG_CATEGORY, message);
    return STATUS_ERROR;
}

Status fail_state(const Instance *instance, const char *function) {
    const int state = instance->now.life_cycle;
    return fail(instance, function, "not allowed in %s",
                state == INSTANTIATED      ? "the state Instantiated"
                : state == CONFIGURATION   ? "Configuration Mode"
                : state == INITIALIZATION  ? "Initialization Mode"
                : state == STEP            ? "Step Mode"
                : state == EVENT           ? "Event Mode"
                : state == CONTINUOUS_TIME ? "Continuous-Time Mode"
                                           : "the state Terminated");
}

Status fail_reference(const Instance *instance, const char *function, uint32_t reference,
                      const char *wanted) {
    if (reference < VARIABLE_COUNT)
        return fail(instance, function, "%s is no %s", variable_name[reference], wanted);
    return fail(instance, function, "there is no variable with value reference %u",
                (unsigned)reference);
}

Status fail_arrays(const Instance *instance, const char *function) {
    return fail(instance, function, "an array of value references or values is null");
}

Status fail_fixed(const Instance *instance, const char *function, uint32_t reference) {
    return fail(instance, function, "%s is a fixed parameter; set it before the simulation starts",
                variable_name[reference]);
}

Status instance_reset(Instance *instance, const char *function) {
    const Standing before = instance->now;
    instance->now = (Standing){.stop_time = INFINITY,
                               .life_cycle = INSTANTIATED,
                               .model_exchange = before.model_exchange};
    if (model_reset(instance, function) == STATUS_OK)
        return STATUS_OK;
    instance->now = before;
    return STATUS_ERROR;
}

Instance *instance_new(const char *name, const char *token, bool model_exchange, LogFunction *log,
                       void (*callback)(void), void *environment, bool logging) {
    static char no_name[] = "";
    Instance draft = {.log = log, .callback = callback, .environment = environment, .name = no_name,
                      .logging = logging, .now.model_exchange = model_exchange};
    if (!name || !name[strspn(name, " \t\n\v\f\r")]) {
        fail(&draft, "instantiate", "the instance name is blank");
        return NULL;
    }
    if (!token || strcmp(token, INSTANTIATION_TOKEN) != 0) {
        fail(&draft, "instantiate",
             "the token \"%s\" is not \"%s\": model description and binary are of different builds",
             token ? token : "", INSTANTIATION_TOKEN);
        return NULL;
    }
    if (model_exchange && !model_exchanges) {
        fail(&draft, "instantiate", "this FMU does not offer Model Exchange");
        return NULL;
    }
    Instance *instance = calloc(1, model_size);
    char *copy = malloc(strlen(name) + 1);
    if (!instance || !copy) {
        free(instance);
        free(copy);
        fail(&draft, "instantiate", "out of memory");
        return NULL;
    }
    *instance = draft;
    instance->name = strcpy(copy, name);
    if (instance_reset(instance, "instantiate") != STATUS_OK) {
        instance_free(instance);
        return NULL;
    }
    return instance;
}

void instance_free(Instance *instance) {
    if (!instance)
        return;
    model_release(instance);
    free(instance->name);
    free(instance);
}

Status instance_set_logging(Instance *instance, const char *function, bool on, size_t count,
                            const char *const categories[]) {
    for (size_t k = 0; k < count; k++)
        if (!categories || !categories[k] || strcmp(categories[k], LOG_CATEGORY) != 0)
            return fail(instance, function, "there is no log category \"%s\"; use %s",
                        categories && categories[k] ? categories[k] : "", LOG_CATEGORY);
    instance->logging = on;
    return STATUS_OK;
}

Status instance_set_experiment(Instance *instance, const char *function, double start_time,
                               bool stop_time_defined, double stop_time) {
    if (!isfinite(start_time))
        return fail(instance, function, "the start time is %g; give a finite number", start_time);
    if (stop_time_defined && !(stop_time >= start_time))
        return fail(instance, function, "the stop time %g is before the start time %g", stop_time,
                    start_time);
    instance->now.time = start_time;
    instance->now.stop_time = stop_time_defined ? stop_time : INFINITY;
    return STATUS_OK;
}

Status check_double(const Instance *instance, const char *function, uint32_t reference,
                    double value) {
    const bool is_input = reference - INPUT_FIRST < INPUT_COUNT;
    const uint32_t parameter = reference - PARAMETER_FIRST;
    if (!is_input && parameter >= PARAMETER_COUNT)
        return fail_reference(instance, function, reference,
                              "floating-point variable that can be set");
    if (!is_input && !parameter_tunable[parameter] && !(instance->now.life_cycle & STARTING))
        return fail_fixed(instance, function, reference);
    if (!isfinite(value))
        return fail(instance, function, "%s cannot be %g; give a finite number",
                    variable_name[reference], value);
    if (!is_input && !(value >= parameter_min[parameter]))
        return fail(instance, function, "%s cannot be %g; the least is %g",
                    variable_name[reference], value, parameter_min[parameter]);
    if (!is_input && !(value <= parameter_max[parameter]))
        return fail(instance, function, "%s cannot be %g; the most is %g",
                    variable_name[reference], value, parameter_max[parameter]);
    return STATUS_OK;
}

/* Whether a communication step can be made; says why not. */
static Status check_step(const Instance *instance, const char *function, double time,
                         double step_size, double h) {
    const Standing *now = &instance->now;
    if (!(step_size > 0.0) || !(step_size <= MOST_STEPS * h))
        return fail(instance, function,
                    "the communication step is %g s; give a positive one of at most %g s",
                    step_size, MOST_STEPS * h);
    const double shorter = step_size < h ? step_size : h;
    const double rounding = TIME_TOLERANCE * shorter + 4.0 * DBL_EPSILON * fabs(now->time);
    if (!(fabs(time - now->time) <= rounding))
        return fail(instance, function,
                    "the communication point is %.17g s but the FMU is at %.17g s", time,
                    now->time);
    /* Sums of steps may end a little late; half a step is a step too many. */
    if (!(time + step_size <= now->stop_time + 0.5 * shorter))
        return fail(instance, function, "the step from %g s by %g s goes beyond the stop time %g s",
                    time, step_size, now->stop_time);
    return STATUS_OK;
}

Status plan_step(const Instance *instance, const char *function, double time, double step_size,
                 double h, Plan *plan) {
    if (check_step(instance, function, time, step_size, h) != STATUS_OK)
        return STATUS_ERROR;
    *plan = (Plan){.steps = 1, .owed = instance->now.owed};
    if (step_size != h) {
        const double ratio = step_size / h;
        plan->steps = (int64_t)(ratio + 0.5);
        if (fabs(ratio - (double)plan->steps) > WHOLE_STEPS_TOLERANCE) {
            plan->steps = (int64_t)ratio;
            plan->rest = step_size - (double)plan->steps * h;
        } else {
            plan->owed += step_size - (double)plan->steps * h;
        }
    }
    if (fabs(plan->owed) > WHOLE_STEPS_TOLERANCE * h) {
        if (plan->owed < 0.0) { /* make the last whole step shorter */
            plan->steps -= 1;
            plan->rest = h;
        }
        plan->rest += plan->owed;
        plan->owed = 0.0;
    }
    return STATUS_OK;
}

Status fail_growth(const Instance *instance, const char *function, const char *whose, double time,
                   double h) {
    return fail(instance, function,
                "the state%s grew beyond all bounds in the step from %g s; step_size %g s is too "
                "long for these parameters",
                whose, time, h);
}

/* FNV-1a: differs for any damage within one byte, and for all other but one in 2^64. */
static uint64_t checksum(const unsigned char bytes[], size_t size) {
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    for (size_t k = 0; k < size; k++)
        hash = (hash ^ bytes[k]) * UINT64_C(0x100000001b3);
    return hash;
}

enum { TOKEN_SIZE = sizeof INSTANTIATION_TOKEN };

size_t sealed_size(size_t content_size) { return TOKEN_SIZE + content_size + sizeof(uint64_t); }

Status seal(const Instance *instance, const char *function, const void *content,
            size_t content_size, unsigned char bytes[], size_t size) {
    if (size != sealed_size(content_size))
        return fail(instance, function, "room for %lu bytes, but a state has %lu",
                    (unsigned long)size, (unsigned long)sealed_size(content_size));
    memcpy(bytes, INSTANTIATION_TOKEN, TOKEN_SIZE);
    memcpy(bytes + TOKEN_SIZE, content, content_size);
    const uint64_t sum = checksum(bytes, TOKEN_SIZE + content_size);
    memcpy(bytes + TOKEN_SIZE + content_size, &sum, sizeof sum);
    return STATUS_OK;
}

const unsigned char *unseal(const Instance *instance, const char *function,
                            const unsigned char bytes[], size_t size) {
    const size_t before = size - sizeof(uint64_t);
    const uint64_t sum = checksum(bytes, before);
    if (memcmp(bytes + before, &sum, sizeof sum) != 0)
        fail(instance, function, "the bytes are a damaged state, or none");
    else if (memcmp(bytes, INSTANTIATION_TOKEN, TOKEN_SIZE) != 0)
        fail(instance, function, "the state is of another build of the FMU");
    else
        return bytes + TOKEN_SIZE;
    return NULL;
}

bool within(const double values[], size_t count, const double least[], const double most[]) {
    for (size_t k = 0; k < count; k++)
        if (!isfinite(values[k]) || (least && values[k] < least[k]) || (most && values[k] > most[k]))
            return false;
    return true;
}

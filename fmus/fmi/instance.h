/* What an instance is whichever model it is of and whichever FMI standard it was made through: life
 * cycle, messages, the time and its steps, the seal of serialised states; and what every model
 * supplies: one motor (single.c) or an array of motors (array.c).
 *
 * Each FMU is one C file that includes all others. They are static, so that FMUs linked into one
 * program share no names, and inline where only one standard or model uses them.
 *
 * Every refusal is STATUS_ERROR with a message and leaves the instance as it was. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "variables.h"

/* Equal to fmi2Status and fmi3Status. */
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR, STATUS_FATAL } Status;

/* Life cycle; a function names the states it may be called in. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEP = 4,
    TERMINATED = 8,
    CONFIGURATION = 16, /* of structural parameters */
    STARTING = INSTANTIATED | INITIALIZATION,
    READABLE = INITIALIZATION | STEP | TERMINATED,
    WRITABLE = STARTING | STEP,
    ANY_STATE = WRITABLE | TERMINATED | CONFIGURATION
} LifeCycle;

/* A communication step this near a whole number of internal steps, in internal steps, is made of
 * whole ones; importers compute it as a difference of times. The difference is owed, and made up
 * for once it is more than this. */
#define WHOLE_STEPS_TOLERANCE 1e-6

/* Where an instance stands. Time is the importer's number, never a sum of steps: rounding does not
 * accumulate. */
typedef struct {
    double time; /* s */
    double owed; /* s of the communication steps that the integration is behind, or ahead if < 0 */
    double stop_time;
    int64_t life_cycle;
} Standing;

typedef struct Instance Instance;
typedef void LogFunction(const Instance *instance, Status status, const char *category,
                         const char *message);

/* The first member of a model's instance. */
struct Instance {
    Standing now;
    char *name;
    LogFunction *log;
    void (*callback)(void); /* the importer's logger, cast back by the shim's LogFunction */
    void *environment;
    bool logging; /* whether the importer wants messages */
    bool changed; /* whether parameters may not be those that were last found to be stable */
};

/* What each model supplies. */

static const size_t model_size; /* of its instance */
/* Start values; may be out of memory. */
static Status model_reset(Instance *instance, const char *function);
/* Free what the model has allocated. */
static void model_release(Instance *instance);
static Status model_do_step(Instance *instance, const char *function, double time,
                            double step_size);

static Status model_get_double(const Instance *instance, const char *function,
                               const uint32_t references[], size_t count, double values[],
                               size_t value_count);
static Status model_set_double(Instance *instance, const char *function,
                               const uint32_t references[], size_t count, const double values[],
                               size_t value_count);
/* Whether internal steps are short enough for the parameters; says why not. */
static Status model_is_stable(const Instance *instance, const char *function);
/* A variable that is not floating-point and has one value: where it is, and what it may be. */
typedef struct {
    int32_t *value; /* NULL if there is none */
    int32_t least, most;
} Option;

/* The option of a reference and type, "Boolean" or "Enumeration". */
static Option model_option(Instance *instance, uint32_t reference, const char *type);
/* Put changed options into force. */
static void model_options_changed(Instance *instance);

static Status model_save(const Instance *instance, const char *function, void **state);
static Status model_restore(Instance *instance, const char *function, const void *state);
static size_t model_state_size(const void *state);
static Status model_deserialize(const Instance *instance, const char *function,
                                const unsigned char bytes[], size_t size, void **state);

enum { MESSAGE_SIZE = 512 };

static const char LOG_CATEGORY[] = "logStatusError";

/* Above this a communication step is a mistake in the importer: it would run for minutes. */
static const double MOST_STEPS = 1e9;

/* How far a communication point may be off, in parts of the shorter of communication and internal
 * step, beside four units in the last place: importers round times, some to nanoseconds. */
static const double TIME_TOLERANCE = 1e-4;

/* Have compilers that can do so check arguments against a printf format. */
#ifdef __GNUC__
#define PRINTF_LIKE(text, arguments) __attribute__((format(printf, text, arguments)))
#else
#define PRINTF_LIKE(text, arguments)
#endif

/* Log an error as "function: message", if the importer wants messages, and return STATUS_ERROR. */
static Status fail(const Instance *instance, const char *function, const char *format, ...)
    PRINTF_LIKE(3, 4);

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

static Status fail_state(const Instance *instance, const char *function) {
    const int64_t state = instance->now.life_cycle;
    return fail(instance, function, "not allowed in %s",
                state == INSTANTIATED     ? "the state Instantiated"
                : state == CONFIGURATION  ? "Configuration Mode"
                : state == INITIALIZATION ? "Initialization Mode"
                : state == STEP           ? "Step Mode"
                                          : "the state Terminated");
}

/* Why a reference is none of the wanted variables. */
static Status fail_reference(const Instance *instance, const char *function, uint32_t reference,
                             const char *wanted) {
    if (reference < VARIABLE_COUNT)
        return fail(instance, function, "%s is no %s", variable_name[reference], wanted);
    return fail(instance, function, "there is no variable with value reference %u",
                (unsigned)reference);
}

static Status fail_arrays(const Instance *instance, const char *function) {
    return fail(instance, function, "an array of value references or values is null");
}

static Status fail_fixed(const Instance *instance, const char *function, uint32_t reference) {
    return fail(instance, function, "%s is a fixed parameter; set it before the simulation starts",
                variable_name[reference]);
}

/* Refuse a call on no instance or in the wrong state; for the first line of a shim's function. */
#define REQUIRE(instance, states)                                                                  \
    do {                                                                                           \
        if (!(instance))                                                                           \
            return (int)STATUS_ERROR;                                                              \
        if (!((instance)->now.life_cycle & (states)))                                              \
            return (int)fail_state((instance), __func__);                                          \
    } while (0)

/* Refuse null pointers among an importer's arguments, where something is to be behind them. */
#define REQUIRE_POINTER(instance, pointer)                                                         \
    do {                                                                                           \
        if (!(pointer))                                                                            \
            return (int)fail((instance), __func__, "the argument %s is null", #pointer);           \
    } while (0)

/* Refuse arrays of different lengths where variables have one value each. */
#define REQUIRE_EQUAL_COUNTS(instance, references, values)                                         \
    do {                                                                                           \
        if ((references) != (values))                                                              \
            return (int)fail((instance), __func__, "%lu value references but %lu values",          \
                             (unsigned long)(references), (unsigned long)(values));                \
    } while (0)

/* Refuse to begin or to step with parameters for which the internal step is too long. */
static Status check_changed(Instance *instance, const char *function) {
    if (!instance->changed)
        return STATUS_OK;
    const Status status = model_is_stable(instance, function);
    instance->changed = status != STATUS_OK;
    return status;
}

static Status instance_reset(Instance *instance, const char *function) {
    const Standing before = instance->now;
    instance->now = (Standing){.stop_time = INFINITY, .life_cycle = INSTANTIATED};
    if (model_reset(instance, function) == STATUS_OK)
        return STATUS_OK;
    instance->now = before;
    return STATUS_ERROR;
}

static void instance_free(Instance *instance) {
    if (!instance)
        return;
    model_release(instance);
    free(instance->name);
    free(instance);
}

/* Returns NULL after a message if the name is blank or the token is of another build. */
static Instance *instance_new(const char *name, const char *token, LogFunction *log,
                              void (*callback)(void), void *environment, bool logging) {
    static char no_name[] = "";
    Instance draft = {.log = log,
                      .callback = callback,
                      .environment = environment,
                      .name = no_name,
                      .logging = logging};
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

/* Switch messages on or off. The model description has one log category: naming it is naming all.
 */
static Status instance_set_logging(Instance *instance, const char *function, bool on, size_t count,
                                   const char *const categories[]) {
    for (size_t k = 0; k < count; k++)
        if (!categories || !categories[k] || strcmp(categories[k], LOG_CATEGORY) != 0)
            return fail(instance, function, "there is no log category \"%s\"; use %s",
                        categories && categories[k] ? categories[k] : "", LOG_CATEGORY);
    instance->logging = on;
    return STATUS_OK;
}

static Status instance_set_experiment(Instance *instance, const char *function, double start_time,
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

/* Whether a variable may take a value now, and says why not; inputs and parameters are those of
 * variables.h. */
static Status check_double(const Instance *instance, const char *function, uint32_t reference,
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
        return fail(instance, function, "%s cannot be %g; the most is %g", variable_name[reference],
                    value, parameter_max[parameter]);
    return STATUS_OK;
}

/* Whether an option may take a value now; says why not. */
static Status check_option(Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t value) {
    const Option option = model_option(instance, reference, type);
    if (!option.value)
        return fail_reference(instance, function, reference, type);
    if (!(instance->now.life_cycle & STARTING))
        return fail_fixed(instance, function, reference);
    if (value < option.least || value > option.most)
        return fail(instance, function, "%s cannot be %lld; use %d to %d", variable_name[reference],
                    (long long)value, (int)option.least, (int)option.most);
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

/* A communication step: whole internal steps, a shorter one unless rest is 0, and what is owed
 * then. */
typedef struct {
    int64_t steps;
    double rest, owed;
} Plan;

/* Say which internal steps h a communication step is made of, or why it cannot be made. */
static Status plan_step(Instance *instance, const char *function, double time,
                        double step_size, double h, Plan *plan) {
    if (check_changed(instance, function) != STATUS_OK ||
        check_step(instance, function, time, step_size, h) != STATUS_OK)
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

static Status fail_growth(const Instance *instance, const char *function, const char *whose,
                          double time, double h) {
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

/* A serialised state: the token of the build, so that no other build reads it, the model's content,
 * and a checksum of all before it. */
enum { TOKEN_SIZE = sizeof INSTANTIATION_TOKEN };

static size_t sealed_size(size_t content_size) {
    return TOKEN_SIZE + content_size + sizeof(uint64_t);
}

static Status seal(const Instance *instance, const char *function, const void *content,
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

/* The content, or NULL after a message if the bytes are damaged or of another build. */
static const unsigned char *unseal(const Instance *instance, const char *function,
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

/* Whether all values are finite and within their limits, where there are any. */
static bool within(const double values[], size_t count, const double least[], const double most[]) {
    for (size_t k = 0; k < count; k++)
        if (!isfinite(values[k]) || (least && values[k] < least[k]) ||
            (most && values[k] > most[k]))
            return false;
    return true;
}

/* Whether an instance with internal steps h can stand there. */
static bool is_standing(const Standing *now, double h) {
    const int64_t life = now->life_cycle;
    return isfinite(now->time) && now->stop_time > -INFINITY &&
           fabs(now->owed) <= WHOLE_STEPS_TOLERANCE * h && life > 0 && !(life & (life - 1)) &&
           (life & ANY_STATE);
}

#endif

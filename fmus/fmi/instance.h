/* What an instance is whichever model it is of and whichever FMI standard it was made through: life
 * cycle, messages, the time and its steps, the seal of serialised states (instance.c); and what every
 * model supplies: an array of motors (array.h), or what is alike for models of plain data (plain.h).
 *
 * Each FMU is one C file that includes all others. They are static, so that FMUs linked into one
 * program share no names, and inline where only one standard or model uses them.
 *
 * Every refusal is STATUS_ERROR with a message and leaves the instance as it was. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Equal to fmi2Status and fmi3Status. */
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR, STATUS_FATAL } Status;

/* Life cycle; a function names the states it may be called in. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEP = 4,             /* co-simulation */
    EVENT = 8,            /* Model Exchange */
    CONTINUOUS_TIME = 16, /* Model Exchange */
    TERMINATED = 32,
    CONFIGURATION = 64, /* of structural parameters */
    STARTING = INSTANTIATED | INITIALIZATION,
    RUNNING = STEP | EVENT | CONTINUOUS_TIME,
    READABLE = INITIALIZATION | RUNNING | TERMINATED,
    WRITABLE = STARTING | RUNNING,
    ANY_STATE = WRITABLE | TERMINATED | CONFIGURATION
} LifeCycle;

/* A communication step this near a whole number of internal steps, in internal steps, is made of
 * whole ones; importers compute it as a difference of times. The difference is owed, and made up for
 * once it is more than this. */
#define WHOLE_STEPS_TOLERANCE 1e-6

/* Where an instance stands. Time is the importer's number, never a sum of steps: rounding does not
 * accumulate. */
typedef struct {
    double time; /* s */
    double owed; /* s of the communication steps that the integration is behind, or ahead if < 0 */
    double stop_time;
    int32_t life_cycle;
    int32_t model_exchange;
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
};

/* Returns NULL after a message if the name is blank or the token is of another build. */
static Instance *instance_new(const char *name, const char *token, bool model_exchange,
                              LogFunction *log, void (*callback)(void), void *environment,
                              bool logging);
static void instance_free(Instance *instance);
static Status instance_reset(Instance *instance, const char *function);

/* Have compilers that can do so check arguments against a printf format. */
#ifdef __GNUC__
#define PRINTF_LIKE(text, arguments) __attribute__((format(printf, text, arguments)))
#else
#define PRINTF_LIKE(text, arguments)
#endif

/* Log an error as "function: message", if the importer wants messages, and return STATUS_ERROR. */
static Status fail(const Instance *instance, const char *function, const char *format, ...)
    PRINTF_LIKE(3, 4);

static Status fail_state(const Instance *instance, const char *function);
/* Why a reference is none of the wanted variables. */
static Status fail_reference(const Instance *instance, const char *function, uint32_t reference,
                             const char *wanted);
static Status fail_arrays(const Instance *instance, const char *function);
static Status fail_fixed(const Instance *instance, const char *function, uint32_t reference);

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

/* Switch messages on or off. The model description has one log category: naming it is naming all. */
static Status instance_set_logging(Instance *instance, const char *function, bool on, size_t count,
                                   const char *const categories[]);

static Status instance_set_experiment(Instance *instance, const char *function, double start_time,
                                      bool stop_time_defined, double stop_time);

/* Whether a variable may take a value now, and says why not; inputs and parameters are those of
 * variables.h. */
static Status check_double(const Instance *instance, const char *function, uint32_t reference,
                           double value);

/* A communication step: whole internal steps, a shorter one unless rest is 0, and what is owed then. */
typedef struct {
    int64_t steps;
    double rest, owed;
} Plan;

/* Say which internal steps h a communication step is made of, or why it cannot be made. */
static Status plan_step(const Instance *instance, const char *function, double time,
                        double step_size, double h, Plan *plan);

static Status fail_growth(const Instance *instance, const char *function, const char *whose,
                          double time, double h);

/* A serialised state: the token of the build, so that no other build reads it, the model's content,
 * and a checksum of all before it. */
static size_t sealed_size(size_t content_size);
static Status seal(const Instance *instance, const char *function, const void *content,
                   size_t content_size, unsigned char bytes[], size_t size);
/* The content, or NULL after a message if the bytes are damaged or of another build. */
static const unsigned char *unseal(const Instance *instance, const char *function,
                                   const unsigned char bytes[], size_t size);
/* Whether all values are finite and within their limits, where there are any. */
static bool within(const double values[], size_t count, const double least[], const double most[]);

/* What each model supplies. */

static const size_t model_size;     /* of its instance */
static const bool model_exchanges; /* whether it offers Model Exchange */
/* Start values; may be out of memory. */
static Status model_reset(Instance *instance, const char *function);
/* Free what the model has allocated. */
static void model_release(Instance *instance);
static void model_exit_initialization(Instance *instance);
static Status model_do_step(Instance *instance, const char *function, double time,
                            double step_size);

static Status model_get_double(const Instance *instance, const char *function,
                               const uint32_t references[], size_t count, double values[],
                               size_t value_count);
static Status model_set_double(Instance *instance, const char *function,
                               const uint32_t references[], size_t count, const double values[],
                               size_t value_count);
/* Variables that are not floating-point and have one value: the type is "Boolean" or "Enumeration". */
static Status model_get_option(const Instance *instance, const char *function, uint32_t reference,
                               const char *type, int64_t *value);
/* Whether an option may take a value now; says why not. */
static Status model_check_option(const Instance *instance, const char *function, uint32_t reference,
                                 const char *type, int64_t value);
/* Set an option to a value that was checked. */
static void model_set_option(Instance *instance, uint32_t reference, const char *type,
                             int64_t value);

static Status model_save(const Instance *instance, const char *function, void **state);
static Status model_restore(Instance *instance, const char *function, const void *state);
static size_t model_state_size(const void *state);
static Status model_deserialize(const Instance *instance, const char *function,
                                const unsigned char bytes[], size_t size, void **state);

#endif

/* One instance of the FMU, whichever FMI standard it was made through: life cycle, messages,
 * stepping (instance.c), access to variables by value reference (access.c), saved states (saving.c).
 * The shims fmi2.c and fmi3.c only translate calls.
 *
 * VibrationMotor_fmi2.c and VibrationMotor_fmi3.c each include all of it. It is static, so that FMUs
 * linked into one program share no names, and inline where only one standard uses it.
 *
 * Every refusal is STATUS_ERROR with a message and leaves the instance as it was. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>

#include "motor.h"

/* Equal to fmi2Status and fmi3Status. */
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR, STATUS_FATAL } Status;

/* Life cycle; a function names the states it may be called in. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEP = 4,            /* co-simulation */
    EVENT = 8,           /* Model Exchange */
    CONTINUOUS_TIME = 16 /* Model Exchange */,
    TERMINATED = 32,
    STARTING = INSTANTIATED | INITIALIZATION,
    RUNNING = STEP | EVENT | CONTINUOUS_TIME,
    READABLE = INITIALIZATION | RUNNING | TERMINATED,
    WRITABLE = STARTING | RUNNING,
    ANY_STATE = WRITABLE | TERMINATED
} LifeCycle;

/* A communication step this near a whole number of internal steps, in internal steps, is made of
 * whole ones; importers compute it as a difference of times. The difference is owed, and made up for
 * once it is more than this. */
#define WHOLE_STEPS_TOLERANCE 1e-6

typedef struct Instance Instance;
typedef void LogFunction(const Instance *instance, Status status, const char *category,
                         const char *message);

/* All that a saved FMU state holds; plain data without padding. */
typedef struct {
    Motor motor;
    double stop_time;
    int32_t life_cycle;
    int32_t model_exchange;
} Snapshot;

struct Instance {
    Snapshot now;
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
static void instance_reset(Instance *instance);

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

/* Switch messages on or off. The model description has one log category: naming it is naming all. */
static Status instance_set_logging(Instance *instance, const char *function, bool on, size_t count,
                                   const char *const categories[]);

static Status instance_set_experiment(Instance *instance, const char *function, double start_time,
                                      bool stop_time_defined, double stop_time);
static void instance_exit_initialization(Instance *instance);
static Status instance_do_step(Instance *instance, const char *function, double time,
                               double step_size);

static Status instance_set_time(Instance *instance, const char *function, double time);
static Status instance_set_states(Instance *instance, const char *function, const double states[],
                                  size_t count);
static Status instance_get_states(const Instance *instance, const char *function, double states[],
                                  size_t count);
static Status instance_get_derivatives(const Instance *instance, const char *function,
                                       double derivatives[], size_t count);
static Status instance_get_nominals(const Instance *instance, const char *function,
                                    double nominals[], size_t count);
static Status instance_get_indicators(const Instance *instance, const char *function,
                                      double indicators[], size_t count);

static Status instance_get_double(const Instance *instance, const char *function,
                                  const uint32_t references[], size_t count, double values[]);
static Status instance_set_double(Instance *instance, const char *function,
                                  const uint32_t references[], size_t count, const double values[]);

/* Variables that are not floating-point: the type is "Boolean" or "Enumeration". */
static Status instance_get_option(const Instance *instance, const char *function,
                                  uint32_t reference, const char *type, int64_t *value);
static Status instance_set_option(Instance *instance, const char *function, uint32_t reference,
                                  const char *type, int64_t value);

/* Sensitivity of each unknown to a change `seed` of the knowns, or, adjoint, of each known. */
static Status instance_directional(const Instance *instance, const char *function,
                                   const uint32_t unknowns[], size_t unknown_count,
                                   const uint32_t knowns[], size_t known_count, const double seed[],
                                   double sensitivity[]);
static inline Status instance_adjoint(const Instance *instance, const char *function,
                                      const uint32_t unknowns[], size_t unknown_count,
                                      const uint32_t knowns[], size_t known_count,
                                      const double seed[], double sensitivity[]);
/* Time derivatives of outputs with the inputs held; only the first. */
static Status instance_output_derivatives(const Instance *instance, const char *function,
                                          const uint32_t references[], size_t count,
                                          const int32_t orders[], double values[]);

static Status instance_save(const Instance *instance, const char *function, void **state);
static Status instance_restore(Instance *instance, const char *function, const void *state);
static size_t instance_serialized_size(void);
static Status instance_serialize(const Instance *instance, const char *function, const void *state,
                                 unsigned char bytes[], size_t size);
static Status instance_deserialize(const Instance *instance, const char *function,
                                   const unsigned char bytes[], size_t size, void **state);

#endif

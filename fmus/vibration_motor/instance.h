/* One instance of the FMU, whichever FMI standard it was made through: life cycle, messages, access
 * to variables by value reference, stepping. The shims fmi2.c and fmi3.c only translate calls.
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
    STEP = 4,
    TERMINATED = 8,
    READABLE = INITIALIZATION | STEP | TERMINATED,
    WRITABLE = INSTANTIATED | INITIALIZATION | STEP,
    ANY_STATE = 15
} LifeCycle;

typedef struct Instance Instance;
typedef void LogFunction(const Instance *instance, Status status, const char *category,
                         const char *message);

/* All that a saved FMU state holds; plain data. */
typedef struct {
    Motor motor;
    double stop_time;
    int32_t life_cycle;
} Snapshot;

struct Instance {
    Snapshot now;
    char *name;
    LogFunction *log;
    void (*callback)(void); /* the importer's logger, cast back by the shim's LogFunction */
    void *environment;
};

Instance *instance_new(const char *name, const char *token, LogFunction *log,
                       void (*callback)(void), void *environment);
void instance_free(Instance *instance);
void instance_reset(Instance *instance);

/* Log an error as "function: message" and return STATUS_ERROR. */
Status fail(const Instance *instance, const char *function, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

Status fail_state(const Instance *instance, const char *function);

/* Refuse a call on no instance or in the wrong state; for the first line of a shim's function. */
#define REQUIRE(instance, states)                              \
    do {                                                       \
        if (!(instance))                                       \
            return (int)STATUS_ERROR;                          \
        if (!((instance)->now.life_cycle & (states)))          \
            return (int)fail_state((instance), __func__);      \
    } while (0)

/* Accept the log categories of the model description, of which there is one. */
Status instance_check_categories(const Instance *instance, const char *function, size_t count,
                                 const char *const categories[]);

Status instance_enter_initialization(Instance *instance, const char *function, double start_time,
                                     bool stop_time_defined, double stop_time);

Status instance_get_double(const Instance *instance, const char *function, const uint32_t reference[],
                           size_t count, double value[]);
Status instance_set_double(Instance *instance, const char *function, const uint32_t reference[],
                           size_t count, const double value[]);
/* Boolean and enumeration variables. */
Status instance_get_option(const Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t *value);
Status instance_set_option(Instance *instance, const char *function, uint32_t reference,
                           const char *type, int64_t value);

Status instance_do_step(Instance *instance, const char *function, double time, double step_size);

#endif

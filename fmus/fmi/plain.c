/* See instance.h and plain.h. The model has defined `options`, an array of Option, before. */
#include "plain.h"

#include <stdlib.h>
#include <string.h>

enum { OPTION_COUNT = sizeof options / sizeof *options };

static const size_t model_size = sizeof(PlainInstance);

void model_release(Instance *instance) { (void)instance; }

static inline bool read_double(const Instance *instance, uint32_t reference, double *value) {
    if (plain_read(instance, reference, value))
        return true;
    if (reference == VR_time)
        *value = instance->now.time;
    else if (reference - INPUT_FIRST < INPUT_COUNT)
        *value = plain_in(instance)->in.value[reference - INPUT_FIRST];
    else if (reference - PARAMETER_FIRST < PARAMETER_COUNT)
        *value = plain_in(instance)->p.value[reference - PARAMETER_FIRST];
    else
        return false;
    return true;
}

/* Whether the arrays of a call go together; says why not. */
static inline Status check_arrays(const Instance *instance, const char *function,
                                  const uint32_t references[], size_t count, const double values[],
                                  size_t value_count) {
    if (count != value_count)
        return fail(instance, function, "%lu value references but %lu values",
                    (unsigned long)count, (unsigned long)value_count);
    return count && (!references || !values) ? fail_arrays(instance, function) : STATUS_OK;
}

Status model_get_double(const Instance *instance, const char *function, const uint32_t references[],
                        size_t count, double values[], size_t value_count) {
    if (check_arrays(instance, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++)
        if (!read_double(instance, references[k], &values[k]))
            return fail_reference(instance, function, references[k], "floating-point variable");
    return STATUS_OK;
}

Status model_set_double(Instance *instance, const char *function, const uint32_t references[],
                        size_t count, const double values[], size_t value_count) {
    if (check_arrays(instance, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    Plain *plain = plain_of(instance);
    bool only_inputs = true;
    for (size_t k = 0; k < count; k++) {
        if (references[k] - INPUT_FIRST < INPUT_COUNT && isfinite(values[k]))
            continue;
        if (check_double(instance, function, references[k], values[k]) != STATUS_OK)
            return STATUS_ERROR;
        only_inputs = false;
    }
    for (size_t k = 0; k < count; k++) {
        if (references[k] - INPUT_FIRST < INPUT_COUNT)
            plain->in.value[references[k] - INPUT_FIRST] = values[k];
        else
            plain->p.value[references[k] - PARAMETER_FIRST] = values[k];
    }
    plain_changed(instance, only_inputs);
    return STATUS_OK;
}

static const Option *find_option(uint32_t reference, const char *type) {
    for (const Option *option = options; option < options + OPTION_COUNT; option++)
        if (option->reference == reference && strcmp(option->type, type) == 0)
            return option;
    return NULL;
}

static int32_t option_value(const Plain *plain, const Option *option) {
    return *(const int32_t *)((const char *)plain + option->place);
}

Status model_get_option(const Instance *instance, const char *function, uint32_t reference,
                        const char *type, int64_t *value) {
    const Option *option = find_option(reference, type);
    if (!option)
        return fail_reference(instance, function, reference, type);
    *value = option_value(plain_in(instance), option);
    return STATUS_OK;
}

Status model_check_option(const Instance *instance, const char *function, uint32_t reference,
                          const char *type, int64_t value) {
    const Option *option = find_option(reference, type);
    if (!option)
        return fail_reference(instance, function, reference, type);
    if (!(instance->now.life_cycle & STARTING))
        return fail_fixed(instance, function, reference);
    if (value < option->least || value > option->most)
        return fail(instance, function, "%s cannot be %lld; use %d to %d", variable_name[reference],
                    (long long)value, (int)option->least, (int)option->most);
    return STATUS_OK;
}

void model_set_option(Instance *instance, uint32_t reference, const char *type, int64_t value) {
    const Option *option = find_option(reference, type);
    *(int32_t *)((char *)plain_of(instance) + option->place) = (int32_t)value;
}

typedef struct {
    Plain plain;
    Standing now;
} Snapshot;

/* Equal states are equal bytes, so that importers can compare them. */
_Static_assert(sizeof(Snapshot) == sizeof(Plain) + 3 * sizeof(double) + 2 * sizeof(int32_t),
               "no padding");

Status model_save(const Instance *instance, const char *function, void **state) {
    if (!*state)
        *state = malloc(sizeof(Snapshot));
    if (!*state)
        return fail(instance, function, "out of memory");
    const Snapshot snapshot = {*plain_in(instance), instance->now};
    memcpy(*state, &snapshot, sizeof snapshot);
    return STATUS_OK;
}

Status model_restore(Instance *instance, const char *function, const void *state) {
    Snapshot snapshot;
    memcpy(&snapshot, state, sizeof snapshot);
    if (snapshot.now.model_exchange != instance->now.model_exchange)
        return fail(instance, function, "the state is of a %s instance",
                    snapshot.now.model_exchange ? "Model Exchange" : "co-simulation");
    *plain_of(instance) = snapshot.plain;
    instance->now = snapshot.now;
    return STATUS_OK;
}

size_t model_state_size(const void *state) {
    (void)state;
    return sizeof(Snapshot);
}

/* Bytes from outside must not bring about a state that no sequence of calls could. */
static bool is_sound(const Snapshot *snapshot) {
    const Plain *plain = &snapshot->plain;
    const Standing *now = &snapshot->now;
    const int32_t life = now->life_cycle;
    const int32_t running = now->model_exchange ? EVENT | CONTINUOUS_TIME : STEP;
    bool sound = within(plain->in.value, INPUT_COUNT, NULL, NULL) &&
                 within(plain->p.value, PARAMETER_COUNT, parameter_min, parameter_max) &&
                 isfinite(now->time) && now->stop_time > -INFINITY &&
                 fabs(now->owed) <= WHOLE_STEPS_TOLERANCE * plain->p.step_size &&
                 (now->model_exchange == 0 || now->model_exchange == model_exchanges) && life > 0 &&
                 !(life & (life - 1)) && (life & (STARTING | TERMINATED | running));
    for (const Option *option = options; option < options + OPTION_COUNT; option++) {
        const int32_t value = option_value(plain, option);
        sound &= value >= option->least && value <= option->most;
    }
    return sound && plain_is_sound(plain, now);
}

Status model_deserialize(const Instance *instance, const char *function,
                         const unsigned char bytes[], size_t size, void **state) {
    Snapshot snapshot;
    if (size != sealed_size(sizeof snapshot))
        return fail(instance, function, "%lu bytes, but a state has %lu", (unsigned long)size,
                    (unsigned long)sealed_size(sizeof snapshot));
    const unsigned char *content = unseal(instance, function, bytes, size);
    if (!content)
        return STATUS_ERROR;
    memcpy(&snapshot, content, sizeof snapshot);
    if (!is_sound(&snapshot))
        return fail(instance, function, "the state holds values that are out of range");
    plain_derive(&snapshot.plain);
    if (!*state)
        *state = malloc(sizeof(Snapshot));
    if (!*state)
        return fail(instance, function, "out of memory");
    memcpy(*state, &snapshot, sizeof(Snapshot));
    return STATUS_OK;
}

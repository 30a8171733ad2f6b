/* See instance.h: saved and serialised FMU states. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

/* Equal states are equal bytes, so that importers can compare them. */
_Static_assert(sizeof(Snapshot) == sizeof(double) * (INPUT_COUNT + PARAMETER_COUNT + 11) +
                                       8 * sizeof(int32_t),
               "no padding");

/* A serialised state: the token of the build, so that no other build reads it, the snapshot, and a
 * checksum of all before it. */
typedef struct {
    char token[sizeof INSTANTIATION_TOKEN];
    Snapshot snapshot;
    uint64_t checksum;
} Serialized;

/* FNV-1a: differs for any damage within one byte, and for all other but one in 2^64. */
static uint64_t checksum(const Serialized *serialized) {
    const unsigned char *bytes = (const unsigned char *)serialized;
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    for (size_t k = 0; k < offsetof(Serialized, checksum); k++)
        hash = (hash ^ bytes[k]) * UINT64_C(0x100000001b3);
    return hash;
}

Status instance_save(const Instance *instance, const char *function, void **state) {
    if (!*state)
        *state = malloc(sizeof(Snapshot));
    if (!*state)
        return fail(instance, function, "out of memory");
    memcpy(*state, &instance->now, sizeof(Snapshot));
    return STATUS_OK;
}

Status instance_restore(Instance *instance, const char *function, const void *state) {
    Snapshot snapshot;
    memcpy(&snapshot, state, sizeof snapshot);
    if (snapshot.model_exchange != instance->now.model_exchange)
        return fail(instance, function, "the state is of a %s instance",
                    snapshot.model_exchange ? "Model Exchange" : "co-simulation");
    instance->now = snapshot;
    return STATUS_OK;
}

size_t instance_serialized_size(void) { return sizeof(Serialized); }

Status instance_serialize(const Instance *instance, const char *function, const void *state,
                          unsigned char bytes[], size_t size) {
    if (size != sizeof(Serialized))
        return fail(instance, function, "room for %lu bytes, but a state has %lu",
                    (unsigned long)size, (unsigned long)sizeof(Serialized));
    Serialized serialized;
    memset(&serialized, 0, sizeof serialized);
    memcpy(serialized.token, INSTANTIATION_TOKEN, sizeof serialized.token);
    memcpy(&serialized.snapshot, state, sizeof serialized.snapshot);
    serialized.checksum = checksum(&serialized);
    memcpy(bytes, &serialized, sizeof serialized);
    return STATUS_OK;
}

static bool within(const double values[], size_t count, const double least[], const double most[]) {
    for (size_t k = 0; k < count; k++)
        if (!isfinite(values[k]) || (least && values[k] < least[k]) || (most && values[k] > most[k]))
            return false;
    return true;
}

/* Bytes from outside must not bring about a state that no sequence of calls could. */
static bool is_sound(const Snapshot *snapshot) {
    const Motor *s = &snapshot->motor;
    const double state[] = {s->theta, s->omega, s->integral, s->time};
    const int32_t life = snapshot->life_cycle;
    const int32_t running = snapshot->model_exchange ? EVENT | CONTINUOUS_TIME : STEP;
    const bool holds_modes = snapshot->model_exchange && !(life & STARTING);
    const int32_t most = holds_modes; /* of the signs that modes are */
    return within(s->input, INPUT_COUNT, NULL, NULL) &&
           within(s->parameter, PARAMETER_COUNT, parameter_min, parameter_max) &&
           within(state, sizeof state / sizeof *state, NULL, NULL) &&
           fabs(s->owed) <= WHOLE_STEPS_TOLERANCE * s->step_size &&
           snapshot->stop_time > -INFINITY && (s->closed_loop == 0 || s->closed_loop == 1) &&
           (s->solver == SOLVER_SEMI_IMPLICIT_EULER || s->solver == SOLVER_RK4) &&
           s->modes_held == holds_modes && s->friction >= -most && s->friction <= most &&
           s->saturation >= -most && s->saturation <= most &&
           (s->jumped == 0 || s->jumped == most) &&
           (snapshot->model_exchange == 0 || snapshot->model_exchange == 1) && life > 0 &&
           !(life & (life - 1)) && (life & (STARTING | TERMINATED | running));
}

Status instance_deserialize(const Instance *instance, const char *function,
                            const unsigned char bytes[], size_t size, void **state) {
    Serialized serialized;
    if (size != sizeof serialized)
        return fail(instance, function, "%lu bytes, but a state has %lu", (unsigned long)size,
                    (unsigned long)sizeof serialized);
    memcpy(&serialized, bytes, sizeof serialized);
    if (serialized.checksum != checksum(&serialized))
        return fail(instance, function, "the bytes are a damaged state, or none");
    if (memcmp(serialized.token, INSTANTIATION_TOKEN, sizeof serialized.token) != 0)
        return fail(instance, function, "the state is of another build of the FMU");
    if (!is_sound(&serialized.snapshot))
        return fail(instance, function, "the state holds values that are out of range");
    motor_derive(&serialized.snapshot.motor);
    if (!*state)
        *state = malloc(sizeof(Snapshot));
    if (!*state)
        return fail(instance, function, "out of memory");
    memcpy(*state, &serialized.snapshot, sizeof(Snapshot));
    return STATUS_OK;
}

/* See instance.h: saved and serialised states of one motor. */
#include <stdlib.h>
#include <string.h>

#include "motor_instance.h"

typedef struct {
    Motor motor;
    Standing now;
} Snapshot;

/* Equal states are equal bytes, so that importers can compare them. */
_Static_assert(sizeof(Snapshot) ==
                   sizeof(double) * (INPUT_COUNT + PARAMETER_COUNT + 11) + 8 * sizeof(int32_t),
               "no padding");

Status model_save(const Instance *instance, const char *function, void **state) {
    if (!*state)
        *state = malloc(sizeof(Snapshot));
    if (!*state)
        return fail(instance, function, "out of memory");
    const Snapshot snapshot = {*motor_in(instance), instance->now};
    memcpy(*state, &snapshot, sizeof snapshot);
    return STATUS_OK;
}

Status model_restore(Instance *instance, const char *function, const void *state) {
    Snapshot snapshot;
    memcpy(&snapshot, state, sizeof snapshot);
    if (snapshot.now.model_exchange != instance->now.model_exchange)
        return fail(instance, function, "the state is of a %s instance",
                    snapshot.now.model_exchange ? "Model Exchange" : "co-simulation");
    *motor_of(instance) = snapshot.motor;
    instance->now = snapshot.now;
    return STATUS_OK;
}

size_t model_state_size(const void *state) {
    (void)state;
    return sizeof(Snapshot);
}

/* Bytes from outside must not bring about a state that no sequence of calls could. */
static bool is_sound(const Snapshot *snapshot) {
    const Motor *s = &snapshot->motor;
    const Standing *now = &snapshot->now;
    const double values[] = {s->x.theta, s->x.omega, s->x.integral, now->time};
    const int32_t life = now->life_cycle;
    const int32_t running = now->model_exchange ? EVENT | CONTINUOUS_TIME : STEP;
    const bool holds_modes = now->model_exchange && !(life & STARTING);
    const int32_t most = holds_modes; /* of the signs that modes are */
    return within(s->in.value, INPUT_COUNT, NULL, NULL) &&
           within(s->p.value, PARAMETER_COUNT, parameter_min, parameter_max) &&
           within(values, sizeof values / sizeof *values, NULL, NULL) &&
           fabs(now->owed) <= WHOLE_STEPS_TOLERANCE * s->p.step_size &&
           now->stop_time > -INFINITY && (s->p.closed_loop == 0 || s->p.closed_loop == 1) &&
           (s->p.solver == SOLVER_SEMI_IMPLICIT_EULER || s->p.solver == SOLVER_RK4) &&
           s->modes_held == holds_modes && s->friction >= -most && s->friction <= most &&
           s->saturation >= -most && s->saturation <= most &&
           (s->jumped == 0 || s->jumped == most) &&
           (now->model_exchange == 0 || now->model_exchange == 1) && life > 0 &&
           !(life & (life - 1)) && (life & (STARTING | TERMINATED | running));
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
    single_derive(&snapshot.motor);
    if (!*state)
        *state = malloc(sizeof(Snapshot));
    if (!*state)
        return fail(instance, function, "out of memory");
    memcpy(*state, &snapshot, sizeof(Snapshot));
    return STATUS_OK;
}

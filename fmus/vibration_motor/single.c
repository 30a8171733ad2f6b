/* See instance.h and single.h: life cycle, variables, steps and saved states of one motor. A copy
 * of a `Motor` is all that it is. */
#include "instance.h"
#include "single.h"
#include "stability.h"

typedef struct {
    Instance base;
    Motor motor;
} MotorInstance;

static const size_t model_size = sizeof(MotorInstance);

static inline Motor *motor_of(Instance *instance) { return &((MotorInstance *)instance)->motor; }

static inline const Motor *motor_in(const Instance *instance) {
    return &((const MotorInstance *)instance)->motor;
}

Status model_reset(Instance *instance, const char *function) {
    (void)function;
    Motor *motor = motor_of(instance);
    memset(motor, 0, sizeof *motor);
    memcpy(motor->in.value, input_start, sizeof motor->in.value);
    memcpy(motor->p.value, parameter_start, sizeof motor->p.value);
    motor->p.closed_loop = START_closed_loop;
    motor->p.solver = START_solver;
    single_initialise(motor);
    return STATUS_OK;
}

void model_release(Instance *instance) { (void)instance; }

Status model_do_step(Instance *instance, const char *function, double time, double step_size) {
    Motor *motor = motor_of(instance);
    const double h = motor->p.step_size;
    Plan plan;
    if (plan_step(instance, function, time, step_size, h, &plan) != STATUS_OK)
        return STATUS_ERROR;
    const MotorState before = motor->x;
    for (int64_t k = 0; k < plan.steps; k++)
        single_step(motor, h);
    if (plan.rest > 0.0)
        single_step(motor, plan.rest);
    if (!motor_is_bounded(motor->x)) {
        single_set_state(motor, before);
        return fail_growth(instance, function, "", time, h);
    }
    instance->now.time = time + step_size;
    instance->now.owed = plan.owed;
    return STATUS_OK;
}

static inline bool read_double(const Instance *instance, uint32_t reference, double *value) {
    const Motor *s = motor_in(instance);
    switch (reference) {
    case VR_time:
        *value = instance->now.time;
        return true;
    case VR_theta:
        *value = s->x.theta;
        return true;
    case VR_omega:
        *value = s->x.omega;
        return true;
    case VR_omega_dot:
        *value = single_omega_dot(s);
        return true;
    case VR_V_s:
        *value = single_voltage(s);
        return true;
    case VR_i:
        *value = motor_current(&s->p, s->x.omega, single_voltage(s));
        return true;
    case VR_integral:
        *value = s->x.integral;
        return true;
    case VR_u:
        *value = single_command(s);
        return true;
    default:
        break;
    }
    if (reference - INPUT_FIRST < INPUT_COUNT)
        *value = s->in.value[reference - INPUT_FIRST];
    else if (reference - PARAMETER_FIRST < PARAMETER_COUNT)
        *value = s->p.value[reference - PARAMETER_FIRST];
    else
        return false;
    return true;
}

/* Whether the arrays of a call go together; says why not. */
static inline Status check_arrays(const Instance *instance, const char *function,
                                  const uint32_t references[], size_t count, const double values[],
                                  size_t value_count) {
    if (count != value_count)
        return fail(instance, function, "%lu value references but %lu values", (unsigned long)count,
                    (unsigned long)value_count);
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
    Motor *motor = motor_of(instance);
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
            motor->in.value[references[k] - INPUT_FIRST] = values[k];
        else
            motor->p.value[references[k] - PARAMETER_FIRST] = values[k];
    }
    if (!only_inputs) {
        single_initialise(motor);
        instance->changed = true;
    }
    return STATUS_OK;
}

Status model_is_stable(const Instance *instance, const char *function) {
    const MotorConstants *p = &motor_in(instance)->p;
    return check_motor(instance, function, "", p, p->step_size);
}

Option model_option(Instance *instance, uint32_t reference, const char *type) {
    Motor *motor = motor_of(instance);
    if (reference == VR_closed_loop && strcmp(type, "Boolean") == 0)
        return (Option){&motor->p.closed_loop, 0, 1};
    if (reference == VR_solver && strcmp(type, "Enumeration") == 0)
        return (Option){&motor->p.solver, SOLVER_SEMI_IMPLICIT_EULER, SOLVER_RK4};
    return (Option){NULL, 0, 0};
}

void model_options_changed(Instance *instance) { instance->changed = true; }

typedef struct {
    Motor motor;
    Standing now;
} Snapshot;

/* Equal states are equal bytes, so that importers can compare them. */
_Static_assert(sizeof(Snapshot) == sizeof(double) * (INPUT_COUNT + PARAMETER_COUNT + 11) +
                                       2 * sizeof(int32_t) + sizeof(int64_t),
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
    (void)function;
    Snapshot snapshot;
    memcpy(&snapshot, state, sizeof snapshot);
    *motor_of(instance) = snapshot.motor;
    instance->now = snapshot.now;
    instance->changed = true;
    return STATUS_OK;
}

size_t model_state_size(const void *state) {
    (void)state;
    return sizeof(Snapshot);
}

/* Bytes from outside must not bring about a state that no sequence of calls could. */
static bool is_sound(const Motor *s, const Standing *now) {
    const double state[] = {s->x.theta, s->x.omega, s->x.integral};
    return within(state, sizeof state / sizeof *state, NULL, NULL) &&
           within(s->in.value, INPUT_COUNT, NULL, NULL) &&
           within(s->p.value, PARAMETER_COUNT, parameter_min, parameter_max) &&
           (s->p.closed_loop == 0 || s->p.closed_loop == 1) &&
           (s->p.solver == SOLVER_SEMI_IMPLICIT_EULER || s->p.solver == SOLVER_RK4) &&
           is_standing(now, s->p.step_size) && now->life_cycle != CONFIGURATION;
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
    if (!is_sound(&snapshot.motor, &snapshot.now))
        return fail(instance, function, "the state holds values that are out of range");
    single_derive(&snapshot.motor);
    if (!*state)
        *state = malloc(sizeof(Snapshot));
    if (!*state)
        return fail(instance, function, "out of memory");
    memcpy(*state, &snapshot, sizeof(Snapshot));
    return STATUS_OK;
}

/* See plain.h and motor_instance.h: life cycle, variables and steps of one motor, and its Model
 * Exchange. */
#include "motor_instance.h"

#include <string.h>

#include "events.h"
#include "integrate.h"

static const bool model_exchanges = true;

static const Option options[] = {
    {VR_closed_loop, "Boolean", offsetof(Motor, p.closed_loop), 0, 1},
    {VR_solver, "Enumeration", offsetof(Motor, p.solver), SOLVER_SEMI_IMPLICIT_EULER, SOLVER_RK4},
};

_Static_assert(sizeof(Motor) == sizeof(double) * (INPUT_COUNT + PARAMETER_COUNT + 8) +
                                    6 * sizeof(int32_t), "no padding");

Status model_reset(Instance *instance, const char *function) {
    (void)function;
    Motor *motor = plain_of(instance);
    memset(motor, 0, sizeof *motor);
    memcpy(motor->in.value, input_start, sizeof motor->in.value);
    memcpy(motor->p.value, parameter_start, sizeof motor->p.value);
    motor->p.closed_loop = START_closed_loop;
    motor->p.solver = START_solver;
    single_initialise(motor);
    return STATUS_OK;
}

inline bool plain_read(const Instance *instance, uint32_t reference, double *value) {
    const Motor *s = plain_in(instance);
    switch (reference) {
    case VR_theta: *value = s->x.theta; return true;
    case VR_omega: *value = s->x.omega; return true;
    case VR_omega_dot: *value = single_omega_dot(s); return true;
    case VR_V_s: *value = single_voltage(s); return true;
    case VR_i: *value = single_current(s); return true;
    case VR_integral: *value = s->x.integral; return true;
    case VR_u: *value = single_command(s); return true;
    case VR_der_theta: *value = s->x.omega; return true;
    case VR_der_integral: *value = single_integral_dot(s); return true;
    case VR_z_friction: *value = indicator_friction(s); return true;
    case VR_z_upper: *value = indicator_saturation(s, 1); return true;
    case VR_z_lower: *value = indicator_saturation(s, -1); return true;
    default: return false;
    }
}

inline void plain_changed(Instance *instance, bool only_inputs) {
    Motor *motor = plain_of(instance);
    if (instance->now.life_cycle == EVENT)
        motor->jumped = 1;
    if (!only_inputs)
        single_initialise(motor);
}

inline void plain_derive(Plain *motor) { single_derive(motor); }

bool plain_is_sound(const Plain *s, const Standing *now) {
    const double values[] = {s->x.theta, s->x.omega, s->x.integral};
    const bool holds_modes = now->model_exchange && !(now->life_cycle & STARTING);
    const int32_t most = holds_modes; /* of the signs that modes are */
    return within(values, sizeof values / sizeof *values, NULL, NULL) &&
           s->modes_held == holds_modes && s->friction >= -most && s->friction <= most &&
           s->saturation >= -most && s->saturation <= most && (s->jumped == 0 || s->jumped == most);
}

void model_exit_initialization(Instance *instance) {
    instance->now.life_cycle = instance->now.model_exchange ? EVENT : STEP;
    if (instance->now.model_exchange)
        events_initialise(plain_of(instance));
}

Status model_do_step(Instance *instance, const char *function, double time, double step_size) {
    Motor *motor = plain_of(instance);
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

Status instance_set_time(Instance *instance, const char *function, double time) {
    if (!isfinite(time))
        return fail(instance, function, "the time is %g; give a finite number", time);
    instance->now.time = time;
    return STATUS_OK;
}

static Status check_count(const Instance *instance, const char *function, const void *values,
                          size_t count, size_t wanted, const char *what) {
    if (count != wanted)
        return fail(instance, function, "room for %lu %s, but there are %lu", (unsigned long)count,
                    what, (unsigned long)wanted);
    if (!values)
        return fail(instance, function, "the array of %s is null", what);
    return STATUS_OK;
}

Status instance_set_states(Instance *instance, const char *function, const double states[],
                           size_t count) {
    if (check_count(instance, function, states, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++)
        if (!isfinite(states[k]))
            return fail(instance, function, "state %lu is %g; give finite numbers",
                        (unsigned long)k, states[k]);
    single_set_state(plain_of(instance), (MotorState){states[0], states[1], states[2]});
    return STATUS_OK;
}

Status instance_get_states(const Instance *instance, const char *function, double states[],
                           size_t count) {
    if (check_count(instance, function, states, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    const Motor *motor = plain_in(instance);
    states[0] = motor->x.theta;
    states[1] = motor->x.omega;
    states[2] = motor->x.integral;
    return STATUS_OK;
}

Status instance_get_derivatives(const Instance *instance, const char *function,
                                double derivatives[], size_t count) {
    if (check_count(instance, function, derivatives, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    const Motor *motor = plain_in(instance);
    derivatives[0] = motor->x.omega;
    derivatives[1] = single_omega_dot(motor);
    derivatives[2] = single_integral_dot(motor);
    return STATUS_OK;
}

Status instance_get_nominals(const Instance *instance, const char *function, double nominals[],
                             size_t count) {
    if (check_count(instance, function, nominals, count, STATE_COUNT, "states") != STATUS_OK)
        return STATUS_ERROR;
    nominals[0] = NOMINAL_theta;
    nominals[1] = NOMINAL_omega;
    nominals[2] = NOMINAL_integral;
    return STATUS_OK;
}

Status instance_get_indicators(const Instance *instance, const char *function, double indicators[],
                               size_t count) {
    if (check_count(instance, function, indicators, count, INDICATOR_COUNT, "event indicators") !=
        STATUS_OK)
        return STATUS_ERROR;
    const Motor *motor = plain_in(instance);
    indicators[0] = indicator_friction(motor);
    indicators[1] = indicator_saturation(motor, 1);
    indicators[2] = indicator_saturation(motor, -1);
    return STATUS_OK;
}

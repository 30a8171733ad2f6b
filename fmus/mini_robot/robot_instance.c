/* See plain.h: life cycle, variables and steps of one robot. */
#include "robot.h"

#include <string.h>

typedef Robot Plain;

#include "plain.h"

static const bool model_exchanges = false;

static const Option options[] = {
    {VR_extrapolate, "Boolean", offsetof(Robot, extrapolate), 0, 1},
};

enum { BODY_VALUES = sizeof(Body) / sizeof(double) };

_Static_assert(sizeof(Robot) == sizeof(RobotInputs) + sizeof(RobotConstants) + sizeof(Body) +
                                    8 * sizeof(double) + 2 * sizeof(int32_t), "no padding");

Status model_reset(Instance *instance, const char *function) {
    (void)function;
    Robot *robot = plain_of(instance);
    memset(robot, 0, sizeof *robot);
    memcpy(robot->in.value, input_start, sizeof robot->in.value);
    memcpy(robot->p.value, parameter_start, sizeof robot->p.value);
    robot->extrapolate = START_extrapolate;
    robot_initialise(robot);
    return STATUS_OK;
}

/* Forces on a foot are its impulses of the last internal step over that step. */
static double foot_force(const Robot *robot, uint32_t place) {
    const Impulse *at = &robot->x.at[place / 4];
    const double impulse[] = {at->normal, at->friction.x, at->friction.y, at->friction.z};
    return impulse[place % 4] / robot->p.step_size;
}

inline bool plain_read(const Instance *instance, uint32_t reference, double *value) {
    const Robot *robot = plain_in(instance);
    const Body *x = &robot->x;
    switch (reference) {
    case VR_x: *value = x->position.x; return true;
    case VR_y: *value = x->position.y; return true;
    case VR_z: *value = x->position.z; return true;
    case VR_q_w: *value = x->orientation.w; return true;
    case VR_q_x: *value = x->orientation.x; return true;
    case VR_q_y: *value = x->orientation.y; return true;
    case VR_q_z: *value = x->orientation.z; return true;
    case VR_v_x: *value = x->velocity.x; return true;
    case VR_v_y: *value = x->velocity.y; return true;
    case VR_v_z: *value = x->velocity.z; return true;
    case VR_omega_x: *value = x->omega.x; return true;
    case VR_omega_y: *value = x->omega.y; return true;
    case VR_omega_z: *value = x->omega.z; return true;
    case VR_d_D: *value = robot->reaction[0]; return true;
    case VR_d_E: *value = robot->reaction[1]; return true;
    default: break;
    }
    if (reference - VR_N_A > VR_T_C_z - VR_N_A)
        return false;
    *value = foot_force(robot, reference - VR_N_A);
    return true;
}

inline void plain_changed(Instance *instance, bool only_inputs) {
    if (!only_inputs)
        robot_initialise(plain_of(instance));
}

inline void plain_derive(Plain *robot) { robot_derive(robot); }

static bool is_bounded(const Body *body) {
    double values[BODY_VALUES];
    memcpy(values, body, sizeof values);
    return within(values, BODY_VALUES, NULL, NULL);
}

bool plain_is_sound(const Plain *robot, const Standing *now) {
    (void)now;
    double others[8];
    memcpy(others, robot->before, sizeof robot->before);
    memcpy(others + 6, robot->reaction, sizeof robot->reaction);
    return is_bounded(&robot->x) && within(others, 8, NULL, NULL) && robot->padding == 0;
}

void model_exit_initialization(Instance *instance) {
    Robot *robot = plain_of(instance);
    memcpy(robot->before, robot->in.motor, sizeof robot->before);
    instance->now.life_cycle = STEP;
}

Status model_do_step(Instance *instance, const char *function, double time, double step_size) {
    Robot *robot = plain_of(instance);
    const double h = robot->p.step_size;
    Plan plan;
    if (plan_step(instance, function, time, step_size, h, &plan) != STATUS_OK)
        return STATUS_ERROR;
    if (plan.rest != 0.0 || plan.steps == 0)
        return fail(instance, function,
                    "the communication step is %.17g s; give a multiple of step_size %g s",
                    step_size, h);
    const Robot before = *robot;
    robot_step(robot, plan.steps);
    if (!is_bounded(&robot->x)) {
        *robot = before;
        return fail_growth(instance, function, "", time, h);
    }
    instance->now.time = time + step_size;
    return STATUS_OK;
}

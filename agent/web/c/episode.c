/* One episode of any number of robots, as cosim/simulation and cosim/coupling have it: motors and
 * bodies of the FMUs, the firmware, and what robots do to each other and to obstacles.
 *
 * A page or a test writes `episode_setup` and the tables, begins an episode by its seed, advances it by
 * control periods and reads `episode_view`. */
#include <stdlib.h>
#include <string.h>

#include "body.h"
#include "camera.h"
#include "layout.h"
#include "motor.h"
#include "noise.h"
#include "onboard.h"

#define EXPORT __attribute__((visibility("default")))
#define PI 0x1.921fb54442d18p+1
#define NEAR_M 2e-3 /* of contact: what is nearer is looked at in every tick */

enum { MOTORS = 2, DRAWS = 20000 };
enum { RUNNING, TIMEOUT, SUCCESS, COLLISION, OUT_OF_BOARD, NO_STARTS = -1 };

/* Children of a seed: of an episode's starts and noise. */
enum { START_CHILD, NOISE_CHILD };
/* Of the noise's child, whose first ones the motors have. */
enum { WORLD_CHILD = 1000000, CAMERA_CHILD = 2000000, DETOUR_CHILD = 3000000 };

Setup setup;
Tables table;

static View view;

typedef struct {
    MotorConstants constants;
    MotorInputs in;
    MotorState x;
    MotorDrive drive;
    Random noise;
    double noise_value;
} Shaken;

static BodyConstants constants_of[MOST_ROBOTS];
static Mount mounts[MOST_ROBOTS][MOTORS];
static Watched watched[MOST_ROBOTS];
static Body bodies[MOST_ROBOTS];
static Shaken motors[MOST_ROBOTS][MOTORS];
static Known known;
static double last_points[MOST_ROBOTS][2]; /* of the paths */
static bool touched[MOST_ROBOTS];
static double touching[MOST_ROBOTS]; /* ticks of the period */
static double pressed[MOST_ROBOTS][FOOT_COUNT]; /* sum of the normal impulses of the period */
static int pairs[MOST_ROBOTS * MOST_ROBOTS][2], pair_count;
static int64_t tick, period_of_step, periods_since_point;
static int outcome;

EXPORT Setup *episode_setup(void) { return &setup; }

EXPORT View *episode_view(void) { return &view; }

/* Room for a table, by its place in `Tables`; null if there is none. */
EXPORT void *episode_table(int which, size_t size) {
    void **place = (void **)&table + which;
    free(*place);
    return *place = size ? malloc(size) : NULL;
}

static double between(double x, double low, double high) {
    const double raised = x > low ? x : low;
    return raised < high ? raised : high;
}

static int robot_count(void) { return (int)setup.robots; }

static double from_angle(Quaternion q) {
    return onboard_angle(2.0 * (q.x * q.y + q.w * q.z), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
}

void turn_of(double angle, double turned[2]) {
    const Trig trig = sine_cosine(angle);
    turned[0] = trig.cosine;
    turned[1] = trig.sine;
}

static void look(int i) {
    known.positions[i][0] = bodies[i].position.x;
    known.positions[i][1] = bodies[i].position.y;
    known.headings[i] = from_angle(bodies[i].orientation);
    known.variances[i] = 0.0;
}

/* Look at a robot through the camera. */
static void look_through(int i) {
    Watched *w = &watched[i];
    look(i);
    take_look(w, (Pose){known.positions[i][0], known.positions[i][1], known.headings[i]});
    known.positions[i][0] = w->now.pose.x;
    known.positions[i][1] = w->now.pose.y;
    known.headings[i] = w->now.pose.heading;
    known.variances[i] = variance_of(&w->now);
}

/* K_T, R, J and r of a motor of its own. */
static void spread_motor(int i, int k, Random *random) {
    MotorConstants *p = &motors[i][k].constants;
    double *values[] = {&p->K_T, &p->R, &p->J, &p->r};
    for (int j = 0; j < 4; j++)
        *values[j] *= 1.0 + setup.spread * between(next_normal(random), -3.0, 3.0);
    mounts[i][k].r = p->r;
    mounts[i][k].J = p->J;
}

/* Let the floor fall in a drawn direction, in deg rounded to 6 digits. */
static void tilt_floor(Random *random) {
    const Wide scaled = (Wide)(360.0 * next_double(random) * 0x1p64) * 1000000;
    const double direction_deg = (double)(int64_t)((scaled + ((Wide)1 << 63)) >> 64) / 1e6;
    const Trig t = sine_cosine(direction_deg * (PI / 180.0));
    for (int i = 0; i < robot_count(); i++) {
        constants_of[i].gravity.x = setup.gravity[0] * t.cosine;
        constants_of[i].gravity.y = setup.gravity[0] * t.sine;
    }
}

/* The friction coefficients that are under a robot's feet: `feel_patches` of
 * cosim/physics/properties.py in C. */
static void feel_patches(int i) {
    BodyConstants *p = &constants_of[i];
    const Matrix axes = rotation_matrix(bodies[i].orientation);
    for (int k = 0; k < FOOT_COUNT; k++) {
        const Vector foot = p->contact.foot[k];
        const Vector arm = {foot.x - p->centre_x, foot.y - p->centre_y, foot.z};
        const double x = bodies[i].position.x + dot(axes.x, arm);
        const double y = bodies[i].position.y + dot(axes.y, arm);
        p->mu[k] = setup.mu[0];
        for (const double *e = table.patches; e < table.patches + 5 * (int)setup.patches; e += 5)
            if (e[0] <= x && x < e[2] && e[1] <= y && y < e[3])
                p->mu[k] = e[4] == e[4] ? e[4] : setup.mu[0];
    }
}

/* Start cells: drawn again while any two robots would touch. */
static bool draw_starts(Random *random, int32_t starts[][2]) {
    for (int draw = 0; draw < DRAWS; draw++) {
        const int32_t *of_robot = table.starts;
        bool apart = true;
        for (int i = 0; i < robot_count(); i++) {
            const uint32_t count = (uint32_t)setup.start_counts[i];
            const int32_t *cell = of_robot + 2 * next_index(random, count);
            of_robot += 2 * count;
            starts[i][0] = cell[0];
            starts[i][1] = cell[1];
            for (int j = 0; j < i; j++) {
                const int32_t dx = starts[j][0] - cell[0], dy = starts[j][1] - cell[1];
                apart &= dx * dx + dy * dy > (int32_t)setup.contact_squared;
            }
        }
        if (apart)
            return true;
    }
    return false;
}

static void show(void);

/* Begin episode `number` of a seeded series; the outcome. */
EXPORT int episode_begin(double seed, uint32_t number) {
    const uint32_t start_keys[] = {number, START_CHILD};
    const uint32_t detour_keys[] = {number, NOISE_CHILD, DETOUR_CHILD};
    const uint32_t world_keys[] = {number, NOISE_CHILD, WORLD_CHILD};
    int32_t starts[MOST_ROBOTS][2];
    Random random = random_of((uint64_t)seed, start_keys, 2);
    Random world = random_of((uint64_t)seed, world_keys, 3);
    BodyConstants body;
    memcpy(&body, &setup.inverse_mass, sizeof body);
    view = (View){0};
    tick = period_of_step = periods_since_point = 0;
    pair_count = 0;
    if (!draw_starts(&random, starts))
        return outcome = NO_STARTS;
    for (int i = 0; i < robot_count(); i++) {
        const double x = (starts[i][0] + 0.5) * setup.cell_m, y = (starts[i][1] + 0.5) * setup.cell_m;
        const bool up = setup.size[1] / 2.0 - y >= 0.0;
        constants_of[i] = body;
        memcpy(mounts[i], setup.mounts, sizeof mounts[i]);
        bodies[i] = (Body){.position = {x, y, setup.com_height_m},
                           .orientation = {setup.start_quaternion[0], 0.0, 0.0,
                                           up ? setup.start_quaternion[1]
                                              : -setup.start_quaternion[1]}};
        look(i);
        const uint32_t camera_keys[] = {number, NOISE_CHILD, CAMERA_CHILD + (uint32_t)i};
        watch(&watched[i], random_of((uint64_t)seed, camera_keys, 3));
        last_points[i][0] = x;
        last_points[i][1] = y;
        for (int k = 0; k < MOTORS; k++) {
            const uint32_t keys[] = {number, NOISE_CHILD, (uint32_t)(MOTORS * i + k)};
            Shaken *motor = &motors[i][k];
            *motor = (Shaken){.noise = random_of((uint64_t)seed, keys, 3)};
            for (int j = 0; j < PARAMETER_COUNT; j++)
                motor->constants.value[j] = setup.motor[j];
            motor->constants.closed_loop = true;
            motor->constants.theta_start = setup.phases[MOTORS * i + k];
            if (setup.spread > 0.0 || setup.gravity[0] > 0.0)
                spread_motor(i, k, &world);
            motor_derive(&motor->constants);
            motor->x = motor_start(&motor->constants);
        }
    }
    if (setup.gravity[0] > 0.0)
        tilt_floor(&world);
    onboard_start(&known, random_of((uint64_t)seed, detour_keys, 3));
    outcome = RUNNING;
    show();
    return outcome;
}

/* Set a robot down elsewhere, at rest; whether there is room. */
EXPORT bool episode_place(int i, double x, double y) {
    const double radius = 0.5 * setup.diameter_m;
    bool free = 0.0 < x && x < setup.size[0] && 0.0 < y && y < setup.size[1];
    for (int j = 0; j < robot_count(); j++) {
        const double dx = bodies[j].position.x - x, dy = bodies[j].position.y - y;
        free &= j == i || dx * dx + dy * dy > setup.diameter_m * setup.diameter_m;
    }
    for (const double *e = table.walls; e < table.walls + 4 * (int)setup.walls; e += 4) {
        const double dx = x - between(x, e[0], e[2]), dy = y - between(y, e[1], e[3]);
        free &= dx * dx + dy * dy > radius * radius;
    }
    if (!free || outcome != RUNNING)
        return false;
    const Quaternion q = bodies[i].orientation;
    const double norm = square_root(q.w * q.w + q.z * q.z);
    bodies[i] = (Body){.position = {x, y, setup.com_height_m},
                       .orientation = {q.w / norm, 0.0, 0.0, q.z / norm}};
    last_points[i][0] = x;
    last_points[i][1] = y;
    look(i);
    show();
    return true;
}

static void draw_noise(Shaken *motor) {
    if (period_of_step % (int64_t)setup.noise_hold_periods == 0)
        motor->noise_value = (next_double(&motor->noise) * 2.0 - 1.0) * setup.noise;
}

static MotorDrive drive_of(const Shaken *motor) {
    return motor_drive(&motor->constants, &motor->in, motor->x, sine(motor->x.theta));
}

static void begin_period(void) {
    const double reach = setup.diameter_m + NEAR_M;
    pair_count = 0;
    for (int i = 0; i < robot_count() && INTERVAL > 0.0; i++)
        look_through(i);
    onboard_guard(&known);
    for (int i = 0; i < robot_count(); i++) {
        double set_points[MOTORS], motion[2];
        onboard_steer(i, &known, set_points, motion);
        take_command(&watched[i], motion[0], motion[1], set_points[0] != 0.0 || set_points[1] != 0.0,
                     setup.control_period_s);
        feel_patches(i);
        touching[i] = 0.0;
        for (int k = 0; k < FOOT_COUNT; k++)
            pressed[i][k] = 0.0;
        for (int k = 0; k < MOTORS; k++) {
            Shaken *motor = &motors[i][k];
            draw_noise(motor);
            motor->in.omega_des = set_points[k];
            motor->in.omega_noise = motor->noise_value * fabs(set_points[k]);
            motor->drive = drive_of(motor);
        }
        for (int j = 0; j < i; j++) {
            const double dx = bodies[i].position.x - bodies[j].position.x;
            const double dy = bodies[i].position.y - bodies[j].position.y;
            if (dx * dx + dy * dy < reach * reach) {
                pairs[pair_count][0] = i;
                pairs[pair_count++][1] = j;
            }
        }
    }
}

/* A motor one tick on, as the body sees it. */
static Shaft turn(Shaken *motor) {
    const MotorConstants *p = &motor->constants;
    motor->x = motor_euler(p, motor->x, motor->drive, p->step_size);
    motor->drive = drive_of(motor);
    const double torque = motor->drive.torque;
    const double direction = motor_direction(p, motor->x.omega, torque);
    return (Shaft){motor->x.theta, motor->x.omega, motor_acceleration(p, torque, direction)};
}

/* The contact impulse between two robots: `push_apart` of cosim/physics/collision.py in C. */
static void push_apart(int i, int j) {
    Body *a = &bodies[i], *b = &bodies[j];
    const double dx = b->position.x - a->position.x, dy = b->position.y - a->position.y;
    const double distance = square_root(dx * dx + dy * dy);
    const double nx = dx / distance, ny = dy / distance;
    const double radius = 0.5 * setup.diameter_m;
    const double vx = b->velocity.x - a->velocity.x, vy = b->velocity.y - a->velocity.y;
    const double approach = vx * nx + vy * ny;
    const double excess =
        approach - allowed_approach(distance - setup.diameter_m, 1.0 / setup.dt_s);
    if (excess >= 0.0)
        return;
    const double mass = setup.inverse_mass, spin = radius * setup.inverse_inertia[2];
    const double impulse = -excess / (mass + mass);
    const double slip = vy * nx - vx * ny - radius * (a->omega.z + b->omega.z);
    const double stopping = -slip / (mass + mass + radius * (spin + spin));
    const double limit = setup.mu_robots * impulse;
    const double friction = between(stopping, -limit, limit);
    const double jx = impulse * nx - friction * ny, jy = impulse * ny + friction * nx;
    a->velocity.x -= jx * mass;
    a->velocity.y -= jy * mass;
    b->velocity.x += jx * mass;
    b->velocity.y += jy * mass;
    a->omega.z -= spin * friction;
    b->omega.z -= spin * friction;
    touched[i] |= impulse > 0.0;
    touched[j] |= impulse > 0.0;
}

/* The contact impulse of an obstacle on a robot: `push_off`, likewise. */
static void push_off(int i, const double wall[4]) {
    Body *body = &bodies[i];
    const double dx = body->position.x - between(body->position.x, wall[0], wall[2]);
    const double dy = body->position.y - between(body->position.y, wall[1], wall[3]);
    const double radius = 0.5 * setup.diameter_m, reach = radius + NEAR_M;
    if (!(dx * dx + dy * dy < reach * reach))
        return;
    const double distance = square_root(dx * dx + dy * dy);
    const double nx = dx / distance, ny = dy / distance;
    const double vx = body->velocity.x, vy = body->velocity.y;
    const double excess =
        vx * nx + vy * ny - allowed_approach(distance - radius, 1.0 / setup.dt_s);
    if (excess >= 0.0)
        return;
    const double mass = setup.inverse_mass, spin = radius * setup.inverse_inertia[2];
    const double impulse = -excess / mass;
    const double slip = vy * nx - vx * ny - radius * body->omega.z;
    const double limit = setup.mu_robots * impulse;
    const double friction = between(-slip / (mass + radius * spin), -limit, limit);
    body->velocity.x += mass * (impulse * nx - friction * ny);
    body->velocity.y += mass * (impulse * ny + friction * nx);
    body->omega.z -= spin * friction;
    touched[i] |= impulse > 0.0;
}

static void step_tick(void) {
    for (int i = 0; i < robot_count(); i++) {
        const Wrench d = motor_wrench(mounts[i][0], turn(&motors[i][0]));
        const Wrench e = motor_wrench(mounts[i][1], turn(&motors[i][1]));
        /* Forces of motors have no part along y. */
        const Wrench both = {{d.force.x + e.force.x, 0.0, d.force.z + e.force.z},
                             {d.moment.x + e.moment.x, d.moment.y + e.moment.y,
                              d.moment.z + e.moment.z}};
        bodies[i] = body_stepped(bodies[i], &constants_of[i], both);
        for (int k = 0; k < FOOT_COUNT; k++)
            pressed[i][k] += bodies[i].at[k].normal;
    }
    for (int k = 0; k < pair_count; k++)
        push_apart(pairs[k][0], pairs[k][1]);
    for (int i = 0; i < robot_count(); i++) {
        for (int k = 0; k < (int)setup.walls; k++)
            push_off(i, table.walls + 4 * k);
        touching[i] += touched[i];
        touched[i] = false;
    }
}

static bool is_forbidden(int i, double x, double y) {
    const double *edge = table.forbidden + 4 * i * (int)setup.forbidden;
    for (int k = 0; k < (int)setup.forbidden; k++, edge += 4)
        if (edge[0] <= x && x < edge[2] && edge[1] <= y && y < edge[3])
            return true;
    return false;
}

/* What has become of a robot. */
static int event_of(int i) {
    const double x = bodies[i].position.x, y = bodies[i].position.y;
    if (!(0.0 <= x && x <= setup.size[0] && 0.0 <= y && y <= setup.size[1]))
        return OUT_OF_BOARD;
    if (bodies[i].position.z < 0.0)
        return OUT_OF_BOARD;
    if (setup.ends_on_collision != 0.0 && (touching[i] > 0.0 || is_forbidden(i, x, y)))
        return COLLISION;
    return RUNNING;
}

static void add_to_path(void) {
    if (++periods_since_point < (int64_t)setup.path_periods)
        return;
    periods_since_point = 0;
    for (int i = 0; i < robot_count(); i++) {
        const double dx = bodies[i].position.x - last_points[i][0];
        const double dy = bodies[i].position.y - last_points[i][1];
        view.path_m[i] += square_root(dx * dx + dy * dy);
        last_points[i][0] = bodies[i].position.x;
        last_points[i][1] = bodies[i].position.y;
    }
}

static void show(void) {
    view.time_s = tick * setup.dt_s;
    view.outcome = outcome;
    for (int i = 0; i < robot_count(); i++) {
        view.position[3 * i] = bodies[i].position.x;
        view.position[3 * i + 1] = bodies[i].position.y;
        view.position[3 * i + 2] = bodies[i].position.z;
        view.heading[i] = from_angle(bodies[i].orientation);
        onboard_show(i, view.goal + 2 * i, &view.mode[i], &view.arrived[i]);
        const double period_s = setup.control_period_s;
        for (int k = 0; k < FOOT_COUNT; k++)
            view.force[FOOT_COUNT * i + k] = pressed[i][k] / period_s;
        for (int k = 0; k < MOTORS; k++) {
            const Shaken *motor = &motors[i][k];
            const double u = motor_command(&motor->constants, &motor->in, motor->x.omega,
                                           motor->x.integral);
            view.omega[MOTORS * i + k] = motor->x.omega;
            view.theta[MOTORS * i + k] = motor->x.theta;
            view.voltage[MOTORS * i + k] = motor_saturate(&motor->constants, u);
        }
    }
}

/* No robot that is asked estimates itself off the board. */
static void begin_step(void) {
    Known asked = known;
    for (int i = 0; i < robot_count() && INTERVAL > 0.0; i++) {
        draw_sights(&watched[i]);
        for (int k = 0; k < 2; k++)
            asked.positions[i][k] = between(asked.positions[i][k], 0.0, setup.within[k]);
    }
    onboard_decide(&asked);
}

static void end_step(int event) {
    double positions[MOST_ROBOTS][2];
    for (int i = 0; i < robot_count(); i++) {
        positions[i][0] = bodies[i].position.x;
        positions[i][1] = bodies[i].position.y;
    }
    const bool all = onboard_arrive(positions);
    period_of_step = 0;
    view.steps++;
    if (event != RUNNING)
        outcome = event;
    else if (all)
        outcome = SUCCESS;
    else if (tick >= (int64_t)setup.episode_limit_ticks)
        outcome = TIMEOUT;
}

/* Simulate control periods, at most to the end of the episode; the outcome, 0 while it runs. */
EXPORT int episode_advance(int periods) {
    while (periods-- > 0 && outcome == RUNNING) {
        int event = RUNNING;
        if (period_of_step == 0)
            begin_step();
        begin_period();
        for (int k = 0; k < (int)setup.ticks_per_period; k++)
            step_tick();
        tick += (int64_t)setup.ticks_per_period;
        for (int i = 0; i < robot_count(); i++) {
            const int its = event_of(i);
            event = its > event ? its : event;
            if (!(INTERVAL > 0.0)) /* what decides next knows the pose of now */
                look(i);
        }
        add_to_path();
        if (++period_of_step == (int64_t)setup.decision_periods || event != RUNNING)
            end_step(event);
    }
    show();
    return outcome;
}

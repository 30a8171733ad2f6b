/* One episode of any number of robots, as cosim/simulation and cosim/coupling have it: motors and
 * bodies of the FMUs, the firmware, and what robots do to each other and to obstacles.
 *
 * A page or a test writes `episode_setup` and the tables, begins an episode by its seed, advances it by
 * control periods and reads `episode_view`. */
#include <stdlib.h>
#include <string.h>

#include "body.h"
#include "camera.h"
#include "motor.h"

#define EXPORT __attribute__((visibility("default")))
#define NEAR_M 2e-3 /* of contact: what is nearer is looked at in every tick */

enum { DRAWS = 20000 };
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
static Position last_points[MOST_ROBOTS]; /* of the paths */
static bool touched[MOST_ROBOTS];         /* in the period */
static double pressed[MOST_ROBOTS][FOOT_COUNT]; /* sum of the normal impulses of the period */
static int pairs[MOST_ROBOTS * MOST_ROBOTS][2], pair_count;
static int64_t tick, period_of_step, periods_since_point;
static int outcome;
static float mapped[DIRECTIONS]; /* values of the last cell that was asked for */

EXPORT Setup *episode_setup(void) { return &setup; }

EXPORT View *episode_view(void) { return &view; }

/* Room for a table, by its place in `Tables`; null if there is none. */
EXPORT void *episode_table(int which, size_t size) {
    void **place = (void **)&table + which;
    free(*place);
    return *place = size ? malloc(size) : NULL;
}

static double heading_of(Quaternion q) {
    return angle_of(2.0 * (q.x * q.y + q.w * q.z), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
}

static bool is_within(const double *edges, double x, double y) {
    return edges[0] <= x && x < edges[2] && edges[1] <= y && y < edges[3];
}

static Position centre_of(Cell cell) {
    return (Position){(cell.x + 0.5) * CELL_M, (cell.y + 0.5) * CELL_M};
}

static Position place_of(const Body *body) {
    return (Position){body->position.x, body->position.y};
}

static void look(int i) {
    known.at[i] = place_of(&bodies[i]);
    known.headings[i] = heading_of(bodies[i].orientation);
    known.variances[i] = 0.0;
}

/* Look at a robot through the camera. */
static void look_through(int i) {
    Watched *w = &watched[i];
    look(i);
    take_look(w, (Pose){known.at[i].x, known.at[i].y, known.headings[i]});
    known.at[i] = (Position){w->now.pose.x, w->now.pose.y};
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
    for (int i = 0; i < ROBOTS; i++) {
        constants_of[i].gravity.x = setup.body.gravity.x * t.cosine;
        constants_of[i].gravity.y = setup.body.gravity.x * t.sine;
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
        p->mu[k] = setup.mu;
        for (const double *e = table.patches; e < table.patches + 5 * (int)setup.patches; e += 5)
            if (is_within(e, x, y))
                p->mu[k] = e[4] == e[4] ? e[4] : setup.mu;
    }
}

/* Start cells: drawn again while any two robots would touch. */
static bool draw_starts(Random *random, Cell starts[]) {
    for (int draw = 0; draw < DRAWS; draw++) {
        const int32_t *of_robot = table.starts;
        bool apart = true;
        for (int i = 0; i < ROBOTS; i++) {
            const uint32_t count = (uint32_t)setup.start_counts[i];
            const int32_t *cell = of_robot + 2 * next_index(random, count);
            of_robot += 2 * count;
            starts[i] = (Cell){cell[0], cell[1]};
            for (int j = 0; j < i; j++) {
                const int32_t dx = starts[j].x - cell[0], dy = starts[j].y - cell[1];
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
    Cell starts[MOST_ROBOTS];
    Random random = random_of((uint64_t)seed, start_keys, 2);
    Random world = random_of((uint64_t)seed, world_keys, 3);
    view = (View){0};
    tick = period_of_step = periods_since_point = 0;
    pair_count = 0;
    if (!draw_starts(&random, starts))
        return outcome = NO_STARTS;
    for (int i = 0; i < ROBOTS; i++) {
        const Position at = centre_of(starts[i]);
        const bool up = setup.size[1] / 2.0 - at.y >= 0.0;
        constants_of[i] = setup.body;
        memcpy(mounts[i], setup.mounts, sizeof mounts[i]);
        bodies[i] = (Body){.position = {at.x, at.y, setup.com_height_m},
                           .orientation = {setup.start_quaternion[0], 0.0, 0.0,
                                           up ? setup.start_quaternion[1]
                                              : -setup.start_quaternion[1]}};
        look(i);
        const uint32_t camera_keys[] = {number, NOISE_CHILD, CAMERA_CHILD + (uint32_t)i};
        watch(&watched[i], random_of((uint64_t)seed, camera_keys, 3));
        last_points[i] = known.at[i];
        for (int k = 0; k < MOTORS; k++) {
            const uint32_t keys[] = {number, NOISE_CHILD, (uint32_t)(MOTORS * i + k)};
            Shaken *motor = &motors[i][k];
            *motor = (Shaken){.noise = random_of((uint64_t)seed, keys, 3)};
            for (int j = 0; j < PARAMETER_COUNT; j++)
                motor->constants.value[j] = setup.motor[j];
            motor->constants.closed_loop = true;
            motor->constants.theta_start = setup.phases[MOTORS * i + k];
            if (setup.spread > 0.0 || setup.body.gravity.x > 0.0)
                spread_motor(i, k, &world);
            motor_derive(&motor->constants);
            motor->x = motor_start(&motor->constants);
        }
    }
    if (setup.body.gravity.x > 0.0)
        tilt_floor(&world);
    order_targets();
    start_robots(&known, random_of((uint64_t)seed, detour_keys, 3));
    outcome = RUNNING;
    show();
    return outcome;
}

/* Whether a robot's centre may be somewhere, by the places or targets of the others. */
static bool has_room(int i, double x, double y, const Position others[]) {
    bool free = 0.0 < x && x < setup.size[0] && 0.0 < y && y < setup.size[1];
    for (int j = 0; j < ROBOTS; j++)
        free &= j == i || norm(others[j].x - x, others[j].y - y) > setup.diameter_m;
    for (const double *e = table.walls; e < table.walls + 4 * (int)setup.walls; e += 4) {
        const Position out = away_from(e, (Position){x, y});
        free &= norm(out.x, out.y) > 0.5 * setup.diameter_m;
    }
    return free;
}

/* Give a robot another target; whether there is room. */
EXPORT bool episode_aim(int i, int32_t column, int32_t row) {
    Position targets[MOST_ROBOTS];
    for (int j = 0; j < ROBOTS; j++)
        targets[j] = centre_of(target_of(j));
    const Position at = centre_of((Cell){column, row});
    if (!has_room(i, at.x, at.y, targets) || (outcome != RUNNING && outcome != SUCCESS))
        return false;
    setup.targets[2 * i] = column;
    setup.targets[2 * i + 1] = row;
    robot_of[i].arrived = false;
    outcome = RUNNING;
    order_targets();
    show();
    return true;
}

/* What the network says of a cell to a robot while the others are at their targets: the value of the
 * best move, which is not a number where it would touch them, and that move. */
EXPORT double episode_value(int i, int32_t column, int32_t row) {
    Cell cells[MOST_ROBOTS];
    bool apart = true;
    for (int j = 0; j < ROBOTS; j++) {
        cells[j] = j == i ? (Cell){column, row} : target_of(j);
        const int32_t dx = cells[j].x - column, dy = cells[j].y - row;
        apart &= j == i || dx * dx + dy * dy > setup.contact_squared;
    }
    present_robot = i + 1;
    network_values(cells, mapped);
    return apart ? largest_of(mapped) : NAN;
}

EXPORT int episode_best(void) {
    int best = 0;
    for (int k = 1; k < DIRECTIONS; k++)
        best = mapped[k] > mapped[best] ? k : best;
    return best;
}

/* Set a robot down elsewhere, at rest; whether there is room. */
EXPORT bool episode_place(int i, double x, double y) {
    Position at[MOST_ROBOTS];
    for (int j = 0; j < ROBOTS; j++)
        at[j] = place_of(&bodies[j]);
    if (!has_room(i, x, y, at) || outcome != RUNNING)
        return false;
    const Quaternion q = bodies[i].orientation;
    const double norm = square_root(q.w * q.w + q.z * q.z);
    bodies[i] = (Body){.position = {x, y, setup.com_height_m},
                       .orientation = {q.w / norm, 0.0, 0.0, q.z / norm}};
    look(i);
    last_points[i] = (Position){x, y};
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
    for (int i = 0; i < ROBOTS && INTERVAL > 0.0; i++)
        look_through(i);
    if (setup.shielded != 0.0)
        guard(&known);
    for (int i = 0; i < ROBOTS; i++) {
        double set_points[MOTORS];
        noted_motion[0] = noted_motion[1] = 0.0;
        robot_steer(&robot_of[i], known.at[i].x, known.at[i].y, known.headings[i], set_points);
        take_command(&watched[i], noted_motion[0], noted_motion[1],
                     set_points[0] != 0.0 || set_points[1] != 0.0, setup.control_period_s);
        feel_patches(i);
        touched[i] = false;
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

/* The contact impulse on a body of another, or of a wall that has no inverse mass, at a distance of
 * their contact; whether there is one: `push_apart` and `push_off` of cosim/physics/collision.py in C. */
static bool push(Body *a, double mass_a, Body *b, double contact_m) {
    const double dx = b->position.x - a->position.x, dy = b->position.y - a->position.y;
    const double distance = norm(dx, dy);
    const double nx = dx / distance, ny = dy / distance;
    const double radius = 0.5 * setup.diameter_m;
    const double vx = b->velocity.x - a->velocity.x, vy = b->velocity.y - a->velocity.y;
    const double excess = vx * nx + vy * ny - allowed_approach(distance - contact_m, setup.body.inverse_dt);
    if (excess >= 0.0)
        return false;
    const double mass = setup.body.inverse_mass, spin = radius * setup.body.inverse_inertia.z;
    const double spin_a = mass_a > 0.0 ? spin : 0.0;
    const double impulse = -excess / (mass_a + mass);
    const double slip = vy * nx - vx * ny - radius * (a->omega.z + b->omega.z);
    const double stopping = -slip / (mass_a + mass + radius * (spin_a + spin));
    const double limit = setup.mu_robots * impulse;
    const double friction = between(stopping, -limit, limit);
    const double jx = impulse * nx - friction * ny, jy = impulse * ny + friction * nx;
    a->velocity.x -= jx * mass_a;
    a->velocity.y -= jy * mass_a;
    b->velocity.x += jx * mass;
    b->velocity.y += jy * mass;
    a->omega.z -= spin_a * friction;
    b->omega.z -= spin * friction;
    return impulse > 0.0;
}

static void push_off(int i, const double wall[4]) {
    Body *body = &bodies[i];
    const double radius = 0.5 * setup.diameter_m, reach = radius + NEAR_M;
    const Position out = away_from(wall, place_of(body));
    Body still = {.position = {between(body->position.x, wall[0], wall[2]),
                               between(body->position.y, wall[1], wall[3]), 0.0}};
    if (out.x * out.x + out.y * out.y < reach * reach)
        touched[i] |= push(&still, 0.0, body, radius);
}

static void step_tick(void) {
    for (int i = 0; i < ROBOTS; i++) {
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
    for (int k = 0; k < pair_count; k++) {
        const int i = pairs[k][0], j = pairs[k][1];
        if (push(&bodies[i], setup.body.inverse_mass, &bodies[j], setup.diameter_m))
            touched[i] = touched[j] = true;
    }
    for (int i = 0; i < ROBOTS; i++)
        for (int k = 0; k < (int)setup.walls; k++)
            push_off(i, table.walls + 4 * k);
}

/* Whether a robot is where it may not be. */
static bool is_forbidden(int i, double x, double y) {
    bool found = false;
    for (int k = 0; k < (int)setup.closed; k++)
        found |= is_within(table.closed + 4 * (i * (int)setup.closed + k), x, y);
    for (int k = 0; k < ROBOTS; k++)
        found |= is_parking(i, k) && is_within(square_of(k).edges, x, y);
    return found;
}

/* What has become of a robot. */
static int event_of(int i) {
    const double x = bodies[i].position.x, y = bodies[i].position.y;
    if (!(0.0 <= x && x <= setup.size[0] && 0.0 <= y && y <= setup.size[1]))
        return OUT_OF_BOARD;
    if (bodies[i].position.z < 0.0)
        return OUT_OF_BOARD;
    if (setup.ends_on_collision != 0.0 && (touched[i] || is_forbidden(i, x, y)))
        return COLLISION;
    return RUNNING;
}

static void add_to_path(void) {
    if (++periods_since_point < (int64_t)setup.path_periods)
        return;
    periods_since_point = 0;
    for (int i = 0; i < ROBOTS; i++) {
        const Position now = place_of(&bodies[i]), last = last_points[i];
        view.path_m[i] += norm(now.x - last.x, now.y - last.y);
        last_points[i] = now;
    }
}

static void show(void) {
    view.time_s = tick * setup.body.dt;
    view.outcome = outcome;
    for (int i = 0; i < ROBOTS; i++) {
        memcpy(view.position + 3 * i, &bodies[i].position, sizeof bodies[i].position);
        view.heading[i] = heading_of(bodies[i].orientation);
        memcpy(view.goal + 2 * i, &robot_of[i].goal, sizeof robot_of[i].goal);
        view.mode[i] = robot_of[i].mode;
        view.arrived[i] = robot_of[i].arrived;
        for (int k = 0; k < FOOT_COUNT; k++)
            view.force[FOOT_COUNT * i + k] = pressed[i][k] / setup.control_period_s;
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
    for (int i = 0; i < ROBOTS && INTERVAL > 0.0; i++) {
        draw_sights(&watched[i]);
        asked.at[i].x = between(asked.at[i].x, 0.0, setup.within[0]);
        asked.at[i].y = between(asked.at[i].y, 0.0, setup.within[1]);
    }
    decide(&asked);
}

static void end_step(int event) {
    Position at[MOST_ROBOTS];
    for (int i = 0; i < ROBOTS; i++)
        at[i] = place_of(&bodies[i]);
    const bool all = arrive(at);
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
        for (int i = 0; i < ROBOTS; i++) {
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

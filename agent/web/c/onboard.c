/* See onboard.h: the firmware's files, one robot after the other. */
#include "onboard.h"

#include "navigation.c"
#include "steering.c"

#include "arctangent.c"

int32_t present_robot;

static Cell target_of(int32_t robot) {
    return (Cell){(int32_t)setup.targets[2 * robot], (int32_t)setup.targets[2 * robot + 1]};
}

static float largest_of(const float values[DIRECTIONS]) {
    float largest = values[0];
    for (int k = 1; k < DIRECTIONS; k++)
        largest = values[k] > largest ? values[k] : largest;
    return largest;
}

static double between(double x, double low, double high) {
    const double raised = x > low ? x : low;
    return raised < high ? raised : high;
}

#include "network.h"
#include "pair.h"

static Robot robot_of[MOST_ROBOTS];
static bool was_moving[MOST_ROBOTS];

#include "shield.h"

double onboard_angle(double y, double x) {
    if (size(y) <= size(x)) {
        const double angle = arctangent(y / x);
        return x > 0.0 ? angle : y < 0.0 ? angle - PI : angle + PI;
    }
    const double angle = arctangent(x / y);
    return y > 0.0 ? PI / 2.0 - angle : -PI / 2.0 - angle;
}

static void see(const double positions[][2], Position seen[ROBOTS], Cell cells[ROBOTS]) {
    for (int32_t i = 0; i < ROBOTS; i++)
        seen[i] = (Position){positions[i][0], positions[i][1]};
    cells_of(seen, cells);
}

void onboard_start(const Known *known, Random random) {
    Position seen[ROBOTS];
    Cell cells[ROBOTS];
    see(known->positions, seen, cells);
    detours = random;
    for (int32_t i = 0; i < ROBOTS; i++) {
        present_robot = i + 1;
        robot_start(&robot_of[i], seen);
        kept_of[i] = (Kept){0};
    }
}

static bool has_ended(const Robot *robot) { return robot->mode == HOLD || robot->mode == PAST; }

static void ask_pair(const Cell cells[2], const int32_t towards[2], float values[][DIRECTIONS]) {
    int32_t at[2], goals[2], axes[2];
    for (int i = 0; i < 2; i++) {
        const Robot *robot = &robot_of[i];
        at[i] = goals[i] = cells[i].x * ROWS + cells[i].y;
        if (!has_ended(robot))
            goals[i] = (int32_t)between(whole(robot->goal.x / CELL_M), 0, COLUMNS - 1) * ROWS +
                       (int32_t)between(whole(robot->goal.y / CELL_M), 0, ROWS - 1);
        axes[i] = towards[i] % AXES;
    }
    pair_values(at, goals, axes, values);
}

/* A bit for each direction that a robot's table, the network or a look ahead has as the best. */
static uint8_t best_of(const Cell cells[], int32_t squared, int32_t before, int32_t other,
                       int32_t towards, float values[DIRECTIONS]) {
    if (table.best)
        return table.best[(ROBOT - 1) * STATES + state_of(cells, squared, before, other, towards)];
    if (table.network)
        network_values(cells, values);
    const float largest = largest_of(values);
    uint8_t bits = 0;
    for (int k = 0; k < DIRECTIONS; k++)
        bits |= (uint8_t)((values[k] == largest) << k);
    return bits;
}

void onboard_decide(const Known *known) {
    Position seen[ROBOTS];
    Cell cells[ROBOTS];
    int32_t towards[ROBOTS];
    float values[MOST_ROBOTS][DIRECTIONS];
    see(known->positions, seen, cells);
    for (int32_t i = 0; i < ROBOTS; i++)
        towards[i] = facing(known->headings[i]);
    if (table.delay)
        ask_pair(cells, towards, values);
    for (int32_t i = 0; i < ROBOTS; i++) {
        Robot *robot = &robot_of[i];
        int32_t other;
        present_robot = i + 1;
        const bool late = robot->period - robot->moving_since >= MOVE_LIMIT_PERIODS;
        if (!robot->arrived && (has_ended(robot) || late)) {
            const int32_t squared = nearest(cells, &other);
            const uint8_t best = best_of(cells, squared, robot->squared, other, towards[i], values[i]);
            int32_t direction = choose(best, towards[i]);
            if (setup.shielded != 0.0)
                direction = yielded(seen, known->variances, i, direction);
            if (direction == WAIT) {
                robot->mode = HOLD;
            } else {
                begin_move(robot, cells[i], direction);
                robot->squared = squared;
            }
        }
        was_moving[i] = !has_ended(robot);
    }
}

void onboard_guard(const Known *known) {
    Position seen[ROBOTS];
    Cell cells[ROBOTS];
    if (setup.shielded == 0.0)
        return;
    see(known->positions, seen, cells);
    guard(seen, known->headings, known->variances);
}

void onboard_steer(int robot, const Known *known, double set_points[2], double motion[2]) {
    const double *at = known->positions[robot];
    noted_motion[0] = noted_motion[1] = 0.0;
    robot_steer(&robot_of[robot], at[0], at[1], known->headings[robot], set_points);
    motion[0] = noted_motion[0];
    motion[1] = noted_motion[1];
}

bool onboard_arrive(const double positions[][2]) {
    Position seen[ROBOTS];
    Cell cells[ROBOTS];
    bool all = true;
    see(positions, seen, cells);
    for (int32_t i = 0; i < ROBOTS; i++) {
        Robot *robot = &robot_of[i];
        present_robot = i + 1;
        robot->arrived |= was_moving[i] && has_ended(robot) && cells[i].x == TARGET_X &&
                          cells[i].y == TARGET_Y;
        if (robot->arrived)
            robot->mode = HOLD;
        all &= robot->arrived;
    }
    return all;
}

void onboard_show(int robot, double goal[2], double *mode, double *arrived) {
    goal[0] = robot_of[robot].goal.x;
    goal[1] = robot_of[robot].goal.y;
    *mode = robot_of[robot].mode;
    *arrived = robot_of[robot].arrived;
}

/* What robots decide and how they steer: the firmware of agent/firmware/c, for all robots of a board. */
#ifndef ONBOARD_H
#define ONBOARD_H

#include <string.h>

#include "arctangent.c"
#include "navigation.c"
#include "noise.h"
#include "steering.c"
#include "trig.h"

/* What is known of all robots: where they are, headings in rad, and the variances of positions in m^2. */
typedef struct {
    Position at[MOST_ROBOTS];
    double headings[MOST_ROBOTS], variances[MOST_ROBOTS];
} Known;

static Robot robot_of[MOST_ROBOTS];
static bool was_moving[MOST_ROBOTS];

static Cell target_of(int32_t robot) {
    return (Cell){(int32_t)setup.targets[2 * robot], (int32_t)setup.targets[2 * robot + 1]};
}

static bool is_same(Cell a, Cell b) { return a.x == b.x && a.y == b.y; }

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

static double norm(double x, double y) { return square_root(x * x + y * y); }

#include "network.h"
#include "pair.h"
#include "shield.h"

/* Angle of the point (x, y) in rad. */
static double angle_of(double y, double x) {
    if (size(y) <= size(x)) {
        const double angle = arctangent(y / x);
        return x > 0.0 ? angle : y < 0.0 ? angle - PI : angle + PI;
    }
    const double angle = arctangent(x / y);
    return y > 0.0 ? PI / 2.0 - angle : -PI / 2.0 - angle;
}

/* Set all robots down; detours of the shield are drawn from a generator. */
static void start_robots(const Known *known, Random random) {
    detours = random;
    for (present_robot = 1; present_robot <= ROBOTS; present_robot++) {
        robot_start(&robot_of[ROBOT - 1], known->at);
        kept_of[ROBOT - 1] = (Kept){0};
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

/* Let the robots that wait or are late begin their next move. Once in every RL step. */
static void decide(const Known *known) {
    Cell cells[ROBOTS];
    int32_t towards[ROBOTS];
    float values[MOST_ROBOTS][DIRECTIONS];
    cells_of(known->at, cells);
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
                direction = yielded(known, i, direction);
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

/* Judge the moves at the end of an RL step by true positions; whether all robots have arrived. */
static bool arrive(const Position at[]) {
    Cell cells[ROBOTS];
    bool all = true;
    cells_of(at, cells);
    for (int32_t i = 0; i < ROBOTS; i++) {
        Robot *robot = &robot_of[i];
        robot->arrived |= was_moving[i] && has_ended(robot) && is_same(cells[i], target_of(i));
        if (robot->arrived)
            robot->mode = HOLD;
        all &= robot->arrived;
    }
    return all;
}

#endif

/* What a robot sees, what its table says to it, and which move it begins. */
#include "minirobot.h"

enum { FAR = INT32_MAX };

static const int32_t step[DIRECTIONS][2] = {
    {1, 0}, {1, 1}, {0, 1}, {-1, 1}, {-1, 0}, {-1, -1}, {0, -1}, {1, -1},
};

static const Robot at_start = {.mode = HOLD, .direction = NO_DIRECTION};

typedef struct {
    int32_t x, y;
} Cell;

/* Squared distance from one's own cell to the nearest other robot, the first of several. */
static int32_t nearest(const Cell cells[ROBOTS], int32_t *which) {
    int32_t least = FAR;
    *which = ROBOT - 1;
    for (int32_t other = 0; other < ROBOTS; other++) {
        const int32_t dx = cells[other].x - cells[ROBOT - 1].x;
        const int32_t dy = cells[other].y - cells[ROBOT - 1].y;
        if (other != ROBOT - 1 && dx * dx + dy * dy < least) {
            least = dx * dx + dy * dy;
            *which = other;
        }
    }
    return least;
}

/* The cells of all robots; false if one is off the board, or where it may not be. */
static bool cells_of(const Position positions[ROBOTS], Cell cells[ROBOTS]) {
    bool allowed = true;
    for (int32_t i = 0; i < ROBOTS; i++) {
        cells[i] = (Cell){rounded_down(positions[i].x / CELL_M),
                          rounded_down(positions[i].y / CELL_M)};
        allowed &= 0 <= cells[i].x && cells[i].x < COLUMNS;
        allowed &= 0 <= cells[i].y && cells[i].y < ROWS;
        for (int32_t k = 0; k < FORBIDDEN; k++) {
            const int32_t *edge = forbidden[i][k]; /* left, bottom, right, top */
            allowed &= cells[i].x < edge[0] || edge[2] <= cells[i].x || cells[i].y < edge[1]
                       || edge[3] <= cells[i].y;
        }
    }
    return allowed;
}

/* The direction that a heading is nearest to; halves go to the even one. */
static int32_t facing(double heading) {
    const double rounding = 0x1.8p52;
    const double eighths = (heading / EIGHTH_RAD + rounding) - rounding;
    return (rounded_down(eighths) % DIRECTIONS + DIRECTIONS) % DIRECTIONS;
}

/* Row of the table for what is seen; features that the table does not have are multiplied by 0. */
static int32_t state_of(const Cell cells[ROBOTS], int32_t squared, int32_t before, int32_t other,
                        int32_t direction) {
    /* Eq. (9) */
    const int32_t distance = squared <= NEAR_SQUARED ? 0 : squared <= MEDIUM_SQUARED ? 1 : 2;
    /* Eq. (10) */
    const int32_t sign = (squared > before) - (squared < before);
    const Cell own = cells[ROBOT - 1];
    int32_t state = own.x * STRIDE_X + own.y * STRIDE_Y + distance * STRIDE_D
                    + (sign + 1) * STRIDE_G + direction % (DIRECTIONS / 2) * STRIDE_H;
    if (other != ROBOT - 1) {
        const int32_t dx = cells[other].x - own.x, dy = cells[other].y - own.y;
        state += bearing(dx, dy) * STRIDE_B + (cells[other].x * ROWS + cells[other].y) * STRIDE_P;
    }
    return state;
}

/* Of the best directions of a state, a bit each, the one of least rotation; then the lower one. */
static int32_t choose(uint8_t best, int32_t towards) {
    for (int32_t turn = 0; turn < DIRECTIONS / 2; turn++) {
        const int32_t left = (towards + turn) % DIRECTIONS;
        const int32_t right = (towards + DIRECTIONS - turn) % DIRECTIONS;
        const int32_t lower = left < right ? left : right, upper = left < right ? right : left;
        if (best >> lower & 1) return lower;
        if (best >> upper & 1) return upper;
    }
    return (towards + DIRECTIONS / 2) % DIRECTIONS;
}

static void begin_move(Robot *robot, Cell own, int32_t direction) {
    const bool goes_on = robot->mode == PAST && direction == robot->direction;
    const int32_t x = own.x + step[direction][0], y = own.y + step[direction][1];
    robot->goal = (Position){(x + 0.5) * CELL_M, (y + 0.5) * CELL_M};
    robot->direction = direction;
    robot->mode = goes_on ? DRIVE : START;
    robot->moving_since = robot->period;
}

void robot_start(Robot *robot, const Position positions[ROBOTS]) {
    Cell cells[ROBOTS];
    int32_t other;
    *robot = at_start;
    cells_of(positions, cells);
    robot->squared = nearest(cells, &other);
}

bool robot_decides(const Robot *robot) { return robot->period % DECISION_PERIODS == 0; }

void robot_decide(Robot *robot, double heading, const Position positions[ROBOTS]) {
    Cell cells[ROBOTS];
    int32_t other;
    const bool allowed = cells_of(positions, cells);
    const Cell own = cells[ROBOT - 1];
    const bool ended = robot->mode == HOLD || robot->mode == PAST;
    const bool moved = robot->direction != NO_DIRECTION;
    robot->arrived |= ended && moved && own.x == TARGET_X && own.y == TARGET_Y;
    const bool late = robot->period - robot->moving_since >= (uint32_t)MOVE_LIMIT_PERIODS;
    if (robot->arrived || !allowed) {
        robot->mode = HOLD;
    } else if (ended || late) {
        const int32_t squared = nearest(cells, &other), towards = facing(heading);
        const int32_t state = state_of(cells, squared, robot->squared, other, towards);
        begin_move(robot, own, choose(best[state], towards));
        robot->squared = squared;
    }
}

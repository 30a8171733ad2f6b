/* Robots are kept apart: cosim/onboard/shield.py and yielding.py in C, which say why. Robots of a page
 * are in one zone, and all of them are looked at. */
#ifndef SHIELD_H
#define SHIELD_H

enum { WAIT = -1, TURNS = 7 };

#define ROUNDING_M 1e-9

typedef struct {
    double reference; /* room when the retreat began, without the error of estimates, m */
    int failures;     /* retreats given up since it had room */
} Kept;

typedef struct {
    double room, deviation; /* m */
    Position out;           /* the way to more room */
} Room;

typedef struct {
    Position from, to;
} Line;

static Kept kept_of[MOST_ROBOTS];
static Random detours;
static int by_target[MOST_ROBOTS]; /* robots in the order of their targets */

static void order_targets(void) {
    for (int i = 0; i < ROBOTS; i++) {
        int k = i;
        const Cell c = target_of(i);
        for (; k > 0; k--) {
            const Cell before = target_of(by_target[k - 1]);
            if (before.x < c.x || (before.x == c.x && before.y < c.y))
                break;
            by_target[k] = by_target[k - 1];
        }
        by_target[k] = i;
    }
}

static Position away_from(const double edge[4], Position at) {
    return (Position){at.x - between(at.x, edge[0], edge[2]), at.y - between(at.y, edge[1], edge[3])};
}

static double stopping_gap(double deviation) {
    const double error = (DEVIATIONS + JITTER) * deviation;
    return 2.0 * STOPPING_M + error + ROOM_M;
}

/* Take a room in place of a larger one. */
static void narrow(Room *least, double room, Position out) {
    if (room < least->room) {
        least->room = room;
        least->out = out;
    }
}

static void narrow_by(Room *least, const double *edges, int count, Position at, double reach,
                      double alone) {
    for (int k = 0; k < count; k++) {
        Position out = away_from(edges + 4 * k, at);
        const double distance = norm(out.x, out.y);
        if (distance == 0.0) /* within: no direction leads away */
            out.x = 1.0;
        narrow(least, distance - reach - alone, out);
    }
}

/* Whether a robot may not enter another's target, unless it is in a zone that no robot may enter. */
static bool is_parking(int robot, int owner) {
    const Cell c = target_of(owner);
    const double *zone = setup.closed_zone;
    return owner != robot && !(zone[0] <= c.x && c.x <= zone[2] && zone[1] <= c.y && c.y <= zone[3]);
}

typedef struct {
    double edges[4]; /* left, bottom, right, top, m */
} Square;

static Square square_of(int robot) {
    const Cell c = target_of(robot);
    return (Square){{c.x * CELL_M, c.y * CELL_M, (c.x + 1) * CELL_M, (c.y + 1) * CELL_M}};
}

static Room room_of(int i, const Known *known) {
    const Position *at = known->at;
    const double x = at[i].x, y = at[i].y, deviation = square_root(known->variances[i]);
    const double alone = STOPPING_M + DEVIATIONS * deviation;
    const int closed = (int)setup.closed;
    Room least = {x - alone, deviation, {1.0, 0.0}};
    narrow(&least, setup.size[0] - x - alone, (Position){-1.0, 0.0});
    narrow(&least, y - alone, (Position){0.0, 1.0});
    narrow(&least, setup.size[1] - y - alone, (Position){0.0, -1.0});
    narrow_by(&least, table.walls, (int)setup.walls, at[i], 0.5 * setup.diameter_m, alone);
    narrow_by(&least, table.closed + 4 * i * closed, closed, at[i], 0.0, alone);
    for (int k = 0; k < ROBOTS; k++)
        if (is_parking(i, by_target[k]))
            narrow_by(&least, square_of(by_target[k]).edges, 1, at[i], 0.0, alone);
    for (int j = 0; j < ROBOTS; j++) {
        if (j == i)
            continue;
        const Position out = {x - at[j].x, y - at[j].y};
        const double of_both = square_root(known->variances[i] + known->variances[j]);
        const double kept = setup.diameter_m + 2.0 * STOPPING_M + DEVIATIONS * of_both;
        const double room = norm(out.x, out.y) - kept;
        if (room < least.room)
            least = (Room){room, of_both, out};
    }
    const double length = norm(least.out.x, least.out.y);
    least.out = (Position){least.out.x / length, least.out.y / length};
    return least;
}

static void retreat(int i, Position at, double heading, double sense) {
    Robot *robot = &robot_of[i];
    const Trig ahead = sine_cosine(heading);
    const int32_t direction = robot->direction = DIRECTIONS + i;
    robot->mode = RETREAT;
    robot->sense = sense;
    robot->goal.x = at.x + sense * RETREAT_M * ahead.cosine;
    robot->goal.y = at.y + sense * RETREAT_M * ahead.sine;
    direction_rad[direction] = sense > 0.0 ? heading : heading + PI;
    const Trig line = sine_cosine(direction_rad[direction]);
    direction_x[direction] = line.cosine;
    direction_y[direction] = line.sine;
}

/* Stop robots that lack room, and let one of them retreat. Once in every control period. */
static void guard(const Known *known) {
    bool retreating = false;
    int chosen = -1;
    double best = -INFINITY, along = 0.0;
    for (int i = 0; i < ROBOTS; i++) {
        Robot *robot = &robot_of[i];
        Kept *kept = &kept_of[i];
        const Room found = room_of(i, known);
        const double jitter = JITTER * found.deviation;
        const double clear = found.room + DEVIATIONS * found.deviation;
        if (found.room >= ROOM_M + jitter) {
            kept->failures = 0;
            retreating |= robot->mode == RETREAT;
            continue;
        }
        if (robot->mode == RETREAT) {
            const bool lost = clear < kept->reference - LOSS_M - jitter;
            if (found.room >= 0.0 && !lost) {
                retreating = true;
                continue;
            }
            kept->failures += lost;
        }
        robot->mode = HOLD;
        if (found.room < 0.0 || robot->arrived)
            continue;
        const Trig ahead = sine_cosine(known->headings[i]);
        const double cosine = ahead.cosine * found.out.x + ahead.sine * found.out.y;
        const double merit = size(cosine) - 2.0 * kept->failures;
        if (merit >= best) {
            chosen = i;
            best = merit;
            along = cosine;
            kept->reference = clear;
        }
    }
    if (chosen >= 0 && !retreating) {
        const double sense = along >= 0.0 ? 1.0 : -1.0;
        const bool other = kept_of[chosen].failures % 2 == 1;
        retreat(chosen, known->at[chosen], known->headings[chosen], other ? -sense : sense);
    }
}

static double length_of(Line line) {
    const double x = line.to.x - line.from.x, y = line.to.y - line.from.y;
    return norm(x, y);
}

static double point_to_line(Position point, Line line) {
    double x = line.from.x, y = line.from.y;
    const double along_x = line.to.x - x, along_y = line.to.y - y;
    const double length = along_x * along_x + along_y * along_y;
    if (length > 0.0) {
        const double share = between(
            ((point.x - x) * along_x + (point.y - y) * along_y) / length, 0.0, 1.0);
        x += share * along_x;
        y += share * along_y;
    }
    return norm(point.x - x, point.y - y);
}

/* Whether the ends of b lie on both sides of the line through a. */
static bool crosses(Line a, Line b) {
    const double x = a.to.x - a.from.x, y = a.to.y - a.from.y;
    const double first = x * (b.from.y - a.from.y) - y * (b.from.x - a.from.x);
    const double second = x * (b.to.y - a.from.y) - y * (b.to.x - a.from.x);
    return first * second < 0.0;
}

static double line_to_line(Line a, Line b) {
    if (crosses(a, b) && crosses(b, a))
        return 0.0;
    return least(least(point_to_line(a.from, b), point_to_line(a.to, b)),
                 least(point_to_line(b.from, a), point_to_line(b.to, a)));
}

static bool too_close(Line plan, Line other, double least_m) {
    return line_to_line(plan, other) < least(least_m, point_to_line(plan.from, other)) - ROUNDING_M;
}

static bool meets(const double *edges, int count, Line plan, double least_m) {
    const double reach = length_of(plan) + least_m;
    for (const double *e = edges; e < edges + 4 * count; e += 4) {
        const Position d = away_from(e, plan.from);
        if (d.x * d.x + d.y * d.y > reach * reach)
            continue;
        const Position corners[] = {{e[0], e[1]}, {e[2], e[1]}, {e[2], e[3]}, {e[0], e[3]}};
        for (int side = 0; side < 4; side++)
            if (too_close(plan, (Line){corners[side], corners[(side + 1) % 4]}, least_m))
                return true;
    }
    return false;
}

/* Whether a plan keeps off obstacles and targets of others. */
static bool is_open(int robot, Line plan, double margin) {
    const int closed = (int)setup.closed;
    if (meets(table.walls, (int)setup.walls, plan, 0.5 * setup.diameter_m + margin) ||
        meets(table.closed + 4 * robot * closed, closed, plan, margin))
        return false;
    for (int k = 0; k < ROBOTS; k++)
        if (is_parking(robot, k) && meets(square_of(k).edges, 1, plan, margin))
            return false;
    return true;
}

/* The direction that a robot may take when it wants another, by turns that are tried after it. */
static int32_t permitted(const Position at[], int robot, int32_t wanted, double margin,
                         const int32_t turns[TURNS]) {
    for (int k = 0; k <= TURNS; k++) {
        const int32_t direction = (wanted + (k ? turns[k - 1] : 0) + DIRECTIONS) % DIRECTIONS;
        const int32_t column = rounded_down(at[robot].x / CELL_M) + step[direction][0];
        const int32_t row = rounded_down(at[robot].y / CELL_M) + step[direction][1];
        const Line plan = {at[robot], {(column + 0.5) * CELL_M, (row + 0.5) * CELL_M}};
        bool free = true, by_moving = false;
        if (column < 0 || column >= COLUMNS || row < 0 || row >= ROWS ||
            !is_open(robot, plan, margin))
            continue;
        const double least_m = setup.diameter_m + margin;
        for (int j = 0; j < ROBOTS; j++) {
            const bool stands = robot_of[j].mode == HOLD;
            const Line others = {at[j], stands ? at[j] : robot_of[j].goal};
            const double apart =
                length_of((Line){at[robot], at[j]}) - length_of(plan) - length_of(others);
            if (j != robot && apart <= least_m && too_close(plan, others, least_m)) {
                free = false;
                by_moving |= !stands;
            }
        }
        if (free)
            return direction;
        if (k == 0 && by_moving)
            return WAIT;
    }
    return WAIT;
}

/* The direction that the shield permits in place of one; WAIT to stand. */
static int32_t yielded(const Known *known, int robot, int32_t wanted) {
    int32_t turns[TURNS] = {1, -1, 2, -2, 3, -3, 4};
    double largest = 0.0, second = 0.0;
    for (int i = 0; i < ROBOTS; i++) {
        const double smaller = least(largest, known->variances[i]);
        second = smaller > second ? smaller : second;
        largest = known->variances[i] > largest ? known->variances[i] : largest;
    }
    const double margin = stopping_gap(square_root(largest + second)) + STRAY_M;
    const int32_t allowed = permitted(known->at, robot, wanted, margin, turns);
    if (allowed == wanted || allowed == WAIT || next_double(&detours) >= 0.5)
        return allowed;
    for (int k = TURNS - 1; k > 0; k--) { /* as numpy shuffles */
        uint32_t other;
        do
            other = next_half(&detours) & (uint32_t)(k | k >> 1 | k >> 2);
        while (other > (uint32_t)k);
        const int32_t turn = turns[k];
        turns[k] = turns[other];
        turns[other] = turn;
    }
    return permitted(known->at, robot, wanted, margin, turns);
}

#endif

/* What two robots together do best: `pair_values` of agent/moves/pair.py in C, which says why. */
#ifndef PAIR_H
#define PAIR_H

enum { AXES = DIRECTIONS / 2, BLOCKED = -1, UNREACHABLE = UINT16_MAX, FAR_CELLS = 75 };

#define KEPT_CELLS 34.0
#define GRAIN_S 0.0625
#define IMPOSSIBLE -1.0e6

/* Column and row of the way from one cell to another. */
static Cell way(int32_t from, int32_t to) {
    return (Cell){to / ROWS - from / ROWS, to % ROWS - from % ROWS};
}

static int32_t squared_way(int32_t p, int32_t q) {
    const Cell d = way(p, q);
    return d.x * d.x + d.y * d.y;
}

/* Least squared distance in cells^2 of robots that move from cells p and q at once. */
static double nearest_way(int32_t p, int32_t q, int32_t p_after, int32_t q_after) {
    const Cell d = way(q, p), ended = way(q_after, p_after);
    const int32_t along_x = ended.x - d.x, along_y = ended.y - d.y;
    const int32_t length = along_x * along_x + along_y * along_y;
    double share = (double)-(d.x * along_x + d.y * along_y) / (double)(length > 1 ? length : 1);
    share = share > 0.0 ? share : 0.0;
    share = share < 1.0 ? share : 1.0;
    const double x = d.x + share * along_x, y = d.y + share * along_y;
    return x * x + y * y;
}

static bool keeps_apart(int32_t p, int32_t q, int32_t p_after, int32_t q_after) {
    const int32_t before = squared_way(p, q), ended = squared_way(p_after, q_after);
    if ((before < ended ? before : ended) >= FAR_CELLS)
        return true;
    if (ended < KEPT_CELLS && ended <= before)
        return false;
    return nearest_way(p, q, p_after, q_after) >=
           (KEPT_CELLS < before ? KEPT_CELLS : (double)before) - 1e-9;
}

static int32_t after(int robot, int32_t cell, int move) {
    return table.after[(robot * COLUMNS * ROWS + cell) * DIRECTIONS + move];
}

static double alone(int robot, int32_t cell, int32_t axis) {
    return table.alone[(robot * COLUMNS * ROWS + cell) * AXES + axis];
}

static int32_t axis_towards(int32_t cell, int32_t goal) {
    const Cell d = way(cell, goal);
    return d.y == 0 ? 0 : d.x == 0 ? 2 : d.x * d.y > 0 ? 1 : 3;
}

static double time_of(int32_t p, int32_t axis, int32_t q, int32_t other) {
    const size_t cells = (size_t)COLUMNS * (size_t)ROWS;
    const size_t first = (size_t)p * AXES + axis, second = (size_t)q * AXES + other;
    const uint16_t delay = (uint16_t)(table.delay[first * cells * AXES + second] +
                                      table.first[first] + table.first[cells * AXES + second]);
    return delay == UNREACHABLE ? INFINITY : alone(0, p, axis) + alone(1, q, other) + GRAIN_S * delay;
}

static void raise_to(float *value, float to) { *value = to > *value ? to : *value; }

/* Minus the time in s of both robots for each move of each, if the other one does what is best;
 * cells and goals are counted x * ROWS + y. */
static void pair_values(const int32_t at[2], const int32_t goals[2], const int32_t axes[2],
                        float values[2][DIRECTIONS]) {
    bool driven[2], stays[2];
    int choices[2], best_moves[2] = {-1, -1};
    double least = INFINITY;
    int32_t farthest = -1;
    for (int i = 0; i < 2; i++) {
        driven[i] = goals[i] != at[i];
        choices[i] = driven[i] || after(i, at[i], 0) == at[i] ? 1 : DIRECTIONS;
        stays[i] = choices[i] == 1;
        for (int k = 0; k < DIRECTIONS; k++)
            values[i][k] = (float)IMPOSSIBLE;
    }
    const int32_t p = at[0], q = at[1];
    for (int a = 0; a < choices[0]; a++) {
        const int32_t p_after = driven[0] ? goals[0] : after(0, p, a);
        if (p_after == BLOCKED)
            continue;
        const int32_t p_axis = driven[0] ? axis_towards(p, p_after) : a % AXES;
        for (int b = 0; b < choices[1]; b++) {
            const int32_t q_after = driven[1] ? goals[1] : after(1, q, b);
            if (q_after == BLOCKED)
                continue;
            if (!keeps_apart(p, q, p_after, q_after) ||
                (driven[1] && !keeps_apart(p, q_after, p_after, q_after)) ||
                (driven[0] && !keeps_apart(p_after, q, p_after, q_after))) {
                const float near = (float)(IMPOSSIBLE + nearest_way(p, q, p_after, q_after));
                raise_to(&values[0][a], near);
                raise_to(&values[1][b], near);
                continue;
            }
            const int32_t q_axis = driven[1] ? axis_towards(q, q_after) : b % AXES;
            const double time = (stays[0] ? 0.0 : table.seconds[a * AXES + axes[0]]) +
                                (stays[1] ? 0.0 : table.seconds[b * AXES + axes[1]]) +
                                time_of(p_after, p_axis, q_after, q_axis);
            if (time == INFINITY)
                continue;
            raise_to(&values[0][a], (float)-time);
            raise_to(&values[1][b], (float)-time);
            const int32_t squared = squared_way(p_after, q_after);
            if (time < least - GRAIN_S || (time <= least + GRAIN_S && squared > farthest)) {
                least = time < least ? time : least;
                best_moves[0] = a;
                best_moves[1] = b;
                farthest = squared;
            }
        }
    }
    for (int i = 0; i < 2; i++) {
        float *mine = values[i];
        if (best_moves[0] >= 0) {
            mine[best_moves[i]] = largest_of(mine) + (float)GRAIN_S;
        }
        for (int k = 1; driven[i] && k < DIRECTIONS; k++)
            mine[k] = mine[0];
    }
}

#endif

/* Q-learning of Section III in plain C: the yardstick for the numba kernels, in bits and in speed.
 *
 * Written from the paper and the interpretations of docs/paper.md, not from the kernels: one or two
 * robots on a square board, features x, y, d, g, Eq. (7) to (12), nothing configurable beyond
 * what the built-in scenarios need. Compile with -O3 -ffp-contract=off.
 */
#include <math.h>
#include <stdint.h>

#define SIZE 30
#define ACTIONS 8
#define STATES (SIZE * SIZE * 9)
#define LIMIT 1000  /* moves per episode */
#define CONTACT 25  /* cells^2 */
#define NEAR 36
#define MEDIUM 100
#define REACH 10.0  /* D of Eq. (11), cells */
#define ALONE (1 << 30)

typedef struct {
    int x, y;
} cell;

enum status { MOVING, ARRIVED, FAILED };

static const cell DIRECTION[ACTIONS] = {{1, 0},  {1, 1},   {0, 1},  {-1, 1},
                                        {-1, 0}, {-1, -1}, {0, -1}, {1, -1}};

static inline uint64_t next_word(uint64_t *state) {
    uint64_t z = *state += UINT64_C(0x9E3779B97F4A7C15);
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

static inline int next_index(uint64_t *state, uint64_t count) {
    return (int)(((next_word(state) >> 32) * count) >> 32);
}

static inline int state_of(cell at, int squared, int sign) {
    int distance = squared <= NEAR ? 0 : squared <= MEDIUM ? 1 : 2;     /* Eq. (9) */
    return ((at.x * SIZE + at.y) * 3 + distance) * 3 + sign + 1;
}

static inline int best(const float *values) {
    int action = 0;
    for (int k = 1; k < ACTIONS; k++)
        if (values[k] > values[action]) action = k;
    return action;
}

static inline int squared_distance(const cell *at, int robots) {
    if (robots == 1) return ALONE;
    int dx = at[1].x - at[0].x, dy = at[1].y - at[0].y;
    return dx * dx + dy * dy;
}

/* One episode; q[robots][STATES][ACTIONS], visits[robots][STATES], starts[robots][count[robot]].
 * Inlined into `train` once for one robot and once for two. Returns the agent steps. */
static inline int64_t episode(int robots, const cell *target, const cell *const *starts,
                              const int64_t *count, float eta, float gamma, float L, double c,
                              uint64_t threshold, float *q, uint32_t *visits, uint64_t *random) {
    cell at[2];
    int state[2], greedy[2], squared;
    enum status status[2] = {MOVING, MOVING};
    do {
        for (int i = 0; i < robots; i++) at[i] = starts[i][next_index(random, count[i])];
        squared = squared_distance(at, robots);
    } while (squared <= CONTACT);
    for (int i = 0; i < robots; i++) {
        state[i] = state_of(at[i], squared, 0);
        greedy[i] = best(q + (i * STATES + state[i]) * ACTIONS);
    }
    int64_t steps = 0;
    for (int step = 0; step < LIMIT; step++) {
        int action[2], moved[2], failed = 0, arrived = 0;
        for (int i = 0; i < robots; i++) {
            moved[i] = status[i] == MOVING;
            if (!moved[i]) continue;
            action[i] = greedy[i];
            if (threshold) {
                uint64_t word = next_word(random);
                if (word >> 11 < threshold) action[i] = word & (ACTIONS - 1);
            }
            at[i].x += DIRECTION[action[i]].x;
            at[i].y += DIRECTION[action[i]].y;
        }
        int before = squared;
        squared = squared_distance(at, robots);
        int sign = (squared > before) - (squared < before);            /* Eq. (10) */
        double b = sign < 0 ? c : 1.0;                                 /* Eq. (12) */
        double reach = squared < REACH * REACH ? sqrt(squared) : REACH;
        float passing = (float)(-b * (1.0 - reach / REACH) - 1.0);     /* Eq. (11) */
        for (int i = 0; i < robots; i++) {
            if (!moved[i]) continue;
            steps++;
            visits[i * STATES + state[i]]++;
            float *value = q + (i * STATES + state[i]) * ACTIONS + action[i];
            float goal;
            if (at[i].x < 0 || at[i].x >= SIZE || at[i].y < 0 || at[i].y >= SIZE ||
                squared <= CONTACT ||
                (robots == 2 && at[i].x == target[1 - i].x && at[i].y == target[1 - i].y)) {
                status[i] = FAILED;
                failed = 1;
                goal = -L;
            } else if (at[i].x == target[i].x && at[i].y == target[i].y) {
                status[i] = ARRIVED;
                goal = L;
            } else {
                state[i] = state_of(at[i], squared, sign);
                const float *row = q + (i * STATES + state[i]) * ACTIONS;
                greedy[i] = best(row);
                goal = passing + gamma * row[greedy[i]];
            }
            *value += eta * (goal - *value);                           /* Eq. (7) */
        }
        for (int i = 0; i < robots; i++) arrived += status[i] == ARRIVED;
        if (failed || arrived == robots) break;
    }
    return steps;
}

/* Train over episodes [first, last); thresholds[k] is the exploration threshold (of 2^53) of the
 * episodes [k * block, (k + 1) * block). Returns the agent steps. */
int64_t train(int64_t robots, const cell *target, const cell *first_starts, int64_t first_count,
              const cell *second_starts, int64_t second_count, float eta, float gamma, float L,
              double c, const uint64_t *thresholds, int64_t block, float *q, uint32_t *visits,
              uint64_t *random, int64_t first, int64_t last) {
    const cell *starts[2] = {first_starts, second_starts};
    const int64_t count[2] = {first_count, second_count};
    int64_t steps = 0;
    for (int64_t k = first; k < last; k++)
        steps += robots == 1 ? episode(1, target, starts, count, eta, gamma, L, c,
                                       thresholds[k / block], q, visits, random)
                             : episode(2, target, starts, count, eta, gamma, L, c,
                                       thresholds[k / block], q, visits, random);
    return steps;
}

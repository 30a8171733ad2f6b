/* What the network that all robots share says of their moves: agent/deep/inputs.py and policy.py in C,
 * with the same order of sums. */
#ifndef NETWORK_H
#define NETWORK_H

#include <string.h>

enum { GROUPS = 9, GROUPS_ALONE = 5 };

static void add_row(float total[], int size, float factor, const float row[]) {
    for (int j = 0; j < size; j++)
        total[j] += factor * row[j];
}

/* Totals of a layer after the rectifier, from its biases, which follow its weights; the next layer. */
static const float *add_layer(const float from[], int size, const float *weights, float total[],
                              int count) {
    memcpy(total, weights + size * count, (size_t)count * sizeof *total);
    for (int k = 0; k < size; k++)
        if (from[k] > 0.0f)
            add_row(total, count, from[k], weights + k * count);
    return weights + (size + 1) * count;
}

/* Whether a move of the present robot leads neither off the board nor into an obstacle, such as the
 * target of another. */
static bool is_possible(Cell own, int move) {
    const bool open = table.possible[((ROBOT - 1) * COLUMNS + own.x) * ROWS + own.y] >> move & 1;
    const Cell after = {own.x + step[move][0], own.y + step[move][1]};
    bool parking = false;
    for (int k = 0; k < ROBOTS && setup.any_target != 0.0; k++)
        parking |= k != ROBOT - 1 && is_same(after, target_of(k));
    return (open && !parking) || is_same(own, target_of(ROBOT - 1));
}

/* Values of the present robot's moves; impossible ones are worth 1 less than the worst of the others. */
static void network_values(const Cell cells[ROBOTS], float values[DIRECTIONS]) {
    int32_t which;
    nearest(cells, &which);
    const Cell own = cells[ROBOT - 1], goal = target_of(ROBOT - 1);
    const Cell other = cells[which], its = target_of(which);
    const struct {
        int32_t seen, reach, size; /* the reach is that of both sides of an offset */
    } groups[GROUPS] = {
        {ROBOT - 1, 0, ROBOTS},        {own.x, 0, COLUMNS},            {own.y, 0, ROWS},
        {own.x - goal.x, 10, 21},      {own.y - goal.y, 10, 21},       {other.x - own.x, 10, 21},
        {other.y - own.y, 10, 21},     {other.x - its.x, 2, 5},        {other.y - its.y, 2, 5},
    };
    const int hidden = (int)setup.hidden;
    float first[MOST_HIDDEN] = {0}, second[MOST_HIDDEN];
    const float *weights = table.network, *row = weights;
    for (int k = 0; k < GROUPS; k++)
        weights += groups[k].size * hidden;
    memcpy(first, weights, (size_t)hidden * sizeof *first);
    for (int k = 0; k < (ROBOTS > 1 ? GROUPS : GROUPS_ALONE); row += groups[k++].size * hidden) {
        const int32_t reach = groups[k].reach, seen = groups[k].seen;
        const int32_t place = reach ? (int32_t)between(seen, -reach, reach) + reach : seen;
        add_row(first, hidden, 1.0f, row + place * hidden);
    }
    weights = add_layer(first, hidden, weights + hidden, second, hidden);
    add_layer(second, hidden, weights, values, DIRECTIONS);

    float worst = largest_of(values);
    for (int k = 0; k < DIRECTIONS; k++)
        worst = is_possible(own, k) && values[k] < worst ? values[k] : worst;
    for (int k = 0; k < DIRECTIONS; k++)
        values[k] = is_possible(own, k) ? values[k] : worst - 1.0f;
}

#endif

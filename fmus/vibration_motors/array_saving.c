/* See instance.h: saved and serialised states of an array of motors. */
#include "array.h"

/* A saved state is this, SAVED_ROWS rows of n doubles, and `restart` and `restarted` of n integers.
 * Samples are of a step, not of a state. */
typedef struct {
    Standing now;
    double step_size;
    uint64_t n;
    int64_t closed_loop;
    uint64_t samples;
} Head;

/* Equal states are equal bytes, so that importers can compare them. */
_Static_assert(sizeof(Head) == 8 * sizeof(double), "no padding");

static size_t state_size(uint64_t n) {
    return sizeof(Head) + (size_t)n * (SAVED_ROWS * sizeof(double) + 2 * sizeof(int64_t));
}

size_t model_state_size(const void *state) { return state_size(((const Head *)state)->n); }

Status model_save(const Instance *instance, const char *function, void **state) {
    const Motors *motors = motors_in(instance);
    const size_t n = motors->n;
    Head *head = realloc(*state, state_size(n));
    if (!head)
        return fail(instance, function, "out of memory");
    *head = (Head){instance->now, motors->step_size, n, motors->closed_loop, motors->samples};
    double *values = (double *)(head + 1);
    for (size_t row = 0; row < SAVED_ROWS; row++, values += n)
        motors_read(motors, row, values);
    int64_t *counters = (int64_t *)values;
    for (size_t k = 0; k < n; k++) {
        counters[k] = motors->blocks[k / LANES].restart[k % LANES];
        counters[n + k] = motors->blocks[k / LANES].restarted[k % LANES];
    }
    *state = head;
    return STATUS_OK;
}

Status model_restore(Instance *instance, const char *function, const void *state) {
    Motors *motors = motors_of(instance);
    const Head *head = state;
    const size_t n = (size_t)head->n;
    if ((n != motors->n || head->samples != motors->samples) &&
        motors_allocate(motors, function, n, head->samples) != STATUS_OK)
        return STATUS_ERROR;
    instance->now = head->now;
    motors->step_size = head->step_size;
    motors->closed_loop = head->closed_loop != 0;
    const double *values = (const double *)(head + 1);
    for (size_t row = 0; row < SAVED_ROWS; row++, values += n)
        motors_write(motors, row, values);
    const int64_t *counters = (const int64_t *)values;
    for (size_t k = 0; k < n; k++) {
        motors->blocks[k / LANES].restart[k % LANES] = counters[k];
        motors->blocks[k / LANES].restarted[k % LANES] = counters[n + k];
    }
    motors->restarting = true;
    motors_tune(motors);
    return STATUS_OK;
}

/* Bytes from outside must not bring about a state that no sequence of calls could. */
static bool is_sound(const Head *head) {
    const size_t n = (size_t)head->n;
    const double *values = (const double *)(head + 1);
    const double *least = parameter_min, *most = parameter_max;
    const size_t step_size = VR_step_size - PARAMETER_FIRST;
    if (!(within(&head->step_size, 1, least + step_size, most + step_size) &&
          (head->closed_loop == 0 || head->closed_loop == 1) &&
          is_standing(&head->now, head->step_size)))
        return false;
    for (size_t row = 0; row < SAVED_ROWS; row++) {
        const bool limited = row - ROW_PARAMETER < MOTOR_PARAMETER_COUNT;
        const size_t parameter = limited ? row - ROW_PARAMETER : 0;
        for (size_t k = 0; k < n; k++)
            if (!within(&values[row * n + k], 1, limited ? least + parameter : NULL,
                        limited ? most + parameter : NULL))
                return false;
    }
    return true;
}

Status model_deserialize(const Instance *instance, const char *function,
                         const unsigned char bytes[], size_t size, void **state) {
    Head head;
    if (size < sealed_size(sizeof head))
        return fail(instance, function, "%lu bytes, but a state has more", (unsigned long)size);
    const unsigned char *content = unseal(instance, function, bytes, size);
    if (!content)
        return STATUS_ERROR;
    memcpy(&head, content, sizeof head);
    void *copy = NULL;
    if (head.n >= LEAST_n && head.n <= MOST_n && head.samples >= LEAST_samples &&
        head.samples <= MOST_samples && size == sealed_size(state_size(head.n))) {
        copy = malloc(state_size(head.n));
        if (!copy)
            return fail(instance, function, "out of memory");
        memcpy(copy, content, state_size(head.n));
    }
    if (!copy || !is_sound(copy)) {
        free(copy);
        return fail(instance, function, "the state holds values that are out of range");
    }
    free(*state);
    *state = copy;
    return STATUS_OK;
}

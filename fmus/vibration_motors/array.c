/* See instance.h: an array of n motors, with restarts and samples; its memory, life cycle, steps,
 * access to variables by value reference, and saved and serialised states. */
#include "instance.h"
#include "levels.h"
#include "stability.h"

typedef struct {
    Instance base;
    size_t n;
    double step_size;
    int32_t closed_loop;
    bool restarting; /* whether some motor's restart may not be the one of its last step */
    Level level;
    Block *blocks; /* of motors 0 to 7, 8 to 15, ... */
    void *memory;  /* that the blocks are in, and the samples behind them */
    size_t
        samples; /* parts of a step whose outputs are kept; with 1 they are the present outputs */
    double *sampled; /* theta, omega and omega_dot at the ends of the parts of the last step, a row
                        of motors for each; NULL with 1 */
} Motors;

static inline Motors *motors_of(Instance *instance) { return (Motors *)instance; }

static inline const Motors *motors_in(const Instance *instance) { return (const Motors *)instance; }

static inline size_t block_count(size_t n) { return (n + LANES - 1) / LANES; }

/* How many of a block's lanes hold motors. */
static inline size_t lane_count(const Motors *motors, size_t block) {
    const size_t left = motors->n - LANES * block;
    return left < LANES ? left : LANES;
}

/* Numbers in a row of samples. */
static inline size_t sample_stride(size_t n) {
    return n <= LANES / 2 ? LANES / 2 : LANES * block_count(n);
}

static const size_t model_size = sizeof(Motors);

/* Put states and inputs into force. */
static void motors_refresh(Motors *motors) {
    const Work work = {.block_count = block_count(motors->n), .closed_loop = motors->closed_loop};
    motors->level.refresh(motors->blocks, &work);
}

/* Put parameters, states and inputs into force. */
static void motors_tune(Motors *motors) {
    for (Block *b = motors->blocks; b < motors->blocks + block_count(motors->n); b++)
        for (size_t k = 0; k < LANES; k++) {
            MotorConstants p = lane_constants(b, k, motors->closed_loop);
            motor_derive(&p);
            b->row[ROW_TORQUE_PER_VOLT][k] = p.torque_per_volt;
            b->row[ROW_DAMPING][k] = p.damping;
            b->row[ROW_WEIGHT_TORQUE][k] = p.weight_torque;
            b->row[ROW_INVERSE_J][k] = p.inverse_J;
        }
    motors_refresh(motors);
}

/* Put all states to their start, and parameters, states and inputs into force. */
static void motors_initialise(Motors *motors) {
    for (Block *b = motors->blocks; b < motors->blocks + block_count(motors->n); b++)
        for (size_t k = 0; k < LANES; k++) {
            const MotorConstants p = lane_constants(b, k, motors->closed_loop);
            const MotorState start = motor_start(&p);
            b->row[ROW_THETA][k] = start.theta;
            b->row[ROW_OMEGA][k] = start.omega;
            b->row[ROW_INTEGRAL][k] = start.integral;
        }
    motors_tune(motors);
}

/* Have n motors with start values in place of those there are, and room for samples; may be out of
 * memory. */
static Status motors_allocate(Motors *motors, const char *function, uint64_t n, uint64_t samples) {
    const size_t count = block_count((size_t)n);
    const uint64_t kept = samples > 1 ? SAMPLED * samples * sample_stride((size_t)n) : 0;
    const uint64_t size = count * sizeof(Block) + BLOCK_ALIGNMENT - 1 + kept * sizeof(double);
    void *memory = size <= SIZE_MAX ? calloc(1, (size_t)size) : NULL;
    if (!memory)
        return fail(&motors->base, function, "out of memory");
    free(motors->memory);
    motors->memory = memory;
    const uintptr_t first = (uintptr_t)memory + BLOCK_ALIGNMENT - 1;
    motors->blocks = (Block *)(first - first % BLOCK_ALIGNMENT);
    motors->n = (size_t)n;
    motors->samples = (size_t)samples;
    motors->sampled = kept ? (double *)(motors->blocks + count) : NULL;
    motors->restarting = false;
    for (Block *b = motors->blocks; b < motors->blocks + count; b++)
        for (size_t k = 0; k < LANES; k++) {
            for (size_t j = 0; j < INPUT_COUNT; j++)
                b->row[ROW_INPUT + j][k] = input_start[j];
            for (size_t j = 0; j < MOTOR_PARAMETER_COUNT; j++)
                b->row[ROW_PARAMETER + j][k] = parameter_start[j];
        }
    motors_initialise(motors);
    return STATUS_OK;
}

/* Copy a row of n values. */
static void motors_read(const Motors *motors, size_t row, double values[]) {
    const Block *b = motors->blocks;
    size_t left = motors->n;
    for (; left >= LANES; b++, values += LANES, left -= LANES)
        memcpy(values, b->row[row], LANES * sizeof *values);
    /* Fixed sizes need no call of the C library. */
    for (size_t part = LANES / 2, k = 0; part > 0; part /= 2)
        if (left & part) {
            memcpy(values + k, b->row[row] + k, part * sizeof *values);
            k += part;
        }
}

static void motors_write(Motors *motors, size_t row, const double values[]) {
    for (size_t k = 0; k < block_count(motors->n); k++, values += LANES)
        memcpy(motors->blocks[k].row[row], values, lane_count(motors, k) * sizeof *values);
}

Status model_reset(Instance *instance, const char *function) {
    Motors *motors = motors_of(instance);
    const Motors before = *motors;
    motors->level = choose_level();
    motors->step_size = parameter_start[VR_step_size - PARAMETER_FIRST];
    motors->closed_loop = START_closed_loop;
    if (motors_allocate(motors, function, START_n, START_samples) == STATUS_OK)
        return STATUS_OK;
    *motors = before;
    return STATUS_ERROR;
}

void model_release(Instance *instance) { free(motors_of(instance)->memory); }

/* Undo a step in which a motor grew beyond all bounds, and say which. */
static Status undo_step(Motors *motors, const char *function, double time) {
    char whose[40] = "";
    for (size_t k = motors->n; k-- > 0;)
        if (!motor_is_bounded(lane_state(&motors->blocks[k / LANES], k % LANES)))
            snprintf(whose, sizeof whose, " of motor %lu", (unsigned long)k + 1);
    for (Block *b = motors->blocks; b < motors->blocks + block_count(motors->n); b++)
        memcpy(b->row[ROW_INTEGRAL], b->row[ROW_BEFORE], 3 * sizeof *b->row);
    motors_refresh(motors);
    return fail_growth(&motors->base, function, whose, time, motors->step_size);
}

Status model_do_step(Instance *instance, const char *function, double time, double step_size) {
    Motors *motors = motors_of(instance);
    Plan plan;
    if (plan_step(instance, function, time, step_size, motors->step_size, &plan) != STATUS_OK)
        return STATUS_ERROR;
    const int64_t samples = (int64_t)motors->samples;
    if (samples > 1 && (plan.rest > 0.0 || plan.steps % samples != 0))
        return fail(
            instance, function,
            "the step of %g s cannot be made of %lu equal parts, each of whole internal steps "
            "of %g s; change samples or step_size",
            step_size, (unsigned long)samples, motors->step_size);
    const size_t count = block_count(motors->n);
    const Work work = {.block_count = count,
                       .few = motors->n <= LANES / 2,
                       .closed_loop = motors->closed_loop,
                       .restarting = motors->restarting,
                       .samples = motors->samples,
                       .sampled = motors->sampled,
                       .stride = sample_stride(motors->n),
                       .steps = plan.steps / samples,
                       .step_size = motors->step_size,
                       .rest = plan.rest};
    if (!motors->level.step(motors->blocks, &work))
        return undo_step(motors, function, time);
    if (motors->restarting)
        for (Block *b = motors->blocks; b < motors->blocks + count; b++)
            memcpy(b->restarted, b->restart, sizeof b->restart);
    motors->restarting = false;
    instance->now.time = time + step_size;
    instance->now.owed = plan.owed;
    return STATUS_OK;
}

/* Where a block keeps a variable; ROW_COUNT if it does not. */
static inline size_t row_of(uint32_t reference) {
    if (reference - VR_theta <= VR_omega_dot - VR_theta)
        return ROW_THETA + (reference - VR_theta);
    if (reference - INPUT_FIRST < INPUT_COUNT)
        return ROW_INPUT + (reference - INPUT_FIRST);
    if (reference - PARAMETER_FIRST < MOTOR_PARAMETER_COUNT)
        return ROW_PARAMETER + (reference - PARAMETER_FIRST);
    return reference == VR_integral ? ROW_INTEGRAL : ROW_COUNT;
}

_Static_assert(VR_omega_dot - VR_theta == ROW_OMEGA_DOT - ROW_THETA, "rows as variables");

static inline bool is_sampled(uint32_t reference) { return reference - VR_theta_samples < SAMPLED; }

/* How many values a variable has. */
static inline size_t length_of(const Motors *motors, uint32_t reference) {
    if (reference == VR_time || reference == VR_step_size)
        return 1;
    return is_sampled(reference) ? motors->samples * motors->n : motors->n;
}

static void read_samples(const Motors *motors, size_t output, double values[]) {
    const size_t n = motors->n, stride = sample_stride(n);
    const double *row = motors->sampled + output * motors->samples * stride;
    if (motors->samples == 1)
        motors_read(motors, ROW_THETA + output, values);
    else if (n == stride)
        memcpy(values, row, motors->samples * n * sizeof *values);
    else
        for (size_t part = 0; part < motors->samples; part++, row += stride, values += n)
            memcpy(values, row, n * sizeof *values);
}

static inline double electrical(const Motors *motors, size_t k, uint32_t reference) {
    const Block *b = &motors->blocks[k / LANES];
    const MotorInputs in = lane_inputs(b, k % LANES);
    const MotorConstants p = lane_constants(b, k % LANES, motors->closed_loop);
    const MotorState x = lane_state(b, k % LANES);
    const double u = motor_command(&p, &in, x.omega, x.integral), V_s = motor_saturate(&p, u);
    return reference == VR_u ? u : reference == VR_i ? motor_current(&p, x.omega, V_s) : V_s;
}

static bool read_doubles(const Motors *motors, uint32_t reference, double values[]) {
    const size_t row = row_of(reference);
    if (row < ROW_COUNT)
        motors_read(motors, row, values);
    else if (is_sampled(reference))
        read_samples(motors, reference - VR_theta_samples, values);
    else if (reference == VR_V_s || reference == VR_i || reference == VR_u)
        for (size_t k = 0; k < motors->n; k++)
            values[k] = electrical(motors, k, reference);
    else if (reference == VR_time)
        *values = motors->base.now.time;
    else if (reference == VR_step_size)
        *values = motors->step_size;
    else
        return false;
    return true;
}

/* Whether the arrays of a call go together; says why not. */
static Status check_arrays(const Motors *motors, const char *function, const uint32_t references[],
                           size_t count, const void *values, size_t value_count) {
    if (count && (!references || !values))
        return fail_arrays(&motors->base, function);
    size_t wanted = 0;
    for (size_t k = 0; k < count; k++)
        wanted += length_of(motors, references[k]);
    if (wanted != value_count)
        return fail(&motors->base, function, "%lu values, but the variables have %lu",
                    (unsigned long)value_count, (unsigned long)wanted);
    return STATUS_OK;
}

Status model_get_double(const Instance *instance, const char *function, const uint32_t references[],
                        size_t count, double values[], size_t value_count) {
    const Motors *motors = motors_in(instance);
    if (check_arrays(motors, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++) {
        if (!read_doubles(motors, references[k], values))
            return fail_reference(instance, function, references[k], "floating-point variable");
        values += length_of(motors, references[k]);
    }
    return STATUS_OK;
}

Status model_set_double(Instance *instance, const char *function, const uint32_t references[],
                        size_t count, const double values[], size_t value_count) {
    Motors *motors = motors_of(instance);
    if (check_arrays(motors, function, references, count, values, value_count) != STATUS_OK)
        return STATUS_ERROR;
    bool only_inputs = true;
    const double *value = values;
    for (size_t k = 0; k < count; k++) {
        const bool is_input = references[k] - INPUT_FIRST < INPUT_COUNT;
        only_inputs &= is_input;
        for (size_t j = length_of(motors, references[k]); j > 0; j--, value++)
            if (!(is_input && isfinite(*value)) &&
                check_double(instance, function, references[k], *value) != STATUS_OK)
                return STATUS_ERROR;
    }
    for (size_t k = 0; k < count; k++) {
        if (references[k] == VR_step_size)
            motors->step_size = *values;
        else
            motors_write(motors, row_of(references[k]), values);
        values += length_of(motors, references[k]);
    }
    instance->changed |= !only_inputs;
    if (only_inputs)
        motors_refresh(motors);
    else if (instance->now.life_cycle & STARTING)
        motors_initialise(motors);
    else
        motors_tune(motors);
    return STATUS_OK;
}

Status model_is_stable(const Instance *instance, const char *function) {
    const Motors *motors = motors_in(instance);
    const double h = motors->step_size;
    for (size_t k = 0; k < motors->n; k++) {
        const Block *b = &motors->blocks[k / LANES];
        const MotorConstants p = lane_constants(b, k % LANES, motors->closed_loop);
        char whose[40];
        snprintf(whose, sizeof whose, " of motor %lu", (unsigned long)k + 1);
        if (check_motor(instance, function, whose, &p, h) != STATUS_OK)
            return STATUS_ERROR;
    }
    return STATUS_OK;
}

Option model_option(Instance *instance, uint32_t reference, const char *type) {
    (void)type; /* there is one */
    int32_t *closed_loop = &motors_of(instance)->closed_loop;
    return (Option){reference == VR_closed_loop ? closed_loop : NULL, 0, 1};
}

void model_options_changed(Instance *instance) {
    instance->changed = true;
    motors_refresh(motors_of(instance));
}

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
    instance->changed = true;
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

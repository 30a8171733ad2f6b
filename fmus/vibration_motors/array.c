/* See instance.h and array.h: memory, life cycle and steps of an array of motors. */
#include "array.h"

static const size_t model_size = sizeof(Motors);

Status motors_allocate(Motors *motors, const char *function, uint64_t n, uint64_t samples) {
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

void motors_initialise(Motors *motors) {
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

void motors_tune(Motors *motors) {
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

void motors_refresh(Motors *motors) {
    const Work work = {.block_count = block_count(motors->n), .closed_loop = motors->closed_loop};
    motors->level.refresh(motors->blocks, &work);
}

void motors_read(const Motors *motors, size_t row, double values[]) {
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

void motors_write(Motors *motors, size_t row, const double values[]) {
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
        return fail(instance, function,
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

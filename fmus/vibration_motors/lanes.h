/* The equations of motor.h on blocks of motors, one motor to a lane of a processor's vectors.
 *
 * A loop over the lanes of a block is what compilers vectorise; levels.h has it compiled for several
 * instruction sets. Every lane does one motor's operations in one motor's order, so that all give the
 * bits of a motor alone. */
#ifndef LANES_H
#define LANES_H

#include <string.h>

#include "motor.h"

/* Eight doubles are the widest vector there is; lanes beyond the last motor turn idly. */
enum { LANES = 8, BLOCK_ALIGNMENT = 64, MOTOR_PARAMETER_COUNT = VR_step_size - PARAMETER_FIRST };

_Static_assert(MOTOR_PARAMETER_COUNT == PARAMETER_COUNT - 1, "step_size is the last parameter");

/* Rows of a block. Those before SAVED_ROWS are what a motor is: all others follow from them. */
enum {
    ROW_INPUT,
    ROW_PARAMETER = ROW_INPUT + INPUT_COUNT,
    ROW_INTEGRAL = ROW_PARAMETER + MOTOR_PARAMETER_COUNT,
    ROW_THETA,
    ROW_OMEGA,
    SAVED_ROWS,
    ROW_OMEGA_DOT = SAVED_ROWS,
    ROW_SIN_THETA,
    ROW_TORQUE, /* what the present inputs make of the present state: see MotorDrive */
    ROW_INTEGRAL_RATE,
    ROW_BEFORE, /* integral, theta and omega before the step under way, to undo it */
    ROW_TORQUE_PER_VOLT = ROW_BEFORE + 3, /* see MotorConstants */
    ROW_DAMPING,
    ROW_WEIGHT_TORQUE,
    ROW_INVERSE_J,
    ROW_COUNT,
    SAMPLED = 3 /* rows from theta to omega_dot that are kept of parts of a step */
};

typedef struct {
    double row[ROW_COUNT][LANES];
    int64_t restart[LANES];   /* the input */
    int64_t restarted[LANES]; /* its value at the last step */
} Block;

_Static_assert(sizeof(Block) % BLOCK_ALIGNMENT == 0, "every row of an array of blocks is aligned");

/* What all motors of an instance share, and what a step is made of. */
typedef struct {
    size_t block_count;
    bool few; /* whether all motors are in the first half of one block */
    bool closed_loop;
    bool restarting; /* whether motors may have to return to their start before the first step */
    size_t samples;  /* equal parts of the step whose ends are kept */
    double *sampled; /* where to, as in array.c; NULL for nowhere */
    size_t stride;   /* of motors in it */
    int64_t steps;   /* of a part */
    double step_size;
    double rest; /* s, of a shorter last step; 0 for none */
} Work;

#ifdef __clang__
#define EACH_LANE _Pragma("clang loop vectorize(assume_safety) unroll(disable)")
#else
#define EACH_LANE
#endif

INLINE MotorInputs lane_inputs(const Block *b, size_t k) {
    MotorInputs in;
    for (size_t j = 0; j < INPUT_COUNT; j++)
        in.value[j] = b->row[ROW_INPUT + j][k];
    return in;
}

INLINE MotorConstants lane_constants(const Block *b, size_t k, bool closed_loop) {
    MotorConstants p;
    for (size_t j = 0; j < MOTOR_PARAMETER_COUNT; j++)
        p.value[j] = b->row[ROW_PARAMETER + j][k];
    p.torque_per_volt = b->row[ROW_TORQUE_PER_VOLT][k];
    p.damping = b->row[ROW_DAMPING][k];
    p.weight_torque = b->row[ROW_WEIGHT_TORQUE][k];
    p.inverse_J = b->row[ROW_INVERSE_J][k];
    p.closed_loop = closed_loop;
    return p;
}

INLINE MotorState lane_state(const Block *b, size_t k) {
    return (MotorState){b->row[ROW_THETA][k], b->row[ROW_OMEGA][k], b->row[ROW_INTEGRAL][k]};
}

/* Take a state, and its sine and drive with it. */
INLINE void lane_set_state(Block *b, size_t k, const MotorConstants *p, MotorState x) {
    const MotorInputs in = lane_inputs(b, k);
    const double sin_theta = sine(x.theta);
    const MotorDrive drive = motor_drive(p, &in, x, sin_theta);
    b->row[ROW_THETA][k] = x.theta;
    b->row[ROW_OMEGA][k] = x.omega;
    b->row[ROW_INTEGRAL][k] = x.integral;
    b->row[ROW_SIN_THETA][k] = sin_theta;
    b->row[ROW_TORQUE][k] = drive.torque;
    b->row[ROW_INTEGRAL_RATE][k] = drive.integral_rate;
}

/* Motors whose restart is not the one of the last step return to their start. */
INLINE void block_restart(Block *b, size_t lanes, bool closed_loop) {
    EACH_LANE
    for (size_t k = 0; k < lanes; k++) {
        const MotorConstants p = lane_constants(b, k, closed_loop);
        const MotorState start = motor_start(&p), present = lane_state(b, k);
        const bool anew = b->restart[k] != b->restarted[k];
        lane_set_state(b, k, &p,
                       (MotorState){anew ? start.theta : present.theta,
                                    anew ? start.omega : present.omega,
                                    anew ? start.integral : present.integral});
    }
}

INLINE void block_step(Block *b, size_t lanes, bool closed_loop, double h) {
    EACH_LANE
    for (size_t k = 0; k < lanes; k++) {
        const MotorConstants p = lane_constants(b, k, closed_loop);
        const MotorDrive drive = {b->row[ROW_TORQUE][k], b->row[ROW_INTEGRAL_RATE][k]};
        lane_set_state(b, k, &p, motor_euler(&p, lane_state(b, k), drive, h));
    }
}

/* Keep the outputs of a block at the end of a part. */
INLINE void block_sample(const Block *b, size_t lanes, const Work *work, size_t index, size_t part) {
    double *place = work->sampled + part * work->stride + index * LANES;
    for (size_t output = 0; output < SAMPLED; output++) {
        memcpy(place, b->row[ROW_THETA + output], lanes * sizeof *place);
        place += work->samples * work->stride;
    }
}

/* What a step leaves to be asked for; whether every motor is still bounded. */
INLINE bool block_finish(Block *b, size_t lanes, bool closed_loop) {
    int64_t unbounded = 0;
    EACH_LANE
    for (size_t k = 0; k < lanes; k++) {
        const MotorConstants p = lane_constants(b, k, closed_loop);
        const double torque = b->row[ROW_TORQUE][k];
        const double direction = motor_direction(&p, b->row[ROW_OMEGA][k], torque);
        b->row[ROW_OMEGA_DOT][k] = motor_acceleration(&p, torque, direction);
        unbounded |= !motor_is_bounded(lane_state(b, k));
    }
    return !unbounded;
}

/* Blocks take turns, so that a processor works on several at once: each step waits for the one before. */
INLINE bool blocks_step(Block *blocks, size_t lanes, const Work *work) {
    Block *const end = blocks + work->block_count;
    bool bounded = true;
    for (Block *b = blocks; b < end; b++) {
        memcpy(b->row[ROW_BEFORE], b->row[ROW_INTEGRAL], 3 * sizeof *b->row);
        if (work->restarting)
            block_restart(b, lanes, work->closed_loop);
    }
    for (size_t part = 0; part < work->samples; part++)
        for (Block *b = blocks; b < end; b++) {
            for (int64_t step = 0; step < work->steps; step++)
                block_step(b, lanes, work->closed_loop, work->step_size);
            if (work->rest > 0.0)
                block_step(b, lanes, work->closed_loop, work->rest);
            bounded &= block_finish(b, lanes, work->closed_loop);
            if (work->sampled)
                block_sample(b, lanes, work, (size_t)(b - blocks), part);
        }
    return bounded;
}

/* The work of a communication step on all blocks. */
INLINE bool lanes_step(Block *blocks, const Work *work) {
    return work->few ? blocks_step(blocks, LANES / 2, work) : blocks_step(blocks, LANES, work);
}

/* What follows from states and inputs, once they were set. */
INLINE bool lanes_refresh(Block *blocks, const Work *work) {
    for (Block *b = blocks; b < blocks + work->block_count; b++) {
        EACH_LANE
        for (size_t k = 0; k < LANES; k++) {
            const MotorConstants p = lane_constants(b, k, work->closed_loop);
            lane_set_state(b, k, &p, lane_state(b, k));
        }
        block_finish(b, LANES, work->closed_loop);
    }
    return true;
}

#endif

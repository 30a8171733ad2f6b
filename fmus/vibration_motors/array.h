/* An instance of n motors: what VibrationMotors offers beyond instance.h, the number of motors and
 * their restarts. The shims fmi3.c and fmi3_array.c only translate calls. */
#ifndef ARRAY_H
#define ARRAY_H

#include "instance.h"
#include "levels.h"

typedef struct {
    Instance base;
    size_t n;
    double step_size;
    bool closed_loop;
    bool restarting; /* whether some motor's restart may not be the one of its last step */
    Level level;
    Block *blocks; /* of motors 0 to 7, 8 to 15, ... */
    void *memory;  /* that the blocks are in, and the samples behind them */
    size_t samples;  /* parts of a step whose outputs are kept; with 1 they are the present outputs */
    double *sampled; /* theta, omega and omega_dot at the ends of the parts of the last step, a row of
                        motors for each; NULL with 1 */
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

/* Have n motors with start values in place of those there are, and room for samples; may be out of
 * memory. */
static Status motors_allocate(Motors *motors, const char *function, uint64_t n, uint64_t samples);
/* Put all states to their start, and parameters, states and inputs into force. */
static void motors_initialise(Motors *motors);
/* Put parameters, states and inputs into force. */
static void motors_tune(Motors *motors);
/* Put states and inputs into force. */
static void motors_refresh(Motors *motors);

/* Copy a row of n values. */
static void motors_read(const Motors *motors, size_t row, double values[]);
static void motors_write(Motors *motors, size_t row, const double values[]);

static Status instance_get_restart(const Instance *instance, const char *function,
                                   const uint32_t references[], size_t count, int64_t values[],
                                   size_t value_count);
static Status instance_set_restart(Instance *instance, const char *function,
                                   const uint32_t references[], size_t count,
                                   const int64_t values[], size_t value_count);

#endif

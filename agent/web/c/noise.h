/* Random numbers of numpy, bit for bit: SeedSequence (numpy/random/bit_generator.pyx) and PCG64
 * (O'Neill 2014) with what `Generator.random` and `Generator.integers` make of it. */
#ifndef NOISE_H
#define NOISE_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "layout.h"

typedef unsigned __int128 Wide;

typedef struct {
    Wide state, increment;
    bool has_half; /* of a word, for numbers of 32 bits */
    uint32_t half;
} Random;

enum { POOL = 4 };

static uint32_t hashed(uint32_t value, uint32_t *constant, uint32_t factor) {
    value ^= *constant;
    *constant *= factor;
    value *= *constant;
    return value ^ value >> 16;
}

static void mix_in(uint32_t *to, uint32_t value) {
    const uint32_t mixed = UINT32_C(0xca01f9dd) * *to - UINT32_C(0x4973f715) * value;
    *to = mixed ^ mixed >> 16;
}

static uint64_t next_word(Random *random) {
    const Wide factor = (Wide)UINT64_C(0x2360ed051fc65da4) << 64 | UINT64_C(0x4385df649fccf645);
    random->state = random->state * factor + random->increment;
    const uint64_t word = (uint64_t)(random->state >> 64) ^ (uint64_t)random->state;
    const unsigned turn = (unsigned)(random->state >> 122);
    return word >> turn | word << (-turn & 63);
}

/* Generator of SeedSequence(seed, spawn_key=keys); the seed has 64 bits. */
static Random random_of(uint64_t seed, const uint32_t keys[], int count) {
    const uint32_t mixer = UINT32_C(0x931e8875);
    const uint32_t entropy[POOL] = {(uint32_t)seed, (uint32_t)(seed >> 32)};
    uint32_t pool[POOL], constant = UINT32_C(0x43b0d7e5);
    uint64_t words[POOL];
    for (int k = 0; k < POOL; k++)
        pool[k] = hashed(entropy[k], &constant, mixer);
    for (int from = 0; from < POOL; from++)
        for (int to = 0; to < POOL; to++)
            if (from != to)
                mix_in(&pool[to], hashed(pool[from], &constant, mixer));
    for (int k = 0; k < count; k++)
        for (int to = 0; to < POOL; to++)
            mix_in(&pool[to], hashed(keys[k], &constant, mixer));
    constant = UINT32_C(0x8b51f9dd);
    for (int k = 0; k < POOL; k++) {
        const uint64_t low = hashed(pool[2 * k % POOL], &constant, UINT32_C(0x58f38ded));
        words[k] = low | (uint64_t)hashed(pool[(2 * k + 1) % POOL], &constant,
                                          UINT32_C(0x58f38ded)) << 32;
    }
    Random random = {.increment = ((Wide)words[2] << 64 | words[3]) << 1 | 1};
    next_word(&random);
    random.state += (Wide)words[0] << 64 | words[1];
    next_word(&random);
    return random;
}

/* Uniform in [0, 1). */
static double next_double(Random *random) {
    return (double)(next_word(random) >> 11) * 0x1p-53;
}

static uint32_t next_half(Random *random) {
    random->has_half = !random->has_half;
    if (!random->has_half)
        return random->half;
    const uint64_t word = next_word(random);
    random->half = (uint32_t)(word >> 32);
    return (uint32_t)word;
}

/* Uniform from 0 to count - 1: Lemire's method. */
static uint32_t next_index(Random *random, uint32_t count) {
    if (count <= 1)
        return 0;
    uint64_t product = (uint64_t)next_half(random) * count;
    if ((uint32_t)product < count)
        while ((uint32_t)product < -count % count)
            product = (uint64_t)next_half(random) * count;
    return (uint32_t)(product >> 32);
}

static double bell(double x) { return exp(-0.5 * x * x); }

/* Normally distributed: numpy's ziggurat of 256 layers (Marsaglia and Tsang, 2000), whose widths over
 * 2^52 are a table. The tail is a library's logarithm, whose last bit may differ. */
static double next_normal(Random *random) {
    const double start = 3.6541528853610088, inverse = 0.27366123732975827; /* of the tail */
    for (;;) {
        const uint64_t word = next_word(random), size = word >> 9 & UINT64_C(0xfffffffffffff);
        const int k = (int)(word & 0xff);
        const double inner = k == 1 ? 0.0 : 0x1p52 * table.widths[k ? k - 1 : 255];
        const double x = (double)size * table.widths[k], sign = word & 0x100 ? -1.0 : 1.0;
        if (x < inner || (k && (bell(inner) - bell(0x1p52 * table.widths[k])) * next_double(random) +
                                   bell(0x1p52 * table.widths[k]) < bell(x)))
            return sign * x;
        while (k == 0) {
            const double beyond = -inverse * log1p(-next_double(random));
            const double drawn = -log1p(-next_double(random));
            if (drawn + drawn > beyond * beyond)
                return size >> 8 & 1 ? -(start + beyond) : start + beyond;
        }
    }
}

#endif

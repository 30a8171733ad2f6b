/* Uniform random numbers of numpy, bit for bit: SeedSequence (numpy/random/bit_generator.pyx), PCG64
 * (O'Neill, 2014) and Generator.random. */
#include <stdint.h>

typedef unsigned __int128 Wide;

typedef struct {
    Wide state, increment;
} Generator;

enum { POOL = 4 };

static uint32_t hashed(uint32_t value, uint32_t *constant, uint32_t factor) {
    value ^= *constant;
    *constant *= factor;
    value *= *constant;
    return value ^ value >> 16;
}

static void mix_in(uint32_t *to, uint32_t from, uint32_t *constant) {
    const uint32_t value = hashed(from, constant, UINT32_C(0x931e8875));
    const uint32_t mixed = UINT32_C(0xca01f9dd) * *to - UINT32_C(0x4973f715) * value;
    *to = mixed ^ mixed >> 16;
}

static uint64_t next_word(Generator *generator) {
    const Wide factor = (Wide)UINT64_C(0x2360ed051fc65da4) << 64 | UINT64_C(0x4385df649fccf645);
    const Wide state = generator->state = generator->state * factor + generator->increment;
    const uint64_t word = (uint64_t)(state >> 64) ^ (uint64_t)state;
    const unsigned turn = (unsigned)(state >> 122);
    return word >> turn | word << (-turn & 63);
}

/* Begin a generator as default_rng(SeedSequence(seed, spawn_key=keys)) does.
 *
 * keys: at least one, each of 32 bits. */
void seed_generator(Generator *generator, uint64_t seed, const uint32_t keys[], int32_t count) {
    const uint32_t entropy[POOL] = {(uint32_t)seed, (uint32_t)(seed >> 32)};
    uint32_t pool[POOL], constant = UINT32_C(0x43b0d7e5);
    uint64_t words[POOL];
    for (int k = 0; k < POOL; k++)
        pool[k] = hashed(entropy[k], &constant, UINT32_C(0x931e8875));
    for (int from = 0; from < POOL; from++)
        for (int to = 0; to < POOL; to++)
            if (from != to)
                mix_in(&pool[to], pool[from], &constant);
    for (int k = 0; k < count; k++)
        for (int to = 0; to < POOL; to++)
            mix_in(&pool[to], keys[k], &constant);
    constant = UINT32_C(0x8b51f9dd);
    for (int k = 0; k < POOL; k++) {
        const uint64_t low = hashed(pool[2 * k % POOL], &constant, UINT32_C(0x58f38ded));
        const uint64_t high = hashed(pool[(2 * k + 1) % POOL], &constant, UINT32_C(0x58f38ded));
        words[k] = low | high << 32;
    }
    generator->increment = ((Wide)words[2] << 64 | words[3]) << 1 | 1;
    generator->state = generator->increment + ((Wide)words[0] << 64 | words[1]);
    next_word(generator);
}

/* Fill an array with the next numbers in [0, 1). */
void fill_uniforms(Generator *generator, double out[], int32_t count) {
    for (int32_t k = 0; k < count; k++)
        out[k] = (double)(next_word(generator) >> 11) * 0x1p-53;
}

/* The loops of lanes.h for every instruction set that is worth it, and which of them this processor
 * and its operating system can run. None of them changes a bit: they differ in how many lanes are
 * worked on at once. Elsewhere than on x86-64, or without Clang, there is only what the compiler makes
 * of them for its target. */
#ifndef LEVELS_H
#define LEVELS_H

#include "lanes.h"

typedef bool LanesWork(Block *blocks, const Work *work);

/* The variants for one instruction set. */
typedef struct {
    LanesWork *step, *refresh;
} Level;

#define LEVEL(name, attributes)                                                                    \
    attributes static bool name##_step(Block *blocks, const Work *work) {                          \
        return lanes_step(blocks, work);                                                           \
    }                                                                                              \
    attributes static bool name##_refresh(Block *blocks, const Work *work) {                       \
        return lanes_refresh(blocks, work);                                                        \
    }

LEVEL(baseline, )

#if defined(__clang__) && defined(__x86_64__) && defined(__GNUC__)

LEVEL(avx2, __attribute__((target("avx2"))))
LEVEL(avx512, __attribute__((target("avx512f,avx512dq,avx512vl"), min_vector_width(512))))

static const Level levels[] = {
    {baseline_step, baseline_refresh},
    {avx2_step, avx2_refresh},
    {avx512_step, avx512_refresh},
};

typedef struct {
    uint32_t a, b, c, d;
} Registers;

static Registers cpuid(uint32_t leaf) {
    Registers r = {.a = leaf, .c = 0};
    __asm__ volatile("cpuid" : "+a"(r.a), "=b"(r.b), "+c"(r.c), "=d"(r.d));
    return r;
}

/* Which registers the operating system keeps. */
static uint32_t kept_registers(void) {
    uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

/* Index in `levels` of the best level that runs here. */
static size_t best_level(void) {
    enum { OSXSAVE = 1 << 27, AVX = 1 << 28 };                                /* leaf 1, c */
    enum { AVX2 = 1 << 5, AVX512F = 1 << 16, AVX512DQ = 1 << 17 };            /* leaf 7, b */
    enum { YMM = 0x6, ZMM = 0xe6 };                                           /* kept registers */
    const uint32_t AVX512VL = UINT32_C(1) << 31, avx512 = AVX512F | AVX512DQ | AVX512VL;
    const uint32_t avx = OSXSAVE | AVX;
    if (cpuid(0).a < 7 || (cpuid(1).c & avx) != avx)
        return 0;
    const uint32_t kept = kept_registers(), features = cpuid(7).b;
    if ((kept & YMM) != YMM || !(features & AVX2))
        return 0;
    return (kept & ZMM) == ZMM && (features & avx512) == avx512 ? 2 : 1;
}

#else

static const Level levels[] = {{baseline_step, baseline_refresh}};

static size_t best_level(void) { return 0; }

#endif

/* The best level, or the one that the tests want. */
static Level choose_level(void) {
    size_t level = best_level();
#ifdef MOST_LEVEL
    level = level < MOST_LEVEL ? level : MOST_LEVEL;
#endif
    return levels[level];
}

#endif

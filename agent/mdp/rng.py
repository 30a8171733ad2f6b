"""splitmix64 as numba kernels: one 64-bit word of state, the same bits in C and in numba.

Not a general random library: only what the training kernels draw. The state is an array of one
uint64, so that a policy's file can keep it.
"""

import numpy as np

from cosim.base.jit import inlined

# Steele, Lea and Flood, "Fast splittable pseudorandom number generators" (2014), as in Java 8.
_GOLDEN_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_1, _SHIFT_2, _SHIFT_3 = np.uint64(30), np.uint64(27), np.uint64(31)
_HALF = np.uint64(32)

PROBABILITY_BITS = 53  # a probability p is the event (word >> 11) < round(p·2^53)
PROBABILITY_SHIFT = np.uint64(64 - PROBABILITY_BITS)


def seeded_state(seed: int | np.random.SeedSequence | None) -> np.ndarray:
    """Generator state, (1,) uint64, from a seed, a spawned seed sequence, or entropy if None."""
    sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    return sequence.generate_state(1, np.uint64)


def probability_threshold(probability: float) -> np.uint64:
    """The word that `(draw >> PROBABILITY_SHIFT)` must stay below, for an event's probability."""
    return np.uint64(round(probability * 2**PROBABILITY_BITS))


@inlined
def next_word(state: np.ndarray) -> np.uint64:
    """The next 64 random bits; advances `state`."""
    state[0] += _GOLDEN_GAMMA
    z = state[0]
    z = (z ^ (z >> _SHIFT_1)) * _MIX_1
    z = (z ^ (z >> _SHIFT_2)) * _MIX_2
    return z ^ (z >> _SHIFT_3)


@inlined
def next_index(state: np.ndarray, count: int) -> np.int64:
    """A uniform index in [0, count) for count < 2^32 (bias below count/2^32); advances `state`."""
    return np.int64(((next_word(state) >> _HALF) * np.uint64(count)) >> _HALF)

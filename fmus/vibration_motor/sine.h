/* A sine that is the same to the bit on every platform: no libm, and no branches, so that compilers
 * can take several angles at once. Floating-point contraction must be off: compilers other than Clang
 * need -ffp-contract=off. */
#ifndef SINE_H
#define SINE_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

/* Compilers vectorise a loop only if the equations in it are inlined. */
#ifdef __GNUC__
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

/* Adding and subtracting it rounds to a whole number, half to even: 1.5 * 2^52. */
#define ROUNDER 6755399441055744.0
#define INVERSE_PI 0x1.45f306dc9c883p-2
/* The first and second part of pi have 31 bits: their products with quotients up to 2^22 are exact. */
#define PI_HIGH 0x1.921fb544p+1
#define PI_MIDDLE 0x1.0b4611a8p-33
#define PI_LOW -0x1.d9cceba3f91f2p-65
/* Beyond it an angle in double precision says no more of its place in the turn: the sine is 0. */
#define MOST_ANGLE 1e15

/* Within 3e-16 of the sine up to 1e7 rad, and farther within that and half a unit in the angle's last
 * place; odd and exactly 0 at 0.
 *
 * The polynomial is the minimax one for the relative error in |y| <= pi / 2, 3e-19, by Remez' exchange
 * algorithm in 300 bits (mpmath); it is evaluated in pairs because that has fewer steps in line. */
INLINE double sine(double x) {
    const double quotient = (x * INVERSE_PI + ROUNDER) - ROUNDER;
    const double y = (x - quotient * PI_HIGH) - (quotient * PI_MIDDLE + quotient * PI_LOW);
    const double z = y * y, z2 = z * z, z4 = z2 * z2;
    const double low = (-0x1.5555555555555p-3 + z * 0x1.11111111110c1p-7) +
                       z2 * (-0x1.a01a01a0148bcp-13 + z * 0x1.71de3a5287c76p-19);
    const double high = (-0x1.ae6454cb574dep-26 + z * 0x1.6123cb290446bp-33) +
                        z2 * (-0x1.ae431d98d7a20p-41 + z * 0x1.8829a2ff08775p-49);
    const double s = y + (y * z) * (low + z4 * high);
    const double half = (0.5 * quotient + ROUNDER) - ROUNDER;
    const double upright = quotient - 2.0 * half == 0.0 ? s : -s;
    return fabs(x) <= MOST_ANGLE ? upright : 0.0;
}

#endif

/* Sine and cosine of one angle together: cosim/physics/trig.py in C, to the bit. The motor's own sine
 * (sine.h) is another polynomial. */
#ifndef TRIG_H
#define TRIG_H

#include "exact.h"

typedef struct {
    double sine, cosine;
} Trig;

/* Largest whole number not above x; floor of C is a call where a processor has no instruction. */
INLINE double whole(double x) {
    if (!(fabs(x) < 0x1p52))
        return x;
    const double truncated = (double)(int64_t)x;
    return truncated > x ? truncated - 1.0 : truncated;
}

/* For angles up to some 1e6 rad. */
INLINE Trig sine_cosine(double x) {
    const double quadrant = whole(x * 0x1.45f306dc9c883p-1 + 0.5);
    const double y = ((x - quadrant * 1.57079625129699707031250) -
                      quadrant * 7.54978941586159635335e-8) -
                     quadrant * 5.3903029534742383827e-15;
    const double z = y * y;
    double s = -1.66666666666666307295e-1 +
               z * (8.33333333332211858878e-3 +
                    z * (-1.98412698295895385996e-4 +
                         z * (2.75573136213857245213e-6 +
                              z * (-2.50507477628578072866e-8 + z * 1.58962301576546568060e-10))));
    double c = 4.16666666666665929218e-2 +
               z * (-1.38888888888730564116e-3 +
                    z * (2.48015872888517045348e-5 +
                         z * (-2.75573141792967388112e-7 +
                              z * (2.08757008419747316778e-9 + z * -1.13585365213876817300e-11))));
    s = y + y * z * s;
    c = 1.0 - 0.5 * z + z * z * c;
    const double half = whole(0.5 * quadrant);
    const bool odd = quadrant - 2.0 * half > 0.5;
    const bool upper = half - 2.0 * whole(0.5 * half) > 0.5;
    const Trig turned = odd ? (Trig){c, -s} : (Trig){s, c};
    return upper ? (Trig){-turned.sine, -turned.cosine} : turned;
}

#endif

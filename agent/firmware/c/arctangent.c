/* The arctangent, without a C library: within 0.501 units in the last place, so that it differs from a
 * good library's in the last bit and rarely.
 *
 * atan(x) = atan(k/16) + atan(t) with t = (x - k/16) / (1 + x k/16), at most 1/32, and its series;
 * for x beyond 1 of 1/x, from pi/2. What rounding takes from t is carried along: products are split
 * into sums that are exact (Dekker, 1971). Contraction to fused multiply-adds must be off. */
#include "minirobot.h"

typedef struct {
    double high, low; /* a value as a sum, low below the last place of high */
} Sum;

/* atan(k/16), and pi/2 */
static const Sum at_sixteenth[] = {
    {0x0.0p+0, 0x0.0p+0},
    {0x1.ff55bb72cfdeap-5, -0x1.c934d86d23f1dp-60},
    {0x1.fd5ba9aac2f6ep-4, -0x1.cd37686760c17p-59},
    {0x1.7b97b4bce5b02p-3, 0x1.347b0b4f881cap-58},
    {0x1.f5b75f92c80ddp-3, 0x1.8ab6e3cf7afbdp-57},
    {0x1.362773707ebccp-2, -0x1.963a544b672d8p-57},
    {0x1.6f61941e4def1p-2, -0x1.c63aae6f6e918p-56},
    {0x1.a64eec3cc23fdp-2, -0x1.24dec1b50b7ffp-56},
    {0x1.dac670561bb4fp-2, 0x1.a2b7f222f65e2p-56},
    {0x1.0657e94db30d0p-1, -0x1.d5b495f6349e6p-56},
    {0x1.1e00babdefeb4p-1, -0x1.928df287a668fp-58},
    {0x1.345f01cce37bbp-1, 0x1.1021137c71102p-55},
    {0x1.4978fa3269ee1p-1, 0x1.2419a87f2a458p-56},
    {0x1.5d58987169b18p-1, 0x1.0028e4bc5e7cap-57},
    {0x1.700a7c5784634p-1, -0x1.8c34d25aadef6p-56},
    {0x1.819d0b7158a4dp-1, -0x1.bf76229d3b917p-56},
    {0x1.921fb54442d18p-1, 0x1.1a62633145c07p-55},
};
static const Sum half_pi = {0x1.921fb54442d18p+0, 0x1.1a62633145c07p-54};

static Sum sum(double a, double b) {
    const double high = a + b, of_b = high - a;
    return (Sum){high, (a - (high - of_b)) + (b - of_b)};
}

static Sum product(double a, double b) {
    const double split = 134217729.0; /* 2^27 + 1 */
    const double a_high = split * a - (split * a - a), a_low = a - a_high;
    const double b_high = split * b - (split * b - b), b_low = b - b_high;
    const double high = a * b;
    return (Sum){high, ((a_high * b_high - high) + a_high * b_low + a_low * b_high) + a_low * b_low};
}

double arctangent(double x) {
    const double size = x < 0.0 ? -x : x;
    if (x == 0.0 || x != x) return x;
    if (size > 0x1p54) return x < 0.0 ? -half_pi.high : half_pi.high;
    const bool beyond = size > 1.0;
    const double above = beyond ? 1.0 : size, below = beyond ? size : 1.0;
    const int k = (int)(16.0 * (above / below) + 0.5);
    const double c = 0.0625 * k;

    const Sum away = product(c, below), along = product(c, above);
    Sum over = sum(above, -away.high), under = sum(below, along.high);
    over.low -= away.low;
    under.low += along.low;
    const double t = over.high / under.high;
    const Sum back = product(t, under.high);
    const double rest = (((over.high - back.high) - back.low) + over.low) - t * under.low;

    const double s = t * t;
    const double tail = s * (-1.0 / 3 + s * (1.0 / 5 + s * (-1.0 / 7 + s * (1.0 / 9 + s * (-1.0 / 11
                        + s * (1.0 / 13))))));
    const double small = at_sixteenth[k].low + (rest / under.high + t * tail);
    Sum angle = sum(at_sixteenth[k].high, t);
    angle.low += small;
    if (beyond) {
        const Sum rest_of = sum(half_pi.high, -angle.high);
        angle = (Sum){rest_of.high, rest_of.low + (half_pi.low - angle.low)};
    }
    const double value = angle.high + angle.low;
    return x < 0.0 ? -value : value;
}

/* The speed loop of a motor, sampled once in a control period; the voltage holds until the next.
 *
 * Eq. (14) in time is u = K_p e + K_i times the integral of e. A sum stands for the integral here: the
 * error of this period, times the period, is added after the voltage is made (forward Euler), as the
 * simulated motor does every 10 us. As there, nothing is added while the voltage is at its limit and
 * the error would push it further out: else the sum would wind up while a motor starts, and the motor
 * overshoot until it has unwound. */
#include "minirobot.h"

double speed_loop(SpeedLoop *loop, double set_point, double speed) {
    const double error = set_point - speed;
    /* Eq. (14) */
    const double u = K_P * error + K_I * loop->integral;
    const double volts = u > V_S_MAX ? V_S_MAX : u < -V_S_MAX ? -V_S_MAX : u;
    if ((u - volts) * error <= 0.0) loop->integral += CONTROL_PERIOD_S * error;
    return volts;
}

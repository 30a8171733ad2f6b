/* A board without electronics, to be replaced: sensors are variables that a debugger may set. */
#include "board.h"

static volatile double measured[3 * ROBOTS], speeds[MOTORS], voltages[MOTORS];

void board_wait(void) {}

double board_look(Position positions[ROBOTS]) {
    for (int robot = 0; robot < ROBOTS; robot++) {
        positions[robot] = (Position){measured[3 * robot], measured[3 * robot + 1]};
    }
    return measured[3 * (ROBOT - 1) + 2];
}

double board_speed(int motor) { return speeds[motor]; }

void board_drive(int motor, double volts) { voltages[motor] = volts; }

/* What a robot's own electronics must provide: fill in board.c. */
#ifndef BOARD_H
#define BOARD_H

#include "minirobot.h"

/* Wait for the next control period, by a hardware timer of CONTROL_PERIOD_S. */
void board_wait(void);

/* Where all robots are, and which way this one faces, as the camera over the board last said. */
double board_look(Position positions[ROBOTS]);

/* Speed of a motor's shaft in rad/s with its sign, by an encoder or the back-EMF. */
double board_speed(int motor);

/* Drive a motor with a voltage of either sign, by PWM on an H-bridge: duty = volts / supply. */
void board_drive(int motor, double volts);

#endif

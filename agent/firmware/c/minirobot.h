/* What runs on one robot of a board: where to go next by its table, how to steer there, and the speed
 * loops of its two motors.
 *
 * C99 with IEEE 754 doubles, without heap, without a C library; everything a robot keeps is in a
 * `Robot` and two `SpeedLoop`s. Lengths are in m, angles in rad counter-clockwise from the board's x
 * axis, whose origin is the lower left corner, speeds in rad/s. Floating-point contraction must be
 * off: then set points are those of the co-simulation in every bit.
 *
 * Once in every control period (CONTROL_PERIOD_S of constants.h), in this order:
 *     if (robot_decides(&robot)) robot_decide(&robot, heading, positions);
 *     robot_steer(&robot, x, y, heading, set_points);
 *     volts = speed_loop(&loop[motor], set_points[motor], speed);     for motors D and E
 */
#ifndef MINIROBOT_H
#define MINIROBOT_H

#include <stdbool.h>
#include <stdint.h>

#include "constants.h"

enum { MOTOR_D, MOTOR_E, MOTORS };

typedef struct {
    double x, y;
} Position;

/* HOLD stands, START has a fresh command, PAST drives on beyond the end of its line. */
typedef enum { HOLD, START, TURN, DRIVE, PAST } Mode;

typedef struct {
    Mode mode;
    Position goal;        /* end of the line that the robot drives */
    int32_t direction;    /* of the line, in eighths of a turn; NO_DIRECTION before the first move */
    double sense;         /* 1 drives forwards, -1 backwards */
    double dither_phase;  /* rad */
    double dither_sign;
    uint32_t period;      /* control periods since the start */
    uint32_t moving_since; /* period in which the move began */
    int32_t squared;      /* cells^2 to the nearest other robot at the last decision */
    bool arrived;
} Robot;

enum { NO_DIRECTION = -1 };

typedef struct {
    double integral; /* rad, of the speed error */
} SpeedLoop;

/* Set a robot down; positions are those of all robots of the board, in their order. */
void robot_start(Robot *robot, const Position positions[ROBOTS]);

/* Whether `robot_decide` is due in this control period: it is every DECISION_PERIODS. */
bool robot_decides(const Robot *robot);

/* Look at all robots of the board and, if the last move has ended or takes too long, begin another. */
void robot_decide(Robot *robot, double heading, const Position positions[ROBOTS]);

/* Set points of both motors for this control period. */
void robot_steer(Robot *robot, double x, double y, double heading, double set_points[MOTORS]);

/* Voltage for a motor: Eq. (14) at this moment. */
double speed_loop(SpeedLoop *loop, double set_point, double speed);

/* In [-pi/2, pi/2]. */
double arctangent(double x);

/* Largest whole number that is not above x, which must fit into 32 bits. */
static inline int32_t rounded_down(double x) {
    const int32_t towards_zero = (int32_t)x;
    return towards_zero > x ? towards_zero - 1 : towards_zero;
}

#endif

/* From the line that a robot drives to the set points of its motors; the law of docs/steering.md.
 *
 * With opposite signs (-, +) the motors drive the robot forwards, with equal ones (+, +) they turn it
 * counter-clockwise. */
#include "minirobot.h"

/* For a filter of poses: the speed in m/s and the rate in rad/s that set points are for. */
#ifndef NOTE_MOTION
#define NOTE_MOTION(speed, rate)
#endif

static double size(double x) { return x < 0.0 ? -x : x; }

static double least(double a, double b) { return b < a ? b : a; }

/* The angle brought into [-pi, pi). */
static double wrapped(double angle) {
    return angle - 2.0 * PI * rounded_down(angle / (2.0 * PI) + 0.5);
}

/* Speed for one motor and against the other, whose sign changes whenever the phase between them has
 * gone once around. */
static double dither(Robot *robot) {
    if (robot->dither_phase <= 0.0) {
        robot->dither_sign = 1.0;
    } else if (robot->dither_phase >= 2.0 * PI) {
        robot->dither_sign = -1.0;
    }
    const double speed = robot->dither_sign * DITHER_RAD_S;
    robot->dither_phase += 2.0 * speed * CONTROL_PERIOD_S;
    return speed;
}

static void steer(Robot *robot, double x, double y, double heading, double set_points[MOTORS]) {
    const double ux = direction_x[robot->direction], uy = direction_y[robot->direction];
    const double dx = robot->goal.x - x, dy = robot->goal.y - y;
    const double remaining = ux * dx + uy * dy;
    if (remaining <= 0.0) {
        robot->mode = THROUGH ? PAST : HOLD;
        if (robot->mode == HOLD) return;
    }

    const double left_of_line = uy * dx - ux * dy;
    const double ahead = remaining > LEAST_LOOKAHEAD_M ? remaining : LEAST_LOOKAHEAD_M;
    const double course = direction_rad[robot->direction]
                          - arctangent(left_of_line / least(LOOKAHEAD_M, ahead));
    double error = wrapped(course - heading);
    if (robot->mode == START) {
        robot->sense = size(error) <= PI / 2.0 ? 1.0 : -1.0;
        robot->mode = TURN;
    }
    if (robot->sense < 0.0) error = wrapped(error + PI);

    if (robot->mode == TURN && size(error) < TURNED_RAD) {
        robot->mode = DRIVE;
    } else if (robot->mode == DRIVE && size(error) > TURN_AGAIN_RAD) {
        robot->mode = TURN;
    }
    const double added = dither(robot);
    if (robot->mode == TURN) {
        const double turn = error < 0.0 ? -TURN_SPEED_RAD_S : TURN_SPEED_RAD_S;
        set_points[MOTOR_D] = turn - added;
        set_points[MOTOR_E] = turn + added;
        NOTE_MOTION(0.0, error < 0.0 ? -TURN_RATE_RAD_S : TURN_RATE_RAD_S);
        return;
    }
    const double wanted = HEADING_GAIN_1_S * error;
    double difference = wanted > -MAX_DIFFERENCE_RAD_S ? wanted : -MAX_DIFFERENCE_RAD_S;
    difference = least(MAX_DIFFERENCE_RAD_S, difference);
    /* The faster motor stays below hopping; the difference is kept by slowing the other one. */
    const double speed = robot->sense > 0.0 ? FORWARD_SPEED_RAD_S : BACKWARD_SPEED_RAD_S;
    const double drive = robot->sense * least(speed, MAX_SPEED_RAD_S - size(difference));
    NOTE_MOTION(robot->sense * DRIVE_SPEED_M_S, YAW_GAIN * difference);
    difference += added;
    set_points[MOTOR_D] = difference - drive;
    set_points[MOTOR_E] = difference + drive;
}

void robot_steer(Robot *robot, double x, double y, double heading, double set_points[MOTORS]) {
    set_points[MOTOR_D] = set_points[MOTOR_E] = 0.0;
    if (robot->mode != HOLD) steer(robot, x, y, heading, set_points);
    robot->period++;
}

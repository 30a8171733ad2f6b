/* The firmware's constants at run time: in a page one library drives all robots of any board. */
#ifndef CONSTANTS_H
#define CONSTANTS_H

#include <stddef.h>
#include <stdint.h>

#include "layout.h"

enum { DIRECTIONS = 8 };

extern int32_t present_robot; /* whose firmware runs, from 1 */

#define ROBOT present_robot
#define ROBOTS ((int32_t)setup.robots)
#define COLUMNS ((int32_t)setup.columns)
#define ROWS ((int32_t)setup.rows)
#define CELL_M setup.cell_m
#define PI 0x1.921fb54442d18p+1
#define EIGHTH_RAD (2.0 * PI / DIRECTIONS)
#define CONTROL_PERIOD_S setup.control_period_s
#define DECISION_PERIODS ((uint32_t)setup.decision_periods)
#define MOVE_LIMIT_PERIODS ((uint32_t)setup.move_limit_periods)
#define RETREAT ((Mode)5)
#define THROUGH (setup.through != 0.0 && robot->mode != RETREAT)
#define FORWARD_SPEED_RAD_S setup.steering[0]
#define BACKWARD_SPEED_RAD_S setup.steering[1]
#define TURN_SPEED_RAD_S setup.steering[2]
#define MAX_SPEED_RAD_S setup.steering[3]
#define DITHER_RAD_S setup.steering[4]
#define TURNED_RAD setup.steering[5]
#define TURN_AGAIN_RAD setup.steering[6]
#define HEADING_GAIN_1_S setup.steering[7]
#define MAX_DIFFERENCE_RAD_S setup.steering[8]
#define LOOKAHEAD_M setup.steering[9]
#define LEAST_LOOKAHEAD_M setup.steering[10]
#define DRIVE_SPEED_M_S setup.motion[0]
#define TURN_RATE_RAD_S setup.motion[1]
#define YAW_GAIN setup.motion[2]
#define NOTE_MOTION(speed, rate) (noted_motion[0] = (speed), noted_motion[1] = (rate))
static double noted_motion[2]; /* of the present robot */
#define NEAR_SQUARED ((int32_t)setup.near_squared)
#define MEDIUM_SQUARED ((int32_t)setup.medium_squared)
#define STRIDE_X ((int32_t)setup.strides[0])
#define STRIDE_Y ((int32_t)setup.strides[1])
#define STRIDE_D ((int32_t)setup.strides[2])
#define STRIDE_G ((int32_t)setup.strides[3])
#define STRIDE_B ((int32_t)setup.strides[4])
#define STRIDE_H ((int32_t)setup.strides[5])
#define STRIDE_P ((int32_t)setup.strides[6])
#define STATES ((size_t)setup.states)
#define TARGET_X ((int32_t)setup.targets[2 * (ROBOT - 1)])
#define TARGET_Y ((int32_t)setup.targets[2 * (ROBOT - 1) + 1])
#define direction_rad setup.direction_rad
#define direction_x setup.direction_x
#define direction_y setup.direction_y
#define bearing(dx, dy) \
    (table.bearings ? table.bearings[((dx) + COLUMNS - 1) * (2 * ROWS - 1) + (dy) + ROWS - 1] : 0)
static const uint8_t *best; /* of the present robot: a bit for each direction of largest value */
/* Where robots may not be ends an episode here. */
enum { FORBIDDEN = 0 };
static const int32_t forbidden[1][1][4];

#endif

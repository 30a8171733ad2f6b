/* The firmware's constants at run time: in a page one library drives all robots of any board. */
#ifndef CONSTANTS_H
#define CONSTANTS_H

#include "layout.h"

enum { DIRECTIONS = 8 };

static int32_t present_robot; /* whose firmware runs, from 1 */

#define ROBOT present_robot
#define ROBOTS ((int32_t)setup.robots)
#define COLUMNS ((int32_t)setup.columns)
#define ROWS ((int32_t)setup.rows)
#define CELL_M setup.cell_m
#define PI 0x1.921fb54442d18p+1
#define EIGHTH_RAD (2.0 * PI / DIRECTIONS)
#define CONTROL_PERIOD_S setup.control_period_s
#define DECISION_PERIODS ((uint32_t)setup.decision_periods)
#define MOVE_LIMIT_PERIODS setup.move_limit_periods
#define RETREAT ((Mode)5)
#define THROUGH (setup.through != 0.0 && robot->mode != RETREAT)
#define NOTE_MOTION(speed, rate) (noted_motion[0] = (speed), noted_motion[1] = (rate))
static double noted_motion[2]; /* of the present robot */
#define NEAR_SQUARED setup.near_squared
#define MEDIUM_SQUARED setup.medium_squared
#define STATES ((size_t)setup.states)
#define TARGET_X setup.targets[2 * (ROBOT - 1)]
#define TARGET_Y setup.targets[2 * (ROBOT - 1) + 1]
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

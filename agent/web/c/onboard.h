/* What robots decide and how they steer: the firmware of agent/firmware/c, for all robots of a board.
 *
 * It is a unit of its own, because names of the firmware mean other things in the physics. */
#ifndef ONBOARD_H
#define ONBOARD_H

#include <stdbool.h>

#include "layout.h"
#include "noise.h"

/* What is known of all robots: positions in m, headings in rad, and the variances of positions in m^2. */
typedef struct {
    double positions[MOST_ROBOTS][2], headings[MOST_ROBOTS], variances[MOST_ROBOTS];
} Known;

/* Set all robots down; detours of the shield are drawn from a generator. */
void onboard_start(const Known *known, Random detours);

/* Let the robots that wait or are late begin their next move. Once in every RL step. */
void onboard_decide(const Known *known);

/* Let the shield stop robots, where it is on. Once in every control period. */
void onboard_guard(const Known *known);

/* Set points of a robot's motors D and E in rad/s for a control period, and the speed in m/s and the
 * rate in rad/s that they are for. */
void onboard_steer(int robot, const Known *known, double set_points[2], double motion[2]);

/* Judge the moves at the end of an RL step by true positions; whether all robots have arrived. */
bool onboard_arrive(const double positions[][2]);

/* Where a robot drives to in m, its mode, and whether it has arrived. */
void onboard_show(int robot, double goal[2], double *mode, double *arrived);

/* Angle of the point (x, y) in rad. */
double onboard_angle(double y, double x);

/* Cosine and sine of an angle, which the physics have. */
void turn_of(double angle, double turned[2]);

#endif

/* What robots decide and how they steer: the firmware of agent/firmware/c, for all robots of a board.
 *
 * It is a unit of its own, because names of the firmware mean other things in the physics. */
#ifndef ONBOARD_H
#define ONBOARD_H

#include <stdbool.h>

/* Set all robots down; positions in m, x and y of each. */
void onboard_start(const double positions[][2]);

/* Let the robots that wait or are late begin their next move, by positions in m and headings in rad.
 * Once in every RL step. */
void onboard_decide(const double positions[][2], const double headings[]);

/* Set points of a robot's motors D and E in rad/s for a control period. */
void onboard_steer(int robot, double x, double y, double heading, double set_points[2]);

/* Judge the moves at the end of an RL step; whether all robots have arrived. */
bool onboard_arrive(const double positions[][2]);

/* Where a robot drives to in m, its mode, and whether it has arrived. */
void onboard_show(int robot, double goal[2], double *mode, double *arrived);

/* Angle of the point (x, y) in rad. */
double onboard_angle(double y, double x);

#endif

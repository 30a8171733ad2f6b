/* The robot's program: one control period after the other. */
#include "board.h"

static Robot robot;
static SpeedLoop loops[MOTORS];
static Position positions[ROBOTS];

int main(void) {
    board_look(positions);
    robot_start(&robot, positions);
    for (;;) {
        double set_points[MOTORS];
        board_wait();
        const double heading = board_look(positions);
        const Position own = positions[ROBOT - 1];
        if (robot_decides(&robot)) robot_decide(&robot, heading, positions);
        robot_steer(&robot, own.x, own.y, heading, set_points);
        for (int motor = 0; motor < MOTORS; motor++) {
            board_drive(motor, speed_loop(&loops[motor], set_points[motor], board_speed(motor)));
        }
    }
}

/* The camera over the board and the filter of each robot: cosim/onboard/camera.py and estimation.py in
 * C, which say why. */
#ifndef CAMERA_H
#define CAMERA_H

#include <stdlib.h>

#include "onboard.h"

typedef struct {
    double x, y, heading;
} Pose;

typedef struct {
    Pose pose;
    double seconds; /* of driving */
} Commanded;

typedef struct {
    Pose pose;
    double sigma[9];
} Belief;

typedef struct {
    double at;
    bool found;
    Pose seen;
    Commanded reference;
} Frame;

typedef struct {
    Random random;
    Belief now, then; /* then: at the last frame that has arrived */
    Commanded odometry, reference;
    double still_s;
    uint32_t taken, used, sighted;
    double period;
    Frame *frames;
    double *sights; /* x, y, heading, and whether the robot is found */
} Watched;

static void watch(Watched *w, Random random) {
    free(w->frames);
    free(w->sights);
    *w = (Watched){.random = random};
    if (INTERVAL > 0.0) {
        w->frames = calloc((size_t)FLYING, sizeof *w->frames);
        w->sights = calloc((size_t)(4 * SIGHTS), sizeof *w->sights);
    }
}

/* Draw the noise of the frames of an RL step. */
static void draw_sights(Watched *w) {
    w->sighted = 0;
    for (int k = 0; k < SIGHTS; k++)
        for (int j = 0; j < 4; j++)
            w->sights[4 * k + j] =
                next_normal(&w->random) * (j < 2 ? POSITION_NOISE_M : HEADING_NOISE_RAD);
    for (int k = 0; k < SIGHTS; k++)
        w->sights[4 * k + 3] = next_double(&w->random) >= DROPOUT;
}

/* The motion from one pose to another in the frame of the first. */
static Commanded motion_between(Commanded first, Commanded second) {
    const Trig t = sine_cosine(first.pose.heading);
    const double dx = second.pose.x - first.pose.x, dy = second.pose.y - first.pose.y;
    return (Commanded){{t.cosine * dx + t.sine * dy, t.cosine * dy - t.sine * dx,
                        second.pose.heading - first.pose.heading},
                       second.seconds - first.seconds};
}

static Belief predicted(Belief b, Commanded motion) {
    const Trig t = sine_cosine(b.pose.heading);
    const double dx = t.cosine * motion.pose.x - t.sine * motion.pose.y;
    const double dy = t.sine * motion.pose.x + t.cosine * motion.pose.y;
    /* Eq. (K1), (K2) */
    b.pose = (Pose){b.pose.x + dx, b.pose.y + dy, wrapped(b.pose.heading + motion.pose.heading)};
    for (int k = 0; k < 3; k++) {
        b.sigma[k] -= dy * b.sigma[6 + k];
        b.sigma[3 + k] += dx * b.sigma[6 + k];
    }
    for (int k = 0; k < 9; k += 3) {
        b.sigma[k] -= dy * b.sigma[k + 2];
        b.sigma[k + 1] += dx * b.sigma[k + 2];
    }
    b.sigma[0] += POSITION_DRIFT_M2_S * motion.seconds;
    b.sigma[4] += POSITION_DRIFT_M2_S * motion.seconds;
    b.sigma[8] += HEADING_DRIFT_RAD2_S * motion.seconds;
    return b;
}

static void correct(Watched *w, const Frame *frame) {
    Belief b = predicted(w->then, motion_between(w->reference, frame->reference));
    w->reference = frame->reference;
    for (int row = 0; row < 3; row++) {
        double *state[] = {&b.pose.x, &b.pose.y, &b.pose.heading};
        const double seen[] = {frame->seen.x, frame->seen.y, frame->seen.heading};
        const double spread = b.sigma[4 * row] + (row == 2 ? HEADING_VARIANCE : POSITION_VARIANCE);
        if (spread <= 0.0)
            continue;
        double innovation = seen[row] - *state[row], gain[3], ahead[3];
        if (row == 2)
            innovation = wrapped(innovation);
        for (int k = 0; k < 3; k++) {
            gain[k] = b.sigma[3 * k + row] / spread; /* Eq. (K3) */
            ahead[k] = b.sigma[3 * row + k];
        }
        for (int k = 0; k < 3; k++) {
            *state[k] += gain[k] * innovation; /* Eq. (K4) */
            for (int j = 0; j < 3; j++)
                b.sigma[3 * k + j] -= gain[k] * ahead[j]; /* Eq. (K5) */
        }
    }
    b.pose.heading = wrapped(b.pose.heading);
    w->then = b;
}

/* Bring a robot's estimate to the start of a control period. */
static void take_look(Watched *w, Pose pose) {
    if (w->period == 0.0) {
        w->then = (Belief){pose, {POSITION_VARIANCE, 0, 0, 0, POSITION_VARIANCE, 0, 0, 0,
                                  HEADING_VARIANCE}};
        w->still_s = INFINITY;
    }
    if (w->period >= INTERVAL * w->taken) {
        const double *noise = w->sights + 4 * w->sighted++;
        w->frames[w->taken++ % (uint32_t)FLYING] = (Frame){
            w->period, noise[3] > 0.0,
            {pose.x + noise[0], pose.y + noise[1], pose.heading + noise[2]}, w->odometry};
    }
    for (; w->used < w->taken; w->used++) {
        const Frame *frame = &w->frames[w->used % (uint32_t)FLYING];
        if (frame->at + DELAY > w->period)
            break;
        if (frame->found)
            correct(w, frame);
    }
    w->now = predicted(w->then, motion_between(w->reference, w->odometry));
    w->period += 1.0;
}

/* Add up what is commanded in a control period. */
static void take_command(Watched *w, double speed, double yaw_rate, bool driven, double seconds) {
    Commanded *sum = &w->odometry;
    w->still_s = driven ? 0.0 : w->still_s + seconds;
    if (w->still_s < SETTLE_S)
        sum->seconds += seconds;
    const Trig t = sine_cosine(sum->pose.heading + 0.5 * yaw_rate * seconds);
    sum->pose.x += speed * seconds * t.cosine;
    sum->pose.y += speed * seconds * t.sine;
    sum->pose.heading += yaw_rate * seconds;
}

/* The variance of a position in its worst direction. */
static double variance_of(const Belief *b) {
    const double xx = b->sigma[0], xy = b->sigma[1], yy = b->sigma[4];
    return 0.5 * (xx + yy) + square_root(0.25 * ((xx - yy) * (xx - yy)) + xy * xy);
}

#endif

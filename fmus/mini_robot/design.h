/* What follows from a robot's parameters: cosim/physics/mass.py, contact.py and properties.py in C.
 *
 * The step sizes of the contact solver are eigenvalues of the Delassus operator, rounded to 12 digits:
 * those are the same whatever found them. */
#ifndef DESIGN_H
#define DESIGN_H

#include <stdio.h>
#include <stdlib.h>

#include "body.h"

enum { ROWS = 3 * FOOT_COUNT };

/* Largest eigenvalue of a symmetric matrix, which is overwritten, by Jacobi's rotations. */
static double largest_eigenvalue(double a[ROWS][ROWS], int n) {
    enum { SWEEPS = 12 };
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++) {
                if (a[p][q] == 0.0)
                    continue;
                const double ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                const double t = (ratio < 0.0 ? -1.0 : 1.0) /
                                 (fabs(ratio) + square_root(ratio * ratio + 1.0));
                const double c = 1.0 / square_root(t * t + 1.0), s = t * c;
                for (int k = 0; k < n; k++) {
                    const double left = a[k][p], right = a[k][q];
                    a[k][p] = c * left - s * right;
                    a[k][q] = s * left + c * right;
                }
                for (int k = 0; k < n; k++) {
                    const double upper = a[p][k], lower = a[q][k];
                    a[p][k] = c * upper - s * lower;
                    a[q][k] = s * upper + c * lower;
                }
                a[p][q] = a[q][p] = 0.0;
            }
    double largest = a[0][0];
    for (int k = 1; k < n; k++)
        largest = a[k][k] > largest ? a[k][k] : largest;
    return largest;
}

/* Element of the Delassus operator, 1/kg: the velocity at one row that an impulse at another gives.
 * Rows are x, y, z of feet A, B, C. */
static double delassus(const BodyConstants *p, int row, int column) {
    static const Vector unit[] = {{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}};
    const Vector centre = {p->centre_x, p->centre_y, 0.0};
    const Vector at_row = plus(p->contact.foot[row / 3], -1.0, centre);
    const Vector at_column = plus(p->contact.foot[column / 3], -1.0, centre);
    const Vector turn = times(p->inverse_inertia, cross(at_column, unit[column % 3]));
    return p->inverse_mass * dot(unit[row % 3], unit[column % 3]) +
           dot(unit[row % 3], cross(turn, at_row));
}

/* Largest eigenvalue of those rows and columns of the operator, each divided by the roots
 * of the scales of x, y and z. */
static double largest_of(const BodyConstants *p, const int rows[], int n,
                         const double root[3]) {
    double a[ROWS][ROWS];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            a[i][j] = delassus(p, rows[i], rows[j]) / (root[rows[i] % 3] * root[rows[j] % 3]);
    return largest_eigenvalue(a, n);
}

/* To 12 digits. */
static double rounded(double value) {
    char text[32];
    snprintf(text, sizeof text, "%.12g", value);
    return strtod(text, NULL);
}

/* Step sizes with which every sweep is a contraction. */
static void design_solver(BodyConstants *p) {
    static const int all[] = {0, 3, 6, 1, 4, 7, 2, 5, 8}; /* x, y, then z of all feet */
    static const double one[] = {1.0, 1.0, 1.0};
    const double normal = largest_of(p, all + 6, 3, one);
    const double tangential = largest_of(p, all, 6, one);
    const double root[] = {square_root(tangential), square_root(tangential), square_root(normal)};
    const double largest = largest_of(p, all, ROWS, root);
    p->contact.step_normal = rounded(1.0 / (largest * normal));
    p->contact.step_tangential = rounded(1.0 / (largest * tangential));
}

/* A uniform cylinder on three feet at 60, 180 and -60 degrees; the centre of mass where it is said. */
static BodyConstants design_body(double mass, double diameter, double height, double com_height,
                                 double foot_radius, double g) {
    const double radius = diameter / 2.0;
    const double i_zz = mass * (radius * radius) / 2.0;
    const double i_xx = mass * (3.0 * (radius * radius) + height * height) / 12.0;
    const double x = foot_radius * 0.5000000000000001, y = foot_radius * 0.8660254037844386;
    return (BodyConstants){
        .inverse_mass = 1.0 / mass,
        .inertia = {i_xx, i_xx, i_zz},
        .inverse_inertia = {1.0 / i_xx, 1.0 / i_xx, 1.0 / i_zz},
        .gravity = {0.0, 0.0, -g},
        .contact.foot = {{x, y, -com_height}, {-foot_radius, 0.0, -com_height},
                         {x, -y, -com_height}},
        .contact.spin_inertia = i_zz / foot_radius,
    };
}

#endif

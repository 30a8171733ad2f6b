/* Vectors and unit quaternions: cosim/physics/rotation.py in C, with the same operations in the same
 * order. A quaternion and its matrix turn body-frame components into world-frame ones. */
#ifndef VECTOR_H
#define VECTOR_H

#include "exact.h"

typedef struct {
    double x, y, z;
} Vector;

typedef struct {
    double w, x, y, z;
} Quaternion;

typedef struct {
    Vector x, y, z; /* rows */
} Matrix;

INLINE double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

INLINE Vector cross(Vector a, Vector b) {
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

INLINE Vector scaled(double scale, Vector v) {
    return (Vector){scale * v.x, scale * v.y, scale * v.z};
}

/* The sum a + scale b. */
INLINE Vector plus(Vector a, double scale, Vector b) {
    return (Vector){a.x + scale * b.x, a.y + scale * b.y, a.z + scale * b.z};
}

/* Product of a diagonal tensor and a vector. */
INLINE Vector times(Vector diagonal, Vector v) {
    return (Vector){diagonal.x * v.x, diagonal.y * v.y, diagonal.z * v.z};
}

/* World from body, of a unit quaternion. */
INLINE Matrix rotation_matrix(Quaternion q) {
    return (Matrix){
        {1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y - q.w * q.z),
         2.0 * (q.x * q.z + q.w * q.y)},
        {2.0 * (q.x * q.y + q.w * q.z), 1.0 - 2.0 * (q.x * q.x + q.z * q.z),
         2.0 * (q.y * q.z - q.w * q.x)},
        {2.0 * (q.x * q.z - q.w * q.y), 2.0 * (q.y * q.z + q.w * q.x),
         1.0 - 2.0 * (q.x * q.x + q.y * q.y)},
    };
}

INLINE Vector to_world(Matrix m, Vector v) {
    return (Vector){dot(m.x, v), dot(m.y, v), dot(m.z, v)};
}

INLINE Vector to_body(Matrix m, Vector v) {
    return (Vector){m.x.x * v.x + m.y.x * v.y + m.z.x * v.z,
                    m.x.y * v.x + m.y.y * v.y + m.z.y * v.z,
                    m.x.z * v.x + m.y.z * v.y + m.z.z * v.z};
}

/* After the body-frame rotation with Cayley vector r. */
INLINE Quaternion rotated(Quaternion q, Vector r) {
    const double rx = 0.5 * r.x, ry = 0.5 * r.y, rz = 0.5 * r.z;
    const double w = q.w - q.x * rx - q.y * ry - q.z * rz;
    const double x = q.x + q.w * rx + q.y * rz - q.z * ry;
    const double y = q.y + q.w * ry + q.z * rx - q.x * rz;
    const double z = q.z + q.w * rz + q.x * ry - q.y * rx;
    /* One Newton step for the inverse root of the square. */
    const double scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z);
    return (Quaternion){w * scale, x * scale, y * scale, z * scale};
}

#endif

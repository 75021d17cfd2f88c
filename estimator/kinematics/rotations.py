"""Rotations for compiled functions: unit quaternions (x, y, z, w), matrices, rotation vectors.

Quaternions are tuples, so that nothing is allocated. Scalar last, as in ROS and in
`scipy.spatial.transform.Rotation`, which cannot be called from compiled code. A rotation vector is
axis times angle [rad], the logarithm of the rotation.
"""

import math
from typing import TypeAlias

from estimator.array_types import Array
from estimator.compiled import jit_compile

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

SERIES_LIMIT = 1.0
"""Squared angle [rad^2] below which the functions of an angle are series: 10 terms are exact."""

_TERMS = 10


@jit_compile
def compute_angle_functions(squared_angle: float) -> tuple[float, float, float]:
    """Return B, C and E of an angle phi, given phi^2; smooth through zero.

    B = (1 - cos phi) / phi^2, C = (phi - sin phi) / phi^3, E = (1/2 - B) / phi^2. From these,
    sin phi / phi = 1 - phi^2 C, cos phi = 1 - phi^2 B, and with z = phi^2, 2 dB/dz = 2 E - C and
    2 d(sin phi / phi)/dz = C - B, all without cancellation.
    """
    x = squared_angle
    if x > SERIES_LIMIT:
        angle = math.sqrt(x)
        B = 2.0 * math.sin(0.5 * angle) ** 2 / x
        C = (1.0 - math.sin(angle) / angle) / x
        return B, C, (0.5 - B) / x
    B = C = E = 1.0
    for k in range(_TERMS, 0, -1):
        B = 1.0 - x / ((2 * k + 1) * (2 * k + 2)) * B
        C = 1.0 - x / ((2 * k + 2) * (2 * k + 3)) * C
        E = 1.0 - x / ((2 * k + 3) * (2 * k + 4)) * E
    return B / 2.0, C / 6.0, E / 24.0


@jit_compile
def to_quaternion(x: float, y: float, z: float) -> Quaternion:
    """Return the quaternion of a rotation vector [rad]."""
    quarter = 0.25 * (x * x + y * y + z * z)
    B, C, _ = compute_angle_functions(quarter)
    half_sine = 0.5 * (1.0 - quarter * C)  # sin(phi/2) / phi
    return make_canonical((half_sine * x, half_sine * y, half_sine * z, 1.0 - quarter * B))


@jit_compile
def to_rotation_vector(q: Quaternion) -> Vector:
    """Return the rotation vector [rad] of a unit quaternion, of at most pi."""
    x, y, z, w = make_canonical(q)
    sine = math.sqrt(x * x + y * y + z * z)
    # atan2(s, w) / s, 1 in the limit: w is 1 to rounding there
    factor = 2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 2.0
    return factor * x, factor * y, factor * z


@jit_compile
def make_canonical(q: Quaternion) -> Quaternion:
    """Return a quaternion at unit length with the sign that is canonical.

    w is positive; where it is zero, the first of x, y and z that is not. One of no length or that
    is not finite becomes the identity: what reads it checks before.
    """
    x, y, z, w = q
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not 0.0 < length < math.inf:
        return 0.0, 0.0, 0.0, 1.0
    first = w
    for component in (x, y, z):
        if first == 0.0:
            first = component
    scale = 1.0 / length if first > 0.0 else -1.0 / length
    return scale * x, scale * y, scale * z, scale * w


@jit_compile
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation `b` followed by the rotation `a`, about axes that do not move."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@jit_compile
def compute_rotation_between(a: Quaternion, b: Quaternion) -> Vector:
    """Return the rotation vector [rad] that leads from `a` to `b`, in their common frame."""
    return to_rotation_vector(multiply(b, (-a[0], -a[1], -a[2], a[3])))


@jit_compile
def rotate(q: Quaternion, x: float, y: float, z: float) -> Vector:
    """Return a vector rotated by a unit quaternion."""
    u, v, w, s = q
    a = 2.0 * (v * z - w * y)
    b = 2.0 * (w * x - u * z)
    c = 2.0 * (u * y - v * x)
    return x + s * a + v * c - w * b, y + s * b + w * a - u * c, z + s * c + u * b - v * a


@jit_compile
def to_rotation_matrix(q: Quaternion, matrix: Array) -> None:
    """Write the matrix of a unit quaternion into the first three rows and columns of `matrix`."""
    matrix[0, 0], matrix[1, 0], matrix[2, 0] = rotate(q, 1.0, 0.0, 0.0)
    matrix[0, 1], matrix[1, 1], matrix[2, 1] = rotate(q, 0.0, 1.0, 0.0)
    matrix[0, 2], matrix[1, 2], matrix[2, 2] = rotate(q, 0.0, 0.0, 1.0)


@jit_compile
def from_rotation_matrix(matrix: Array) -> Quaternion:
    """Return the canonical quaternion of the rotation in the first three rows and columns.

    By the largest of the four components (Shepperd 1978), so that no angle loses digits.
    """
    r = matrix
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace >= max(r[0, 0], r[1, 1], r[2, 2]):
        q = (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1.0 + trace)
    elif r[0, 0] >= max(r[1, 1], r[2, 2]):
        q = (
            1.0 + 2.0 * r[0, 0] - trace,
            r[0, 1] + r[1, 0],
            r[0, 2] + r[2, 0],
            r[2, 1] - r[1, 2],
        )
    elif r[1, 1] >= r[2, 2]:
        q = (
            r[0, 1] + r[1, 0],
            1.0 + 2.0 * r[1, 1] - trace,
            r[1, 2] + r[2, 1],
            r[0, 2] - r[2, 0],
        )
    else:
        q = (
            r[0, 2] + r[2, 0],
            r[1, 2] + r[2, 1],
            1.0 + 2.0 * r[2, 2] - trace,
            r[1, 0] - r[0, 1],
        )
    return make_canonical(q)

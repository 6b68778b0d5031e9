"""What directions tell about a rotation: the information matrix M = sum(I - b b^T).

The covariance of an attitude fitted to unit vectors b that each carry an error sigma along both
tangent axes is sigma^2 M^-1 (Shuster and Oh 1981). A symmetric matrix (3, 3) is a tuple of its
elements xx, xy, xz, yy, yz, zz here, which stays in registers.
"""

from star_tracker.compiled import inlined

Symmetric = tuple[float, float, float, float, float, float]


@inlined
def with_direction(m: Symmetric, x: float, y: float, z: float) -> Symmetric:
    """Return m + I - b b^T for the unit vector b = (x, y, z)."""
    return (
        m[0] + (1 - x * x), m[1] - x * y, m[2] - x * z,
        m[3] + (1 - y * y), m[4] - y * z, m[5] + (1 - z * z),
    )


@inlined
def with_scale(c: tuple[float, float, float], x: float, y: float, z: float) -> tuple[
    float, float, float
]:
    """Return what b = (x, y, z) adds to the information that rotation and log f share.

    A small rotation w and a step s of log f move b by w x b + s d, d = b (1 - z^2) - (x, y, 0).
    The sum of d^2 is the third element, that of b x d the first two; its z component is 0.
    """
    return c[0] + z * y, c[1] - z * x, c[2] + (1 - z * z) * z * z


@inlined
def adjugate(m: Symmetric) -> Symmetric:
    """Return the adjugate of a symmetric matrix: its inverse times its determinant."""
    xx, xy, xz, yy, yz, zz = m
    return (
        yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy,
        xx * zz - xz * xz, xz * xy - xx * yz, xx * yy - xy * xy,
    )


@inlined
def determinant(m: Symmetric, adjugate_of_m: Symmetric) -> float:
    """Return the determinant of a symmetric matrix, given its adjugate."""
    return m[0] * adjugate_of_m[0] + m[1] * adjugate_of_m[1] + m[2] * adjugate_of_m[2]

"""Directions on the sphere: right ascension and declination, separations, position angles.

All angles are radians. Vectors are unit vectors with the last axis of length 3. Separations are
taken from chords, never from the arccosine of a dot product: that loses half of the digits for
the small angles which star pairs are made of.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
ARCSEC_PER_RAD = math.degrees(1) * 3600


def unit_vectors(ra_rad: ArrayLike, dec_rad: ArrayLike) -> Floats:
    """Return unit vectors (..., 3) towards right ascension and declination (paper, 4-3)."""
    ra, dec = np.asarray(ra_rad, float), np.asarray(dec_rad, float)
    cos_dec = np.cos(dec)
    return np.stack([cos_dec * np.cos(ra), cos_dec * np.sin(ra), np.sin(dec)], axis=-1)


def ra_dec(vectors: ArrayLike) -> tuple[Floats, Floats]:
    """Return right ascension in [0, 2 pi) and declination of vectors (..., 3), any length."""
    v = np.asarray(vectors, float)
    ra = np.arctan2(v[..., 1], v[..., 0]) % (2 * np.pi)
    # A tiny negative angle modulo 2 pi rounds up to 2 pi itself.
    ra = np.where(ra >= 2 * np.pi, 0.0, ra)
    dec = np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1]))
    return ra, dec


def separation(a: ArrayLike, b: ArrayLike) -> Any:
    """Return the angle between unit vectors `a` and `b` (..., 3), exact from 0 to pi."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    half_sine = np.linalg.norm(a - b, axis=-1)
    half_cosine = np.linalg.norm(a + b, axis=-1)
    return 2 * np.arctan2(half_sine, half_cosine)


def chord(angle_rad: ArrayLike) -> Any:
    """Return the chord of the unit sphere that subtends an angle."""
    return 2 * np.sin(np.asarray(angle_rad, float) / 2)


def tangent_basis(vectors: ArrayLike) -> tuple[Floats, Floats]:
    """Return the unit vectors east and north (..., 3) tangent at unit vectors (..., 3).

    At the poles themselves, where north has no meaning, the basis is that of right ascension 0.
    """
    ra, _ = ra_dec(vectors)
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)], axis=-1)
    return east, np.cross(np.asarray(vectors, float), east)


def position_angle(
    origin: ArrayLike, target: ArrayLike, pole: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> Floats:
    """Return the direction from `origin` to `target`, from north towards east, in [0, 2 pi).

    Both are unit vectors (..., 3); north is the direction of `pole`. At the pole the result is
    arbitrary. Written out in components: on a few vectors `numpy.cross` costs ten times as much.
    """
    v, t = np.asarray(origin, float), np.asarray(target, float)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    px, py, pz = pole
    east = (
        t[..., 0] * (py * z - pz * y)
        + t[..., 1] * (pz * x - px * z)
        + t[..., 2] * (px * y - py * x)
    )
    north = t @ np.array(pole) - (px * x + py * y + pz * z) * np.sum(t * v, axis=-1)
    angle = np.arctan2(east, north) % (2 * np.pi)
    return np.asarray(np.where(angle >= 2 * np.pi, 0.0, angle))

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of feed compensation, stitched on the simulated sheet.

Rows are in the paper's units, degrees and millimetres, as the models of deformation take them.
"""

from math import radians
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.simulation.soft.foam_sheet import STITCH_NOISE, FoamSheet

ARC, LINE = 1, 2
"""Types of primitives, third column of a row."""

_ANGLES = (0.0, 15.0, 30.0, 45.0, 60.0)
_THICKNESSES = (5.0, 15.0, 20.0, 25.0, 35.0)
_SAMPLES_EACH, _DRAWN_ANGLES = 53, 3
LINE_LENGTH, ARC_LENGTH, ARC_RADIUS = 50e-3, 30e-3, 25e-3
"""Of the primitives that samples are taken from [m]."""
_REFERENCE_LENGTH_MM = 50.0


class FoamSamples(NamedTuple):
    """Process values and the compensation that they called for.

    Attributes
    ----------
    x : ndarray, shape (samples, 5)
        Direction [deg], feed depth [mm], type (1 arc, 2 line), stitch step [mm], thickness [mm].
    s : ndarray, shape (samples, 2)
        Offset needed per 50 mm of feed, X then Y [mm].
    """

    x: Array
    s: Array


def foam_samples(seed: int = 0, friction: float = 1.0) -> FoamSamples:
    """Return 265 samples, 53 of each of five thicknesses.

    Parameters
    ----------
    seed : int
        Seed of what is drawn: processes, scatter of the sheets, noise of the stitches.
    friction : float
        Friction relative to the nominal sheet [-]; not negative.

    Returns
    -------
    FoamSamples
        Thinnest sheets first.

    Raises
    ------
    ValueError
        If the friction is negative or not finite.

    Examples
    --------
    >>> x, s = foam_samples(0)
    >>> x[0].tolist(), s[0].round(5).tolist()
    ([0.0, 1.5, 2.0, 3.0, 5.0], [5.84776, -2.32934])
    """
    rng = np.random.default_rng(seed)
    x, s = [], []
    for thickness in _THICKNESSES:
        for index in range(_SAMPLES_EACH):
            drawn = index >= _SAMPLES_EACH - _DRAWN_ANGLES
            angle = _ANGLES[rng.integers(len(_ANGLES)) if drawn else index % len(_ANGLES)]
            kind = LINE if rng.random() < 0.7 else ARC
            depth = round(2.0 * thickness * rng.uniform(0.25, 0.55)) / 2.0
            step = float(rng.integers(2, 6))
            x.append((angle, depth, kind, step, thickness))
            s.append(_sample(x[-1], friction, rng))
    return FoamSamples(np.array(x), np.array(s))


def true_compensation(x: ArrayLike, friction: float = 1.0) -> Array:
    """Return what samples of the nominal sheet without noise call for.

    Parameters
    ----------
    x : array_like, shape (samples, 5)
        Rows as in `FoamSamples`.
    friction : float
        Friction relative to the nominal sheet [-]; not negative.

    Returns
    -------
    ndarray, shape (samples, 2)
        Offset needed per 50 mm of feed, X then Y [mm].

    Raises
    ------
    ValueError
        If a row cannot be stitched: a figure not finite, a type other than 1 and 2, a step of
        more than the whole sample, a depth or thickness of 0 or less.

    Examples
    --------
    >>> true_compensation([[45, 6, 2, 3, 15], [45, 6, 1, 3, 15]]).round(4).tolist()
    [[2.4964, 1.882], [1.9051, 2.6909]]
    """
    rows = np.asarray(x, float)
    if rows.ndim != 2 or rows.shape[1] != 5 or not np.isfinite(rows).all():
        raise ValueError(
            f'x: expected finite rows of direction, depth, type, step and thickness, shape '
            f'(samples, 5), but found shape {rows.shape}'
        )
    different, of_row = np.unique(rows, axis=0, return_inverse=True)
    found = np.array([_sample(tuple(row), friction) for row in different]).reshape(-1, 2)
    return found[of_row.reshape(-1)]


def _sample(
    row: tuple[float, ...], friction: float, rng: np.random.Generator | None = None
) -> Array:
    """Stitch one sample and return its compensation per 50 mm [mm]."""
    angle, depth, kind, step, thickness = row
    if kind not in (ARC, LINE):
        raise ValueError(f'type: expected 1 (arc) or 2 (line) but found {kind:g}')
    sheet = FoamSheet(1e-3 * thickness, friction=friction * FoamSheet.friction)
    length = LINE_LENGTH if kind == LINE else ARC_LENGTH
    steps = round(length / (1e-3 * step)) if step > 0.0 else 0
    if steps < 1:
        raise ValueError(
            f'step: expected more than 0 mm and at most the {1e3 * length:g} mm of the sample '
            f'but found {step} mm'
        )
    noise = np.zeros((steps + 1, 2))
    if rng is not None:
        sheet = sheet.scattered(rng)
        noise = rng.normal(0.0, STITCH_NOISE, (steps + 1, 2))
    points = _course(kind, radians(angle), steps) + 0.5 * np.array(sheet.size)
    stitched = sheet.stitch(points, 1e-3 * depth, 1 if kind == ARC else 0) + noise
    drift = points - stitched
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    offset = (
        _REFERENCE_LENGTH_MM * portable.matmul(way, drift - drift[0]) / portable.matmul(way, way)
    )
    return np.asarray(offset)


def _course(kind: float, angle: float, steps: int) -> Array:
    """Return points of a sample whose middle is the origin, shape (steps + 1, 2) [m]."""
    along = np.array([portable.cos(angle), portable.sin(angle)])
    if kind == LINE:
        return np.outer(np.linspace(-0.5, 0.5, steps + 1) * LINE_LENGTH, along)
    left = np.array([-along[1], along[0]])
    turned = np.linspace(-0.5, 0.5, steps + 1) * ARC_LENGTH / ARC_RADIUS
    return ARC_RADIUS * (
        np.outer(portable.sin(turned), along) + np.outer(1.0 - portable.cos(turned), left)
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How a sheet takes its drift back along the path, identified from one recorded run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array

_LENGTHS = np.arange(20.0, 200.1, 2.5) * 1e-3  # that are tried [m]
_SETTLED = 4  # least steps of a side that its two figures can be told from


@dataclass(frozen=True, eq=False)
class Relaxation:
    """What a recorded run tells of the sheet; lengths go into `CompensationConfig`.

    Attributes
    ----------
    leak_length : float
        Way over which the drift fades [m].
    prompt_length : float
        Way whose drift the sheet gives way at once [m].
    rate : ndarray, shape (sides, 2)
        Drift that a side adds per feed [-].
    jump : ndarray, shape (sides, 2)
        Drift that is there as long as the foot goes along a side [m].
    residual : float
        Root mean square of what is left, over both axes [m].
    tried, error : ndarray, shape (lengths,)
        Fading lengths that were tried and their residuals [m].
    """

    leak_length: float
    prompt_length: float
    rate: Array
    jump: Array
    residual: float
    tried: Array
    error: Array


def identify_relaxation(
    commanded: ArrayLike,
    stitched: ArrayLike,
    corners: Sequence[int],
    lengths: ArrayLike = _LENGTHS,
) -> Relaxation:
    """Identify how the drift fades from one run of straight sides.

    The drift commanded minus stitched is taken for D + o_side with
    D' = D exp(-length / leak_length) + g_side length (method sheet 000 section 6.5); for each
    fading length the g and o follow by least squares, and the length with the least residual is
    kept.  Ratio of o to g, over all sides, is `prompt_length`.

    Parameters
    ----------
    commanded, stitched : array_like, shape (n + 1, 2)
        Points of a run without compensation, in the order of stitching [m].
    corners : sequence of int
        Indices at which sides begin and end, first and last point included.
    lengths : array_like, shape (lengths,)
        Fading lengths to be tried [m].

    Returns
    -------
    Relaxation
        Lengths, rates and residuals.

    Raises
    ------
    ValueError
        If the points are not finite or not parallel, the corners do not cut the path into two
        or more sides of four steps at least, or the run is too short or too straight to tell
        fading lengths from one another: the least residual lies at the end of those tried.
    """
    path, found = np.asarray(commanded, float), np.asarray(stitched, float)
    if path.ndim != 2 or path.shape[1] != 2 or path.shape != found.shape:
        raise ValueError(
            f'expected commanded and stitched points of the same shape (n + 1, 2) but found '
            f'{path.shape} and {found.shape}'
        )
    drift = path - found
    if not np.isfinite(drift).all():
        raise ValueError('points: expected finite coordinates [m] but found some that are not')
    cuts = np.asarray(corners)
    if (
        len(cuts) < 3
        or cuts[0] != 0
        or cuts[-1] != len(path) - 1
        or (np.diff(cuts) < _SETTLED).any()
    ):
        raise ValueError(
            f'corners: expected 0 to {len(path) - 1} in two or more sides of at least {_SETTLED} '
            f'steps but found {cuts.tolist()}'
        )
    tried = np.asarray(lengths, float)
    way = np.hypot(*np.diff(path, axis=0).T)
    side = np.repeat(np.arange(len(cuts) - 1), np.diff(cuts))
    fits = [_fit(drift, way, side, length) for length in tried]
    error = np.array([np.sqrt(np.mean(left**2)) for _, left in fits])
    best = int(error.argmin())
    if best in (0, len(tried) - 1):
        raise ValueError(
            f'lengths: expected the least residual between {1e3 * tried[0]:g} and '
            f'{1e3 * tried[-1]:g} mm but found it at {1e3 * tried[best]:g} mm; record a longer '
            'run with corners, or widen the lengths that are tried'
        )
    rate, jump = np.split(fits[best][0], 2)
    prompt = max(float((jump * rate).sum() / (rate**2).sum()), 0.0)
    return Relaxation(float(tried[best]), prompt, rate, jump, float(error[best]), tried, error)


def _fit(drift: Array, way: Array, side: NDArray[np.intp], length: float) -> tuple[Array, Array]:
    """Return rates and jumps of the sides, shape (2 sides, 2), and what they leave [m]."""
    sides = int(side[-1]) + 1
    steps = np.zeros((len(way), sides))
    steps[np.arange(len(way)), side] = way
    columns = np.zeros((len(way), 2 * sides))
    fed = np.zeros(sides)
    for n, fading in enumerate(np.exp(-way / length)):
        fed = fed * fading + steps[n]
        columns[n, :sides] = fed
    columns[:, sides:] = steps > 0.0
    solution, *_ = np.linalg.lstsq(columns, drift[1:] - drift[0], rcond=None)
    return solution, drift[1:] - drift[0] - columns @ solution

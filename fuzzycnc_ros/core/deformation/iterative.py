# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Iterative learning: offsets of a track from recorded runs of the same track."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.deformation.compensation import CompensatedPath, CompensationConfig
from fuzzycnc_ros.core.deformation.offset_limits import limit_offsets

LEARNING_GAIN = 0.7
"""Share of the deviation that one cycle takes away [-]."""


def learn_offsets(
    path: CompensatedPath,
    stitched: ArrayLike,
    *,
    gain: float = LEARNING_GAIN,
    config: CompensationConfig | None = None,
    size: tuple[float, float] | None = None,
) -> CompensatedPath:
    """Return the path of the next cycle: off + gain (nominal - stitched).

    Parameters
    ----------
    path : CompensatedPath
        Path that was commanded; `CompensatedPath.unchanged` in the first cycle, or what a model
        made of it.
    stitched : array_like, shape (n + 1, 2) or (runs, n + 1, 2)
        Stitched points of one recorded run of that path, or of several, whose mean counts [m].
    gain : float
        Share of the deviation to be taken away [-]; more than 0, at most 1.
    config : CompensationConfig, optional
        Whose `offset_max` and `progress_min` the offsets keep; the defaults if left out.
    size : tuple of float, optional
        Clamped area from the origin, on which the tool is kept [m].

    Returns
    -------
    CompensatedPath
        With new offsets and the flags of their limits; compensation and support as they were.

    Raises
    ------
    ValueError
        If a run is not finite or not parallel to the path, or the gain out of its range.

    Notes
    -----
    A refused step may be learnt: its offset comes from a run and no model.

    Examples
    --------
    Three cycles on the test track of method sheet 000, a recorded run each:

    >>> from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
    >>> from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack
    >>> track, rng = FoamTrack.parallelogram(np.pi / 4), np.random.default_rng(0)
    >>> path, errors = CompensatedPath.unchanged(track.points), []
    >>> for cycle in range(4):
    ...     sheet = FoamSheet(15e-3, (0.15, 0.1)).scattered(rng)
    ...     stitched = sheet.stitch(path.commanded, 6e-3, rng=rng)
    ...     errors.append(float(np.degrees(track.measure(stitched).angle_error).round(2)))
    ...     path = learn_offsets(path, stitched)
    >>> errors  # [deg]
    [5.16, 1.77, 0.5, 0.09]
    """
    config = CompensationConfig() if config is None else config
    if not 0.0 < gain <= 1.0:
        raise ValueError(f'gain: expected more than 0 and at most 1 but found {gain}')
    runs = np.asarray(stitched, float)
    runs = runs[np.newaxis] if runs.ndim == 2 else runs
    if runs.ndim != 3 or runs.shape[1:] != path.nominal.shape or not len(runs):
        raise ValueError(
            f'stitched: expected runs of the same track, shape {path.nominal.shape} each, but '
            f'found shape {np.shape(stitched)}; learn each track from its own recordings'
        )
    if not np.isfinite(runs).all():
        raise ValueError(
            'stitched: expected finite coordinates [m] but found some that are not; leave runs '
            'with lost stitches out'
        )
    wanted = path.offset + gain * (path.nominal - runs.mean(axis=0))
    offset, flag = limit_offsets(
        path.nominal,
        wanted,
        offset_max=config.offset_max,
        progress_min=config.progress_min,
        size=size,
    )
    return replace(path, offset=offset, flag=flag)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scheduling of a path that arrives in parts, with bounded memory."""

from collections.abc import Iterable, Iterator

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.sampled_path import WINDOW_EDGE, SampledPath
from fuzzycnc_ros.core.feedrate.schedulers.plain import Scheduler


def stream_ratio(scheduler: Scheduler, parts: Iterable[SampledPath]) -> Iterator[Array]:
    """Return the ratios of an open path part by part, the same as of the whole path.

    Points leave as soon as all that their feed depends on has arrived; no more than the reach of
    the scheduler to both sides, and one part, is kept.

    Parameters
    ----------
    scheduler : Scheduler
        Scheduler whose reach is finite.
    parts : iterable of SampledPath
        Successive parts of the path, whose arc length goes on increasing from one to the next.

    Yields
    ------
    ndarray
        Ratios of the next points, as `Scheduler.ratio` gives them; altogether one for each point.

    Raises
    ------
    ValueError
        If the scheduler needs the whole path, or the arc lengths of the parts do not follow each
        other.
    """
    reach = scheduler.reach
    if not np.isfinite([reach.length_behind, reach.length_ahead]).all():
        raise ValueError(
            f'expected a scheduler that can take a path in parts, but found {scheduler!r}, which '
            'needs all of it; fix what it takes from the path, such as curvature_max'
        )
    kept: SampledPath | None = None
    done = 0  # points of `kept` whose ratios have left
    for part in parts:
        kept = part if kept is None else _joined(kept, part)
        ready = _ready(kept.arc_length, reach.points_ahead, reach.length_ahead)
        if ready <= done:
            continue
        yield scheduler.bounded_ratio(kept)[done:ready]
        first = _first_needed(kept.arc_length, ready, reach.points_behind, reach.length_behind)
        kept, done = _from_point(kept, first), ready - first
    if kept is not None:
        yield scheduler.bounded_ratio(kept)[done:]


def _ready(arc_length: Array, points: int, length: float) -> int:
    """Return how many points have all that is ahead of them."""
    if not length:
        return max(len(arc_length) - points, 0)
    known = int(np.searchsorted(arc_length, arc_length[-1] - length * WINDOW_EDGE)) - points
    if known <= 0:
        return 0
    # What lies within the length ahead depends on points ahead of it in its turn.
    return int(np.searchsorted(arc_length, arc_length[known - 1] - length * WINDOW_EDGE))


def _first_needed(arc_length: Array, ready: int, points: int, length: float) -> int:
    """Return the first point that the next one to leave depends on."""
    # The last point stays in any case, so that what follows is seen to follow it.
    first = max(min(ready, len(arc_length) - 1) - points, 0)
    return int(np.searchsorted(arc_length, arc_length[first] - length * WINDOW_EDGE))


def _from_point(path: SampledPath, first: int) -> SampledPath:
    """Return the path from a point on."""
    return SampledPath(
        path.arc_length[first:],
        path.curvature[first:],
        reversal=path.reversal[first:],
        programmed=None if path.programmed is None else path.programmed[first:],
    )


def _joined(path: SampledPath, part: SampledPath) -> SampledPath:
    """Return a path and the part after it as one."""
    return SampledPath(
        np.concatenate([path.arc_length, part.arc_length]),
        np.concatenate([path.curvature, part.curvature]),
        reversal=np.concatenate([path.reversal, part.reversal]),
        programmed=None
        if path.programmed is None or part.programmed is None
        else np.concatenate([path.programmed, part.programmed]),
    )

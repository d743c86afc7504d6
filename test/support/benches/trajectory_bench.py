# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Makes trajectories along any path, part by part, each with a way to rest at its end."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryPart
from fuzzycnc_ros.runtime.records import Trajectory

PERIOD = 1e-3
SECOND = 1_000_000_000
AXES = ('X', 'Y', 'Z')


def trapezoid(length: float, speed: float = 0.1, push: float = 1.0) -> np.ndarray:
    """Return the way at every period [m] from rest to rest."""
    speed = min(speed, np.sqrt(length * push))
    ramp = speed / push
    duration = length / speed + ramp
    time = np.minimum(PERIOD * np.arange(int(np.ceil(duration / PERIOD)) + 1), duration)
    left = duration - time
    way = np.where(time < ramp, 0.5 * push * time**2, speed * (time - 0.5 * ramp))
    return np.where(left < ramp, length - 0.5 * push * left**2, way)


def line(way: np.ndarray, direction: Any = (0.6, -0.8, 0.0)) -> np.ndarray:
    """Return positions along a straight line from the origin, shape (n, 3) [m]."""
    return np.multiply.outer(np.asarray(way), np.asarray(direction))


def rows(
    point: Callable[[np.ndarray], np.ndarray], way: np.ndarray, chunk: int, push: float = 1.0
) -> Iterator[tuple[int, int, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield first sample, committed samples, positions, velocities and way of each part."""
    place = point(way)
    velocity = np.gradient(place, PERIOD, axis=0)
    for first in range(0, len(way), chunk):
        last = min(first + chunk, len(way))
        tail = np.zeros(0)
        if last < len(way):
            speed = (way[last - 1] - way[max(last - 2, 0)]) / PERIOD
            speeds = np.maximum(speed - push * PERIOD * np.arange(1, 2000), 0.0)
            tail = way[last - 1] + PERIOD * np.cumsum(speeds[: int((speeds > 0.0).sum()) + 1])
            tail = np.minimum(tail, way[-1])
        known = np.concatenate([way[max(last - 2, 0) : last], tail])
        end = np.gradient(point(known), PERIOD, axis=0)[len(known) - len(tail) :]
        yield (
            first,
            last - first,
            np.concatenate([place[first:last], point(tail)]) if len(tail) else place[first:last],
            np.concatenate([velocity[first:last], end]),
            np.concatenate([way[first:last], tail]),
        )


def parts(
    point: Callable[[np.ndarray], np.ndarray] = line,
    way: np.ndarray | None = None,
    *,
    start: float | int = 0.1,
    chunk: int = 100,
    path_id: str = 'path',
    epoch: int = 1,
) -> list[TrajectoryPart]:
    """Return the parts of a path, by default a straight line of 50 mm."""
    way = trapezoid(0.05) if way is None else way
    begin = start if isinstance(start, int) else round(start * SECOND)
    found = list(rows(point, way, chunk))
    return [
        TrajectoryPart(
            path_id=path_id,
            epoch=epoch,
            part=number,
            last=number == len(found) - 1,
            start=begin + first * round(PERIOD * SECOND),
            period=PERIOD,
            committed=committed,
            axis=AXES[: place.shape[1]],
            position=place.ravel(),
            velocity=velocity.ravel(),
            arc_length=arc,
        )
        for number, (first, committed, place, velocity, arc) in enumerate(found)
    ]


def record(part: TrajectoryPart, stamp: int) -> Trajectory:
    """Return the message of a part that was made at a stamp [ns]."""
    values = {name: getattr(part, name) for name in TrajectoryPart.__dataclass_fields__}
    return Trajectory(stamp=stamp, frame_id='mill/workpiece', **values)

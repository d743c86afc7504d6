# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A motion on its way to the machine, part by part, each with a way to rest."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fuzzycnc_ros.core.feedrate.motion.waypoints import Sampled
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import Names, Trajectory, nanoseconds


@dataclass(frozen=True)
class PathHeader:
    """Common part of all parts of a path."""

    path_id: str
    epoch: int
    frame_id: str


class PartTimes(Protocol):
    """Configured durations of parts and their lead, all in seconds."""

    @property
    def period(self) -> float:
        """Time between two samples."""

    @property
    def chunk(self) -> float:
        """Length of a part."""

    @property
    def lead(self) -> float:
        """Lead of a part: the time between its sending and its first sample."""


class PartsRun:
    """Count what has been sent of a motion, and make its next part.

    Parameters
    ----------
    header : PathHeader
        What its parts say of it.
    axis : tuple of str
        Axes that move.
    pace : PartTimes
        How much is sent how early.
    start : int
        Machine time of the first sample [ns].
    """

    def __init__(self, header: PathHeader, axis: Names, pace: PartTimes, start: int) -> None:
        self.header, self.start = header, start
        self._axis, self._pace = axis, pace
        self._period = nanoseconds(pace.period)
        self._taken = 0
        self.part = 0
        """Number of parts sent so far."""
        self.complete = False
        """True if the last part has been sent."""
        self.at_rest = start
        """Machine time at which the axes rest if nothing more is sent [ns]."""

    @property
    def end(self) -> int:
        """Machine time of the first sample that has not been sent [ns]."""
        return self.start + self._taken * self._period

    @property
    def next_send(self) -> int:
        """Machine time at which the next part is to be sent [ns]."""
        return self.end - nanoseconds(self._pace.lead)

    @property
    def _chunk(self) -> int:
        """Samples of a part."""
        return nanoseconds(self._pace.chunk) // self._period

    def _emit(self, stamp: int, samples: Sampled, tail: Sampled | None) -> Emission:
        """Return the next part: committed samples, and how to come to rest after them."""
        start, committed = self.end, len(samples.arc_length)
        parts = [samples] if tail is None else [samples, tail]
        position, velocity, arc_length = (
            np.concatenate([getattr(item, name) for item in parts])
            for name in ('position', 'velocity', 'arc_length')
        )
        self._taken += committed
        self.at_rest = start + len(arc_length) * self._period
        self.part += 1
        return Emission(
            'trajectory',
            Trajectory(
                stamp=stamp,
                frame_id=self.header.frame_id,
                path_id=self.header.path_id,
                epoch=self.header.epoch,
                part=self.part - 1,
                last=tail is None,
                start=start,
                period=self._pace.period,
                committed=committed,
                axis=self._axis,
                position=position.ravel(),
                velocity=velocity.ravel(),
                arc_length=arc_length,
            ),
        )

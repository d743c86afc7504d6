# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One tool path on its way to the machine: planned as far as needed, sent part by part."""

import numpy as np

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import (
    FeedrateSchedulerConfig,
    heeds_tolerance,
    make_limits,
    make_scheduler,
)
from fuzzycnc_ros.components.motion.parts import PartsRun, PathHeader
from fuzzycnc_ros.components.motion.tool_paths import (
    ToolPathSegments,
    curve_tool_path,
    tool_path_segments,
)
from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.feedrate.gcode.segments import LineSegment
from fuzzycnc_ros.core.feedrate.motion.trajectory import MotionSamples
from fuzzycnc_ros.core.feedrate.motion.waypoints import Sampled
from fuzzycnc_ros.core.feedrate.path.curves import trident
from fuzzycnc_ros.core.feedrate.path.nodes import NodePlan, with_nodes
from fuzzycnc_ros.core.feedrate.path.reference_path import PathBuilder, ReferencePath
from fuzzycnc_ros.core.feedrate.schedule.planner import Planner, PlannerSettings
from fuzzycnc_ros.core.feedrate.schedule.scheduler import Scheduler
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import (
    FeedSchedule,
    Floats,
)

GROUP = 1024
"""Segments that are planned at a time."""
SAME_PLACE = 1e-9
"""Distance up to which the axes stand where a path starts [m]."""


def streamable(scheduler: Scheduler) -> Scheduler:
    """Return the scheduler.

    Raises
    ------
    ValueError
        If it needs the whole path, so that no part could leave before the path has ended.
    """
    if not scheduler.reach.bounded:
        raise ValueError(
            f'method: expected one that takes a path in parts but found {scheduler!r}, which '
            'needs all of it; take another one, or give curvature_max'
        )
    return scheduler


def planner_settings(config: FeedrateSchedulerConfig) -> PlannerSettings:
    """Return what a configuration means for the planner.

    Raises
    ------
    ValueError
        If its parameters do not fit each other, or its method needs the whole path.
    """
    return PlannerSettings(
        scheduler=streamable(make_scheduler(config)),
        limits=make_limits(config),
        override=config.feed_override,
        period=config.period,
        window=config.jerk_window or None,
        settle=config.settle,
    )


def rehearse(config: FeedrateSchedulerConfig) -> None:
    """Plan a small path and throw it away: all code and tables are there when one is to be run.

    The first plan of a process takes some tenths of a second, the following ones milliseconds;
    in real time they would make the first part of a path late.

    Raises
    ------
    ValueError
        If the parameters do not fit each other.
    """
    path = curve_tool_path(
        trident(0.01), path_id='rehearsal', feed=config.feed_max, stamp=0, frame_id=''
    )
    run = PathRun(
        PathHeader('rehearsal', 0, ''), tool_path_segments(path), np.zeros(3), config, start=0
    )
    run.send(0)


class PathRun(PartsRun):
    """A tool path that is being sent.

    Parameters
    ----------
    header : PathHeader
        What its parts say of it.
    segments : ToolPathSegments
        The path.
    place : ndarray, shape (3,)
        Where the axes rest [m]; a rapid leads to the path's start.
    config : FeedrateSchedulerConfig
        Scheduler, limits and how much is sent how early.
    start : int
        Machine time of the first sample [ns].

    Raises
    ------
    ValueError
        If the parameters do not fit each other, or the path cannot be moved along.
    """

    def __init__(
        self,
        header: PathHeader,
        segments: ToolPathSegments,
        place: Floats,
        config: FeedrateSchedulerConfig,
        start: int,
    ) -> None:
        super().__init__(header, segments.axis, config, start)
        self._segments, self._config = segments, config
        self._columns = list(segments.columns)
        self._planner = Planner(planner_settings(config), 3)
        self._builder = PathBuilder(blend=config.blend)
        self._nodes = NodePlan.of(self._planner.settings.scheduler)
        self._fed = 0  # segments that the builder has
        self._complete = False
        self._place = 0.0  # arc length of the last sample taken
        self._lead_in = 0.0
        self._blocks = segments.block
        if portable.norm(np.subtract(segments.start, place)) > SAME_PLACE:
            x, y, z = place.tolist()
            line = LineSegment(-1, (x, y, z), segments.start, None, True, False, -1)
            self._lead_in = line.length
            self._blocks = np.append(-1, segments.block)
            self._push(self._builder.push([line], [True]))

    @property
    def progress(self) -> float:
        """Part of the segments that have been planned, 0 to 1."""
        return self._fed / len(self._segments)

    def change(self, config: FeedrateSchedulerConfig) -> None:
        """Go on with live parameters that changed, from the first sample not sent.

        Raises
        ------
        ValueError
            If they do not fit each other; nothing has changed then.
        """
        self._planner.change(planner_settings(config))
        self._config = self._pace = config

    def send(self, stamp: int) -> list[Emission]:
        """Return the next part and the feeds along it.

        Raises
        ------
        ValueError
            If the path cannot be moved along.
        """
        self._plan(self._taken + self._chunk)
        samples = self._planner.take(self._chunk)
        self.complete = self._planner.exhausted
        tail = None if self.complete else self._planner.tail()
        return self._told(stamp, samples, tail)

    def stop(self, stamp: int) -> list[Emission]:
        """Return a part that brings the axes to rest on the path, as its last one."""
        self.complete = True
        return self._told(stamp, self._planner.tail(), None)

    def _plan(self, samples: int) -> None:
        """Feed the planner until so many samples can be taken."""
        wanted = (samples - 1) * self._config.period
        while not self._complete and self._planner.known < wanted:
            begin, end = self._fed, min(self._fed + GROUP, len(self._segments))
            self._push(
                self._builder.push(self._segments[begin:end], self._segments.exact_stop[begin:end])
            )
            self._fed = end
            if end == len(self._segments):
                self._push(self._builder.finish())
                self._planner.finish()
                self._complete = True

    def _told(
        self, stamp: int, samples: MotionSamples, tail: MotionSamples | None
    ) -> list[Emission]:
        """Return a part of the trajectory and the feeds along it; note where it ends."""
        low, self._place = self._place, float(samples.arc_length[-1])
        part = self._emit(
            stamp, self._of_axes(samples), None if tail is None else self._of_axes(tail)
        )
        return [part, self._schedule(stamp, low)]

    def _of_axes(self, samples: MotionSamples) -> Sampled:
        """Return samples in the columns of the path's axes, along the path itself."""
        return Sampled(
            samples.position[:, self._columns],
            samples.velocity[:, self._columns],
            samples.arc_length - self._lead_in,
        )

    def _schedule(self, stamp: int, low: float) -> Emission:
        """Return the feeds from an arc length to the end of the newest part."""
        config = self._config
        found = self._planner.schedule(low, self._place)
        tolerance = config.tolerance if heeds_tolerance(config) else np.nan
        return Emission(
            'feed_schedule',
            FeedSchedule(
                stamp=stamp,
                frame_id=self.header.frame_id,
                path_id=self.header.path_id,
                part=self.part - 1,
                last=self.complete,
                method=config.method,
                tolerance=tolerance,
                feed_override=config.feed_override,
                arc_length=found.arc_length - self._lead_in,
                curvature=found.curvature,
                feed=found.feed,
                speed=found.speed,
                block=self._blocks[found.owner],
            ),
        )

    def _push(self, path: ReferencePath | None) -> None:
        if path is not None:
            self._planner.push(with_nodes(path, self._nodes))

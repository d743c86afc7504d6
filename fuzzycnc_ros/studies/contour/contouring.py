# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Paths on the simulated machine: scheduled, streamed, followed and judged, in one process.

The components, their order of turns and the requests are those of a live lock-step graph, so
that both give the same outputs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.runtime.graph import Sink
from fuzzycnc_ros.studies.contour.contouring_log import ContouringLog, FollowedPath
from fuzzycnc_ros.studies.evaluated_graph import run_served

CONTOURING_PATHS = ('infinity', 'trident', 'butterfly')
"""Curves of the interpolator literature that the machine can load."""

SETTLE = 0.25
"""Rest where a rapid ends and a path begins [s]: the axes have arrived to less than 0.1 um."""


class ContouringError(RuntimeError):
    """A path was not followed to its end; the text names it and says why."""


def run_contouring(
    paths: Sequence[str] = CONTOURING_PATHS,
    scheduler: FeedrateSchedulerConfig | None = None,
    machine: SimulatedMachineConfig | None = None,
    *,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FollowedPath, ...]:
    """Have the simulated machine follow paths, one after the other.

    Parameters
    ----------
    paths : sequence of str
        Curves to load.
    scheduler : FeedrateSchedulerConfig, optional
        Method, tolerance and limits; by default its own defaults and a rest of 0.25 s at exact
        stops, without which the axes cut the corner between the way to a path and the path.
    machine : SimulatedMachineConfig, optional
        The machine; its duties and paths are replaced.
    sink : callable, optional
        Takes every published record, configurations, requests and turns included.
    progress : callable, optional
        Told ticks done and in all; an exception that it raises ends the run.

    Returns
    -------
    tuple of FollowedPath
        One per path, as `ContouringLog.from_bag` gives for a bag of the run.

    Raises
    ------
    ValueError
        If a path is unknown, or parameters do not fit each other.
    ContouringError
        If a path was not followed to its end.
    """
    mill = SimulatedMachine(
        replace(machine or SimulatedMachineConfig(), duties=(), paths=tuple(paths))
    )
    planner = FeedrateScheduler(scheduler or FeedrateSchedulerConfig(settle=SETTLE))
    log = ContouringLog()
    failure = run_served(mill, planner, log, sink, progress)
    if failure:
        raise ContouringError(failure)
    return log.paths()

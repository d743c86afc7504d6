# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Moves of driven axes on the simulated machine: commanded, controlled and judged, in one process.

The components, their order of turns and the requests are those of a live lock-step graph, so
that both give the same outputs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.runtime.graph import Sink
from fuzzycnc_ros.studies.evaluated_graph import run_served
from fuzzycnc_ros.studies.servo.positioning import PositioningLog, PositioningMove


class PositioningError(RuntimeError):
    """A move did not arrive; the text says which and why."""


def run_positioning(
    moves: Sequence[str] = ('X:-0.05',),
    servo: ServoControllerConfig | None = None,
    machine: SimulatedMachineConfig | None = None,
    *,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[PositioningMove, ...]:
    """Have the simulated machine position its axes, one move after the other.

    Parameters
    ----------
    moves : sequence of str
        Targets [m] as `X:-0.05`.
    servo : ServoControllerConfig, optional
        The controllers.
    machine : SimulatedMachineConfig, optional
        The machine; its duties and moves are replaced, and if it drives no axes it gets those of
        the controllers.
    sink : callable, optional
        Takes every published record, configurations, requests and turns included.
    progress : callable, optional
        Told ticks done and in all; an exception that it raises ends the run.

    Returns
    -------
    tuple of PositioningMove
        One per move and axis, as `PositioningLog.from_bag` gives for a bag of the run.

    Raises
    ------
    ValueError
        If parameters do not fit each other.
    PositioningError
        If a move did not arrive.
    """
    controllers = ServoController(servo)
    settings = machine or SimulatedMachineConfig()
    config = controllers.configuration
    if not settings.servo_axes:
        settings = replace(settings, servo_axes=config.axes, axis_data=config.axis_data)
    driven = SimulatedMachine(replace(settings, duties=(), moves=tuple(moves)))
    log = PositioningLog()
    failure = run_served(driven, controllers, log, sink, progress)
    if failure:
        raise PositioningError(failure)
    return log.moves()

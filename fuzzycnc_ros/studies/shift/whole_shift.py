# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One shift of a machine with everything on: it warms up and cools down, and cuts in between.

The components, their order of turns and the requests are those of a live lock-step graph, so
that both give the same outputs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.motion.tool_paths import program_tool_path
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisition
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import LineSegment
from fuzzycnc_ros.core.thermal.model import ThermalModel, load_model
from fuzzycnc_ros.runtime.component import Component
from fuzzycnc_ros.runtime.graph import Sink
from fuzzycnc_ros.studies.evaluated_graph import judged_graph
from fuzzycnc_ros.studies.shift.whole_shift_log import ShiftLogs, WholeShift, whole_shift

DUTY = 'shift'
TICK = 10.0
"""Time between two readings of the warm machine [s]."""
JOBS = (
    '1800:path:butterfly',
    '5400:move:X:-0.05',
    '9000:program',
    '14400:move:X:0.02,Y:-0.03,Z:0.01',
    '19800:path:butterfly',
    '25200:move:X:0.0,Y:0.0,Z:0.0',
)
"""Cuts and moves, by time of the shift: warming up, hot, in pauses, and cooling down."""
AXES = ('X:ballscrew', 'Y:ballscrew', 'Z:ballscrew')
CONTROLLER = 'variable_universe'
"""Controller of the axes, which follow paths without load, as their model has them.  There its
observer leaves half of the contour error of the PID that is the axes' default (3.9 um, 8.2 um):
that one wins where gains, friction and loads differ from the model's."""
TOLERANCE = 20e-6
"""Contour error that is allowed [m]."""
SCHEDULER: dict[str, Any] = {
    'tolerance': 0.8 * TOLERANCE,
    'machine_constant': 8e-6,
    'axis_acceleration': (2.5, 2.5, 2.5),
    'settle': 0.25,
}
"""Scheduling for driven axes.  Circles of 1 to 20 mm at 0.25 to 2 m/s^2 show at most 3.3 um, by
their largest error 0.66e-5 s^2 and less.  Where axes set off or turn back friction leaves up to
8 um, at any feed: a fifth of the tolerance is its room.  The drives accelerate an axis at 3.7
m/s^2 at most."""
PLAIN: dict[str, Any] = {**SCHEDULER, 'method': 'constant'}
"""The same without a schedule: the programmed feed within the limits of the axes."""


CURVE_STEPS = 64
"""Steps in which arcs and curves of a program are looked at."""
LONGEST_PROGRAM = 120.0
"""Time that a part program may take at its own feeds [s]: over DDS a second takes three."""


class WholeShiftError(RuntimeError):
    """A job was not done; the text names it and says why."""


@dataclass(frozen=True)
class ShiftSettings:
    """Settings that differ between shifts.

    Parameters
    ----------
    jobs : tuple of str
        Jobs as parameter `jobs` of `simulated_machine` takes them.
    program : str
        Text of the part program; empty for the machine's own.
    duration : float
        Time after which the shift is cut off [s]; 0 runs it whole.
    seed : int
        Seed of all measuring noise.
    """

    jobs: tuple[str, ...] = JOBS
    program: str = ''
    duration: float = 0.0
    seed: int = 0

    def machine(self) -> dict[str, Any]:
        """Return the parameters of `simulated_machine`."""
        return {
            'duties': (DUTY,),
            'duty_duration': self.duration,
            'tick_period': TICK,
            'jobs': self.jobs,
            'part_program': self.program,
            'servo_axes': AXES,
            'seed': self.seed,
        }


def check_program(text: str) -> None:
    """Refuse a part program that the machine of the shift cannot cut.

    Parameters
    ----------
    text : str
        The program.

    Raises
    ------
    ValueError
        If it says something impossible or what is up to the machine, cuts nothing, leaves the
        travel of an axis or takes longer than `LONGEST_PROGRAM`.
    """
    program = read_program(text)
    program_tool_path(program)
    machine = SimulatedMachineConfig()
    low, high = machine.servo_travel_low, machine.servo_travel_high
    duration = 0.0
    if not any(segment.feed and segment.length for segment in program.segments):
        raise ValueError('expected moves with feed (G1, G2, G3) but found rapids alone')
    for segment in program.segments:
        points = segment.points(1 if isinstance(segment, LineSegment) else CURVE_STEPS)
        for axis, places in zip('XYZ', points.T, strict=True):
            farthest = float(places[np.argmax(np.abs(places - 0.5 * (low + high)))])
            if not low <= farthest <= high:
                raise ValueError(
                    f'line {segment.line}: expected {axis} within its travel of {1e3 * low:g} to '
                    f'{1e3 * high:g} mm but found {1e3 * farthest:g} mm; move the zero of the part'
                )
        duration += segment.length / segment.feed if segment.feed else 0.0
    if duration > LONGEST_PROGRAM:
        raise ValueError(
            f'expected a program that takes at most {LONGEST_PROGRAM:g} s at its own feeds but '
            f'found {duration:.0f} s; cut a part of it'
        )


def run_whole_shift(
    model_text: str,
    settings: ShiftSettings | None = None,
    *,
    compensated: bool = True,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> WholeShift:
    """Run a shift of the simulated mill with all nodes, in one process.

    Parameters
    ----------
    model_text : str
        Text of the model file of its thermal error.
    settings : ShiftSettings, optional
        What is done.
    compensated : bool
        Whether its thermal error is compensated and its feed scheduled; else the axes cut at the
        programmed feed.
    sink : callable, optional
        Takes every published record, configurations, requests and turns included.
    progress : callable, optional
        Told ticks done and in all; an exception that it raises ends the run.

    Returns
    -------
    WholeShift
        What became of the machine and of each job.

    Raises
    ------
    ModelFileError
        If the text is no model file.
    ValueError
        If parameters do not fit each other.
    WholeShiftError
        If a job was not done.
    """
    chosen = settings or ShiftSettings()
    model = load_model(model_text)
    machine = SimulatedMachine(SimulatedMachineConfig(**chosen.machine()))
    components: list[Component] = [
        TemperatureAcquisition(),
        SensorSelector(),
        ThermalPredictor(),
        Compensator(),
        FeedrateScheduler(FeedrateSchedulerConfig(**(SCHEDULER if compensated else PLAIN))),
        ServoController(ServoControllerConfig(axes=AXES, controller=CONTROLLER)),
    ]
    logs = ShiftLogs()
    graph = judged_graph(machine, components, logs, sink)
    graph.request('thermal_predictor', 'use_model', model=model_text)
    managed = [item.NAME for item in components if item.MANAGED]
    for name in managed:
        if compensated or name != 'compensator':
            graph.request(name, 'activate')
    graph.run(progress)
    if machine.failure:
        said = '; '.join(
            f'{item.NAME}: {health.message}'
            for item in components[-2:]
            for health in item.health()
        )
        raise WholeShiftError(f'{machine.failure} {said}')
    return judged_shift(logs, model, chosen)


def judged_shift(logs: ShiftLogs, model: ThermalModel, settings: ShiftSettings) -> WholeShift:
    """Return what became of a shift by its logs, of a run in one process or from its bag."""
    limit = CompensatorConfig().offset_max
    return whole_shift(logs, model, settings.jobs, offset_max=limit)

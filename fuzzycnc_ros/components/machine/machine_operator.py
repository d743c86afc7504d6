# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The operator of a simulated machine: loads paths, programs and patterns, has moves made.

Jobs come at times of a duty, or one after the other when all duties are done.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from fuzzycnc_ros.components.machine.simulated_machine_config import (
    MACHINE_DUTIES,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.motion.tool_paths import curve_tool_path, program_tool_path
from fuzzycnc_ros.core.feedrate.path.curves import CURVES, SHEET_SCALES
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import Material, StitchPattern, ToolPath, nanoseconds
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet

PATH, PROGRAM, MOVE = 'path', 'program', 'move'
ENGAGE = 0.1
"""Time from unclamping the axes to what they are to do [s]: a controller has taken them over."""
SETTLE = 0.25
"""Time from the end of a job to clamping the axes [s]: they have arrived."""
CLAMPING = 0.5
"""Time between a sheet and the first pattern on it [s]: every node has heard of the sheet."""
_USUAL_SPEED = 0.02
"""Speed along a path that progress is told by, before anything is known [m/s]."""
_SYNTAX = 'SECONDS:path:butterfly, SECONDS:program or SECONDS:move:X:-0.05'


@dataclass(frozen=True)
class Job:
    """Task of a duty, and its time.

    Attributes
    ----------
    start : float or None
        Time since the duty began [s]; None after the one before.
    kind : str
        `path`, `program` or `move`.
    what : str
        Name of a curve, or targets of axes; nothing for the program.
    """

    start: float | None
    kind: str
    what: str = ''

    @property
    def name(self) -> str:
        """Name of a path of it."""
        return self.what or self.kind


def timed_jobs(texts: Sequence[str], duration: float) -> list[Job]:
    """Return the jobs of a duty.

    Parameters
    ----------
    texts : sequence of str
        Jobs as `3600:path:butterfly`, `7200:program` and `10800:move:X:-0.05`.
    duration : float
        Length of the duty [s].

    Raises
    ------
    ValueError
        If one is malformed or outside the duty, or they are not in the order of their times.

    Examples
    --------
    >>> timed_jobs(['3600:path:butterfly', '7200:program'], 28800.0)[1]
    Job(start=7200.0, kind='program', what='')
    """
    jobs = [_parsed(text) for text in texts]
    for job, text in zip(jobs, texts, strict=True):
        if job.start is None or not 0.0 <= job.start < duration:
            raise ValueError(
                f'jobs: expected times within the duty of {duration:g} s but found {text!r}'
            )
    for (first, before), (second, after) in pairwise(zip(jobs, texts, strict=True)):
        if not (first.start or 0.0) < (second.start or 0.0):
            raise ValueError(f'jobs: expected rising times but found {after!r} after {before!r}')
    return jobs


def _parsed(text: str) -> Job:
    """Return the job that a text stands for."""
    time, _, rest = text.partition(':')
    kind, _, what = rest.partition(':')
    try:
        start = float(time)
    except ValueError:
        start = float('nan')
    curve = kind == PATH and what in CURVES
    if start != start or not (curve or (kind == PROGRAM and not what) or (kind == MOVE and what)):
        raise ValueError(f'jobs: expected {_SYNTAX} but found {text!r}')
    return Job(start, kind, what)


@dataclass(frozen=True)
class Task:
    """One thing that the operator does.

    Attributes
    ----------
    name : str
        What a path of it is called.
    make : callable or None
        Makes the record that loads it, of `path_id`, `stamp` and `frame_id`; None for a move.
    length : float
        Length of the path [m].
    start : float or None
        Time since the duty began [s]; None after the one before.
    move : str
        Targets of axes of a move.
    sheet : FoamSheet or None
        What has to be clamped for it.
    """

    name: str
    make: Callable[..., ToolPath | StitchPattern] | None
    length: float = 0.0
    start: float | None = None
    move: str = ''
    sheet: FoamSheet | None = None


class MachineOperator:
    """Loads what is to be done, at its time or one after the other.

    A task with a time first has its axes unclamped: their periods begin, and whoever controls them
    takes them over.  A little later it is loaded; when it is done and the axes have settled, they
    are clamped again.  Where a task asks for another sheet than the one before, that is clamped
    first.

    Parameters
    ----------
    tasks : sequence of Task
        All with a time, or none.
    timeout : float
        Time to wait for a trajectory before the rest is given up [s].
    nodes : str
        Which nodes make a trajectory of what is loaded, for the message.
    move_time : float
        Time of each move [s].

    Attributes
    ----------
    timed : bool
        Whether tasks have times.
    failure : str
        Why the rest was given up; empty if it was not.
    """

    def __init__(
        self, tasks: Sequence[Task], *, timeout: float, nodes: str, move_time: float
    ) -> None:
        self._tasks, self._move_time = tuple(tasks), move_time
        names = [task.name for task in tasks]
        self._ids = [_unique(names, index) for index in range(len(names))]
        self._timeout, self._nodes = nanoseconds(timeout), nodes
        self._number = -1
        self._since = 0
        self._clamped: FoamSheet | None = None
        self._ready = 0  # when a sheet that was clamped is known everywhere
        self._begun: int | None = None  # of a task with a time: when its axes were unclamped
        self._done: int | None = None
        self._loaded = False
        self.timed = bool(tasks) and tasks[0].start is not None
        self.failure = ''

    @property
    def over(self) -> bool:
        """True if everything is done or the rest was given up."""
        done = self._number + self.timed >= len(self._tasks) and not self.begun
        return bool(self.failure) or done

    @property
    def path_id(self) -> str:
        """Path that is loaded; empty if none is."""
        known = 0 <= self._number < len(self._ids) and (self._loaded or not self.timed)
        return self._ids[self._number] if known else ''

    @property
    def waiting(self) -> bool:
        """True if the axes are needed though no trajectory is being followed."""
        return self.begun if self.timed else bool(self.path_id) and not self.failure

    @property
    def begun(self) -> bool:
        """True while a timed task is under way, from unclamping the axes to clamping them."""
        return self._begun is not None

    @property
    def due(self) -> int | None:
        """Begin of the next task, since the beginning of the duty [ns]; None if there is none."""
        following = self._number + 1
        if not self.timed or self.begun or self.failure or following >= len(self._tasks):
            return None
        return nanoseconds(self._tasks[following].start or 0.0)

    @property
    def loaded(self) -> bool:
        """True if the task under way was loaded."""
        return self._loaded

    @property
    def move(self) -> str:
        """Targets of the move that was loaded; empty if it is none."""
        return self._tasks[self._number].move if self._loaded else ''

    @property
    def moves(self) -> tuple[str, ...]:
        """Targets of all moves."""
        return tuple(task.move for task in self._tasks if task.move)

    def begin(self, stamp: int) -> None:
        """Begin the next task: its axes are unclamped."""
        self._begun, self._done, self._loaded = stamp, None, False

    def load(self, stamp: int, frame_id: str) -> tuple[Emission, ...]:
        """Go on to the next task; return what loads it, or clamps the sheet that it needs.

        Nothing is returned if none is left, or the axes or the sheet are not ready.
        """
        if self._begun is not None and stamp < self._begun + nanoseconds(ENGAGE):
            return ()
        following = self._number + 1
        task = self._tasks[following] if following < len(self._tasks) else None
        if task is not None and task.sheet is not None:
            if task.sheet != self._clamped:
                self._clamped, self._ready = task.sheet, stamp + nanoseconds(CLAMPING)
                return (Emission('material', material_record(task.sheet, stamp, frame_id)),)
            if stamp < self._ready:
                return ()
        self._number, self._since, self._loaded = following, stamp, True
        if task is None or task.make is None or self.failure:
            return ()
        record = task.make(path_id=self.path_id, stamp=stamp, frame_id=frame_id)
        return (Emission('tool_path' if task.sheet is None else 'stitch_pattern', record),)

    def wait(self, stamp: int, status: str, *, busy: bool) -> None:
        """Give up if the machine has been without a trajectory for too long.

        Parameters
        ----------
        stamp : int
            Machine time [ns].
        status : str
            What became of the trajectory, for the message.
        busy : bool
            Whether a trajectory is being followed.
        """
        if busy:
            self._since = stamp
        elif self.waiting and stamp - self._since >= self._timeout:
            self.failure = (
                f'path {self.path_id} was not followed to its end: no trajectory for '
                f'{1e-9 * self._timeout:g} s of machine time ({status}); {self._nodes} active?'
            )

    def settled(self, stamp: int, *, done: bool) -> bool:
        """Return True if the axes may be clamped: the task is over or given up."""
        if done and self._done is None:
            self._done = stamp
        ended = self._done is not None and stamp >= self._done + nanoseconds(SETTLE)
        return bool(self.failure) or ended

    def end(self) -> None:
        """End the task: its axes are clamped."""
        self._begun, self._loaded = None, False

    def ticks(self, period: float) -> int:
        """Return about how many periods [s] everything takes."""
        return sum(self._usual_ticks(period))

    def ticks_done(self, period: float, arc_length: float) -> int:
        """Return how many of them are over at a place on the present path [m]."""
        usual = self._usual_ticks(period)
        before = sum(usual[: max(self._number, 0)])
        if not self.path_id or self.move:
            return before
        part = min(arc_length / self._tasks[self._number].length, 1.0)
        return before + int(part * usual[self._number])

    def _usual_ticks(self, period: float) -> list[int]:
        return [
            round((self._move_time if task.move else task.length / _USUAL_SPEED) / period)
            for task in self._tasks
        ]


def _unique(names: Sequence[str], index: int) -> str:
    """Return the name of a path; one that is loaded again gets a number."""
    count = list(names[:index]).count(names[index])
    return f'{names[index]}_{count + 1}' if count else names[index]


def material_record(sheet: FoamSheet, stamp: int, frame_id: str) -> Material:
    """Return what an operator knows of a sheet."""
    return Material(
        stamp=stamp,
        frame_id=frame_id,
        name=f'foam {1e3 * sheet.thickness:g} mm',
        thickness=sheet.thickness,
        size=np.array(sheet.size),
        young_modulus=sheet.young_modulus,
        poisson_ratio=sheet.poisson_ratio,
    )


def machine_operator(config: SimulatedMachineConfig) -> MachineOperator:
    """Return who loads the jobs, paths or patterns that a machine is to do by itself.

    Raises
    ------
    ValueError
        If one is unknown, or they do not fit each other.
    """
    if config.jobs:
        others = (*config.paths, *config.patterns, *config.moves)
        if others or len(config.duties) != 1:
            raise ValueError(
                'jobs: expected one duty and neither paths, patterns nor moves beside them but '
                f'found {", ".join((*config.duties, *others)) or "no duty"}'
            )
        tasks = _job_tasks(timed_jobs(config.jobs, duty_length(config, config.duties[0])), config)
    else:
        unknown = [name for name in config.paths if name not in CURVES]
        if unknown:
            raise ValueError(
                f'paths: expected names among {", ".join(CURVES)} but found {", ".join(unknown)}'
            )
        tasks = _job_tasks([Job(None, PATH, name) for name in config.paths], config)
    nodes = 'is feedrate_scheduler'
    if config.patterns:
        if config.paths or config.servo_axes:
            # Tool paths of two writers, and a tool that is read with noise, are not provided for.
            raise ValueError(
                'patterns: expected neither paths nor servo_axes on a machine that stitches but '
                f'found {", ".join((*config.paths, *config.servo_axes))}'
            )
        tasks, nodes = _pattern_tasks(config), 'are deformation_compensator and feedrate_scheduler'
    return MachineOperator(
        tasks, timeout=config.path_timeout, nodes=nodes, move_time=config.move_time
    )


def _job_tasks(jobs: Sequence[Job], config: SimulatedMachineConfig) -> list[Task]:
    """Return what jobs have the machine do.

    Raises
    ------
    ValueError
        If the part program cannot be run.
    """
    tasks: list[Task] = []
    program: tuple[Callable[..., ToolPath], float] | None = None
    for job in jobs:
        if job.kind == MOVE:
            tasks.append(Task(job.name, None, start=job.start, move=job.what))
        elif job.kind == PATH:
            curve = CURVES[job.what](SHEET_SCALES[job.what])
            make = partial(curve_tool_path, curve, feed=config.path_feed)
            tasks.append(Task(job.name, make, curve.length, job.start))
        else:
            program = program or _program_maker(config.part_program or PART_PROGRAM)
            tasks.append(Task(job.name, *program, job.start))
    return tasks


def _program_maker(text: str) -> tuple[Callable[..., ToolPath], float]:
    """Return what makes the tool path of a program, and its length [m]."""
    # Here, as few machines cut a program, and reading one takes 20 modules.
    from fuzzycnc_ros.core.feedrate.gcode.reader import read_program

    found = read_program(text)
    length = sum(segment.length for segment in found.segments)
    return partial(replace, program_tool_path(found)), length


def _pattern_tasks(config: SimulatedMachineConfig) -> list[Task]:
    """Return the patterns of a machine that stitches."""
    # Here, as few machines stitch.
    from fuzzycnc_ros.components.machine.machine_patterns import parse_patterns
    from fuzzycnc_ros.components.soft.stitch_patterns import stitch_pattern

    return [
        Task(
            item.name,
            partial(stitch_pattern, item.primitives, feed=config.pattern_feed),
            item.length,
            sheet=item.sheet,
        )
        for item in parse_patterns(config.patterns, machine_sheet(config))
    ]


def machine_sheet(config: SimulatedMachineConfig) -> FoamSheet:
    """Return the sheet that lies in the machine at the beginning.

    Raises
    ------
    ValueError
        If its size is not one of X and Y.
    """
    if len(config.sheet_size) != 2:
        raise ValueError(
            f'sheet_size: expected the lengths along X and Y but found {len(config.sheet_size)} '
            'numbers'
        )
    x, y = config.sheet_size
    return FoamSheet(config.sheet_thickness, (x, y), friction=config.sheet_friction)


def duty_length(config: SimulatedMachineConfig, duty: str) -> float:
    """Return for how long a duty is run [s]; at least one tick."""
    whole = MACHINE_DUTIES[duty].duration
    return max(min(whole, config.duty_duration or whole), config.tick_period)


PART_PROGRAM = """\
%
(Bearing plate, 70 x 44 mm: facing, pocket, slot, four holes)
G21 G17 G90 G94
G0 Z5
(facing)
G0 X-30 Y-15
G1 Z0 F3000
G1 X30 F9000
G3 X30 Y-5 I0 J5
G1 X-30
G2 X-30 Y5 I0 J5
G1 X30
G3 X30 Y15 I0 J5
G1 X-30
G0 Z5
(pocket with rounded corners, from the inside)
G0 X0 Y0
G1 Z-2 F1500
G1 X6 F4800
G3 X6 Y0 I-6 J0
G1 X10 Y0
G1 Y4
G3 X6 Y8 I-4 J0
G1 X-6
G3 X-10 Y4 I0 J-4
G1 Y-4
G3 X-6 Y-8 I4 J0
G1 X6
G3 X10 Y-4 I0 J4
G1 Y0
G0 Z5
(curved slot)
G0 X-18 Y-10
G1 Z-1 F1500
G2 X-18 Y10 I14 J10 F3600
G0 Z5
(holes)
G0 X-26 Y-13
G1 Z-4 F1200
G0 Z5
G0 X26 Y-13
G1 Z-4
G0 Z5
G0 X26 Y13
G1 Z-4
G0 Z5
G0 X-26 Y13
G1 Z-4
G0 Z5
G0 X0 Y0
M2
%
"""
"""A plate of our own in mm, cut in about twenty seconds."""

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A part program given to `feedrate_scheduler`: its feeds, its time, and the path that it is."""

from dataclasses import dataclass

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import (
    FeedrateSchedulerConfig,
    make_limits,
    make_scheduler,
)
from fuzzycnc_ros.components.motion.tool_paths import program_tool_path
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.writer import write_program
from fuzzycnc_ros.core.feedrate.schedule.program_schedule import schedule_program
from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
from fuzzycnc_ros.runtime.records import ToolPath


@dataclass(frozen=True)
class ScheduledProgram:
    """A program with its feeds chosen anew.

    Attributes
    ----------
    program : str
        The program with its new feed words.
    duration : float
        Time of what has a known time [s].
    message : str
        That time, and what was passed through.
    path : ToolPath or None
        Its path with the programmed feeds, where it is to be run.
    """

    program: str
    duration: float
    message: str
    path: ToolPath | None


def program_settings(config: FeedrateSchedulerConfig) -> ProgramSettings:
    """Return how a configuration schedules programs.

    Raises
    ------
    ValueError
        If its parameters do not fit each other, or the override is 0.
    """
    return ProgramSettings(
        scheduler=make_scheduler(config),
        limits=make_limits(config),
        machine_constant=config.machine_constant,
        blend=config.blend,
        own_corners=False,  # the node's motion rounds corners as its parameter says
        override=config.feed_override,
        settle=config.settle,
        window=config.jerk_window or None,
    )


def schedule_text(
    config: FeedrateSchedulerConfig,
    text: str,
    *,
    units: str = '',
    path_id: str = '',
    stamp: int = 0,
    frame_id: str = '',
    run: bool = False,
) -> ScheduledProgram:
    """Choose the feeds of a program.

    Parameters
    ----------
    config : FeedrateSchedulerConfig
        How.
    text : str
        The program.
    units : {'', 'mm', 'inch'}
        Unit before it says G20 or G21; empty is mm.
    path_id : str
        Name of its path; empty is `program`.
    stamp, frame_id
        Of its path.
    run : bool
        Whether its path is wanted.

    Raises
    ------
    ValueError
        If it is no program, cannot be scheduled, or cannot be run where that is asked for; the
        message names the line.
    """
    program = read_program(text, units or 'mm')
    path = None
    if run:
        path = program_tool_path(
            program, path_id=path_id or 'program', stamp=stamp, frame_id=frame_id
        )
    schedule = schedule_program(program, program_settings(config))
    times = schedule.times
    message = f'{times.chosen} feeds chosen, {times.duration:.3f} s in all'
    if times.untimed:
        message += f' but for {times.untimed} motions of unknown time'
    if program.notes:
        message += '; ' + '; '.join(str(note) for note in program.notes)
    return ScheduledProgram(write_program(program, schedule.feeds), times.duration, message, path)

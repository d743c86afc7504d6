# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the parameters of `simulated_machine` say of jobs, paths, patterns and the sheet."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from fuzzycnc_ros.components.machine.job_programme import JobProgramme, path_jobs, timed_jobs
from fuzzycnc_ros.components.machine.simulated_machine_config import (
    MACHINE_DUTIES,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet

if TYPE_CHECKING:
    from fuzzycnc_ros.components.machine.pattern_programme import PatternProgramme


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


def machine_programme(
    config: SimulatedMachineConfig, go: Callable[[str], None]
) -> JobProgramme | PatternProgramme:
    """Return the jobs, paths or patterns that the machine loads by itself.

    Parameters
    ----------
    config : SimulatedMachineConfig
        Parameters of the machine.
    go : callable
        Has the axes make a move, given its targets.

    Raises
    ------
    ValueError
        If one is unknown, or they do not fit each other.
    """
    jobs = [] if config.jobs else path_jobs(config.paths)
    if config.jobs:
        others = (*config.paths, *config.patterns, *config.moves)
        if others or len(config.duties) != 1:
            raise ValueError(
                'jobs: expected one duty and neither paths, patterns nor moves beside them but '
                f'found {", ".join((*config.duties, *others)) or "no duty"}'
            )
        duration = duty_length(config, config.duties[0])
        jobs = timed_jobs(config.jobs, duration)
    if not config.patterns:
        return JobProgramme(
            jobs,
            feed=config.path_feed,
            timeout=config.path_timeout,
            program=config.part_program or PART_PROGRAM,
            move_time=config.move_time,
            go=go,
        )
    if config.paths or config.servo_axes:
        # Tool paths of two writers, and a tool that is read with noise, are not provided for.
        raise ValueError(
            'patterns: expected neither paths nor servo_axes on a machine that stitches but found '
            f'{", ".join((*config.paths, *config.servo_axes))}'
        )
    # Here, as few machines stitch.
    from fuzzycnc_ros.components.machine.pattern_programme import PatternProgramme

    return PatternProgramme(
        config.patterns,
        sheet=machine_sheet(config),
        feed=config.pattern_feed,
        timeout=config.path_timeout,
    )


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

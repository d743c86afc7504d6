# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the parameters of `simulated_machine` say of paths, patterns and the sheet."""

from fuzzycnc_ros.components.path_programme import PathProgramme, Programme
from fuzzycnc_ros.components.pattern_programme import PatternProgramme
from fuzzycnc_ros.components.simulated_machine_config import SimulatedMachineConfig
from fuzzycnc_ros.core.machine.foam_sheet import FoamSheet


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


def machine_programme(config: SimulatedMachineConfig) -> Programme:
    """Return the paths or patterns that the machine loads by itself.

    Raises
    ------
    ValueError
        If one is unknown, or they do not fit each other.
    """
    if not config.patterns:
        return PathProgramme(config.paths, feed=config.path_feed, timeout=config.path_timeout)
    if config.paths or config.servo_axes:
        # Tool paths of two writers, and a tool that is read with noise, are not provided for.
        raise ValueError(
            'patterns: expected neither paths nor servo_axes on a machine that stitches but found '
            f'{", ".join((*config.paths, *config.servo_axes))}'
        )
    return PatternProgramme(
        config.patterns,
        sheet=machine_sheet(config),
        feed=config.pattern_feed,
        timeout=config.path_timeout,
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The first lines of a scheduled program, driven on the simulated controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fuzzycnc_ros.core.feedrate.gcode.blocks import Block
from fuzzycnc_ros.core.feedrate.motion.controller_blends import ControllerLimits
from fuzzycnc_ros.core.feedrate.schedule.controller_program import (
    PathMode,
    program_moves,
    with_mode,
)
from fuzzycnc_ros.core.feedrate.schedule.program_settings import AXIS_COUNT, ProgramSettings
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.studies.programs.program_judge import Judged, ProgramPath

LONGEST = 600.0
"""Motion beyond which lines are not driven [s]."""


def drive_words(
    blocks: Sequence[tuple[Block, float | None]],
    settings: ProgramSettings,
    machine: ContouringConfig,
) -> tuple[Judged | None, Judged | None]:
    """Drive lines of a program as they were, and with their chosen feeds.

    Parameters
    ----------
    blocks : sequence of (Block, float or None)
        Lines with their feeds [m/s], None for their own.
    settings : ProgramSettings
        Limits, rounding of corners, rest at stops.
    machine : ContouringConfig
        Lags of the axes.

    Returns
    -------
    tuple of Judged or None
        As they were and with the chosen feeds; None where nothing moves or it takes too long.

    Notes
    -----
    Corners are passed as the settings say, whatever path mode the program asks for, so that both
    are compared under what the schedule was made for.
    """
    lines = [block for block, _ in blocks]
    try:
        moves = program_moves(lines)
    except ValueError:  # nothing of it moves
        return None, None
    moves = with_mode(moves, PathMode(settings.blend, settings.blend))
    rest = np.maximum(moves.moves.rest, settings.settle)
    moves = replace(moves, moves=replace(moves.moves, rest=rest))
    feeds = np.array(
        [np.nan if feed is None else feed for block, feed in blocks if block.segment is not None]
    )
    velocity, rise, _ = settings.limits.table(AXIS_COUNT)
    path, speed, gain = velocity[0], velocity[1:], rise[1:]
    limits = ControllerLimits(
        velocity=tuple(np.minimum(speed, path).tolist()),
        acceleration=tuple(np.where(np.isfinite(gain), gain, rise[0]).tolist()),
        path_velocity=float(path),
        period=machine.interpolation_period,
    )
    judge = ProgramPath(moves)
    found: list[Judged | None] = []
    for one in (moves, moves.with_feeds(feeds)):
        least = float((one.moves.length / np.minimum(one.moves.feed, path)).sum())
        found.append(None if least > LONGEST else judge.run(one, limits, machine))
    return found[0], found[1]

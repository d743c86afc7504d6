# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recording programs as text: G-code for LinuxCNC, a CSV of set points or duties otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.excitation import (
    ExcitationLimits,
    duty_program,
    position_program,
)

BLOCK = 4e-3
"""Time of a block of G-code [s]: shorter ones ask too much of an interpreter."""

PER_BLOCK = 5.0
"""Blocks that a swing of the chirp has at least in a G-code program [-]."""


def gcode_program(axis: str, limits: ExcitationLimits, about: str) -> str:
    """Return a G-code program (inverse time, absolute, mm) that moves one axis.

    Parameters
    ----------
    axis : str
        Letter of the axis.
    limits : ExcitationLimits
        What it keeps to; the chirp ends where a swing has five blocks.
    about : str
        What is said at the top.
    """
    known = replace(limits, frequency=min(limits.frequency, 1.0 / (PER_BLOCK * BLOCK)))
    places = position_program(known, BLOCK)
    return '\n'.join(_blocks(axis, places, about)) + '\n'


def _blocks(axis: str, places: Array, about: str) -> Iterator[str]:
    yield from (f'({line})' for line in about.splitlines())
    yield 'G21 G90 G17 G40 G64 P0.001'
    yield f'(moves to the middle of the travel first)\nG94 F600 G1 {axis}{1e3 * places[0]:.5f}'
    yield 'G4 P1\nG93'
    feed = 60.0 / BLOCK
    still = 0
    for before, place in pairwise(places.tolist()):
        if place == before:
            still += 1
            continue
        if still:
            yield f'G4 P{still * BLOCK:.3f}'
            still = 0
        yield f'G1 {axis}{1e3 * place:.5f} F{feed:g}'
    if still:
        yield f'G4 P{still * BLOCK:.3f}'
    yield 'G94\nM2'


def table_program(limits: ExcitationLimits, period: float, *, duty: bool) -> tuple[str, float]:
    """Return a CSV of set points [mm] or of duties [-], one a control period, and how long it is.

    Parameters
    ----------
    limits : ExcitationLimits
        What it keeps to.
    period : float
        Control period [s].
    duty : bool
        Whether duties, which are added to what holds the axis, instead of set points.

    Returns
    -------
    text : str
        The table.
    seconds : float
        Its length [s].
    """
    values = duty_program(limits, period) if duty else 1e3 * position_program(limits, period)
    time = period * np.arange(len(values))
    head = 't,duty' if duty else 't,commanded'
    digits = 5 if duty else 6
    rows = [f'{at:.6g},{value:.{digits}f}' for at, value in zip(time, values, strict=True)]
    return '\n'.join([head, *rows]) + '\n', float(time[-1])

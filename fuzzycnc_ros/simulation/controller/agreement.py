# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Measured difference between a real LinuxCNC and the simulated controller."""

from __future__ import annotations

import numpy as np

from fuzzycnc_ros.simulation.controller.moves import Moves

LINES, ARCS, SPACE = 'lines', 'arcs', 'space'
LARGEST = {LINES: 1.03, ARCS: 1.03, SPACE: 1.02}
"""Largest contour error driven over simulated, by what a program has [-]: 500 random short
programs on LinuxCNC 2.9, docs/explanation/linuxcnc-feedrate.md, without queues that ran short."""


def kinds(moves: Moves) -> set[str]:
    """Return what a program has: lines in a plane, arcs, motion in space."""
    found = {LINES}
    if moves.arc.any():
        found.add(ARCS)
    along = (np.abs(moves.end - moves.start) > 1e-9).all(axis=1) & ~moves.rapid
    if along.any() or np.abs(moves.rise).max() > 1e-9:
        found.add(SPACE)
    return found


def disagreement(moves: Moves) -> float:
    """Return by how much LinuxCNC may exceed the simulated contour error of a program [-]."""
    return max(LARGEST[kind] for kind in kinds(moves))

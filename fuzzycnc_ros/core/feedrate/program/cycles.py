# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where fixed cycles (G73, G81 to G86, G89) leave the tool.

A cycle moves above its hole, down to R by rapid and to Z by feed, and back up: to R (G99), or to
where the axis stood before the first of the cycles (G98).
"""

from math import isfinite, nan

from fuzzycnc_ros.core.feedrate.program.arcs import PLANES
from fuzzycnc_ros.core.feedrate.program.lexer import Line
from fuzzycnc_ros.core.feedrate.program.modal import Cycle, State

AXES = 'XYZ'

FOLLOWED = frozenset({730, 810, 820, 830, 840, 850, 860, 890})
"""Cycles that end above the hole.

G74 is a reference in Siemens' language; G76, G87 and G88 differ between controllers, or wait for
the operator.
"""


def begin(code: int, state: State) -> None:
    """Take a cycle's G word: R and Z stay in effect only where the same cycle goes on."""
    if state.cycle is None or state.motion != -1:
        state.cycle = Cycle(code, state.position[PLANES[state.plane][2]])
    elif state.cycle.code != code:
        state.cycle = Cycle(code, state.cycle.start)


def runs(line: Line, state: State) -> bool:
    """Whether a line with a cycle in effect runs it: it names an axis."""
    return state.cycle is not None and any(word.letter in 'XYZABCUVW' for word in line.words)


def run(line: Line, state: State) -> bool:
    """Move the state on by a cycle; return whether its end is known in all axes.

    Parameters
    ----------
    line : Line
        What the line says; its G, M and F words are in the state already.
    state : State
        Modal state with a cycle in effect; axes whose end is unknown are lost.
    """
    cycle = state.cycle
    assert cycle is not None
    state.kind = ''
    first, second, across = PLANES[state.plane]
    value = {word.letter: word.value for word in line.words}
    plain = not line.assigned and not state.polar and not state.modal_call
    if cycle.code not in FOLLOWED or not plain or not value.keys().isdisjoint('ABCUVW'):
        state.lose()
        return False
    for axis in (first, second):
        state.position[axis] = _above(state, axis, value)
    cycle.retract = _length('R', value, cycle.retract, state)
    state.position[across] = _height(cycle, state)
    known = all(map(isfinite, state.position))
    if state.absolute:
        named = {AXES[axis] for axis in (first, second) if AXES[axis] in value}
        state.assumed -= named | ({AXES[across]} if state.retracts else set())
    return known


def _length(
    letter: str, value: dict[str, float | None], before: float | None, state: State
) -> float | None:
    if letter not in value:
        return before
    number = value[letter]
    return None if number is None else number * state.length_unit


def _above(state: State, axis: int, value: dict[str, float | None]) -> float:
    """Return where the last hole lies; L repeats relative ones (Fanuc's K is not followed)."""
    before = state.position[axis]
    if AXES[axis] not in value:
        return before
    number = value[AXES[axis]]
    if number is None:
        return nan
    length = number * state.length_unit
    if state.absolute:
        return length
    repeats = nan if 'K' in value else value.get('L', 1.0)
    return before + length * round(repeats) if repeats and isfinite(repeats) else nan


def _height(cycle: Cycle, state: State) -> float:
    """Return where the axis across the plane ends."""
    if cycle.retract is None:
        return nan
    retract = cycle.retract if state.absolute else cycle.start + cycle.retract
    start = max(cycle.start, retract)  # from below R it rises to R first, and comes back there
    if state.retracts or start == retract:
        return retract
    return start if state.retracts is False else nan

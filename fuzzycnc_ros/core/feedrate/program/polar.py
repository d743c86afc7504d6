# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Places by radius and angle about the origin of the program: LinuxCNC's `@10 ^45`."""

import math
from copy import copy

from fuzzycnc_ros.core.feedrate.program.lexer import Line, Word
from fuzzycnc_ros.core.feedrate.program.modal import State

LETTERS = '@^'


def cartesian(line: Line, state: State) -> Line:
    """Return a line with X and Y in place of `@` and `^`.

    Parameters
    ----------
    line : Line
        What the line says, with a radius or an angle.
    state : State
        Modal state before it; a part that is left out stays as it is.

    Returns
    -------
    Line
        X and Y have no value where the program does not say from where it starts.
    """
    value = {word.letter: word.value for word in line.words}
    place = _place(value, state)
    spans = [(word.start, word.end) for word in line.words if word.letter in LETTERS]
    found = copy(line)
    found.words = [word for word in line.words if word.letter not in LETTERS]
    for axis, coordinate in zip('XY', place, strict=True):
        found.words.append(Word(axis, coordinate, *spans[0]))
    return found


def _place(value: dict[str, float | None], state: State) -> tuple[float | None, float | None]:
    """Return X and Y as the line would have to say them."""
    radius, angle = value.get('@', math.nan), value.get('^', math.nan)
    if radius is None or angle is None or 'X' in value or 'Y' in value:
        return None, None
    x, y = (state.position[axis] / state.length_unit for axis in (0, 1))
    start, way = (x, y), 1.0
    if not state.absolute or math.isnan(radius + angle):
        if not math.isfinite(x + y) or x == y == 0.0 or not state.assumed.isdisjoint('XY'):
            return None, None
        before = math.hypot(x, y), math.degrees(math.atan2(y, x))
        if state.absolute:
            radius = before[0] if math.isnan(radius) else radius
            angle = before[1] if math.isnan(angle) else angle
        else:
            # A cycle that is repeated (L) turns and widens with each hole; each gets its share.
            way = value.get('L', 1.0) or math.nan
            radius = before[0] + way * (0.0 if math.isnan(radius) else radius)
            angle = before[1] + way * (0.0 if math.isnan(angle) else angle)
    if math.isnan(way):
        return None, None
    turn = math.radians(angle)
    place = (radius * math.cos(turn), radius * math.sin(turn))
    if state.absolute:
        return place
    return (place[0] - start[0]) / way, (place[1] - start[1]) / way

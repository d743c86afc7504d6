# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From the words of a line and the modal state to the segments that the tool runs.

Beside lines and arcs these are fixed cycles and NURBS curves over many lines (G5.2 ... G5.3,
G6.2).  A cycle (G73, G81 to G86, G89) moves above its hole, down to R by rapid and to Z by feed,
and back up: to R (G99), or to where the axis stood before the first of the cycles (G98).
"""

import math
from abc import ABC, abstractmethod
from itertools import pairwise
from math import isfinite, nan

import numpy as np

from fuzzycnc_ros.core.feedrate.gcode.arcs import (
    ABSOLUTE_MISFIT,
    MISFIT_INCH,
    MISFIT_MILLIMETRE,
    PLANES,
    TURNS_MAX,
    by_radius,
    centred,
    fits,
)
from fuzzycnc_ros.core.feedrate.gcode.lexer import Line, Word
from fuzzycnc_ros.core.feedrate.gcode.modal import INCH, Cycle, ModalState
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    ArcSegment,
    DwellSegment,
    LineSegment,
    Point,
    ProgramError,
    Segment,
    UnplacedSegment,
)
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve, check_machinable

_XYZ = 'XYZ'
_OTHER_AXES = frozenset('ABCUVW')
_CENTRES = 'IJK'
_ARC_NAMES = frozenset({'CR', 'TURN'})


NO_PLACE = 'a motion from or to a place that the program does not say'


class UnreadableError(Exception):
    """A motion whose geometry the program leaves to the controller; its message says why."""


def named_axes(line: Line, relative: bool = False) -> str:
    """Return which of X, Y and Z a line names, if asked also as U, V and W."""
    named = {word.letter for word in line.words}
    return ''.join(
        axis
        for axis, other in zip(_XYZ, 'UVW', strict=True)
        if axis in named or (relative and other in named)
    )


def move(line: Line, number: int, state: ModalState) -> Segment | None:
    """Return the segment of a line with axis words, and move the state on.

    Parameters
    ----------
    line : Line
        What the line says; its G, M and F words are in the state already.
    number : int
        Its number.
    state : ModalState
        Modal state; the position moves on.

    Returns
    -------
    Segment or None
        None where nothing moves.

    Raises
    ------
    ProgramError
        If the motion is impossible.
    UnreadableError
        If the motion is not known, or not from where; the state has forgotten the axes then.
    """
    start = state.position
    target = start.copy()
    arc_words = named = False
    moved = ''
    pivot = state.pivot and state.motion in (0, 10)
    assumed = state.assumed if state.absolute else None
    for letter, value, _, _ in line.words:
        if letter in _XYZ:
            named = True
            if assumed:
                assumed.discard(letter)
            axis = _XYZ.index(letter)
            target[axis] = _coordinate(axis, value, start[axis], state)
        elif letter in 'UVW' and state.lathe:
            named = True
            axis = 'UVW'.index(letter)
            target[axis] += nan if value is None else state.length(axis, value, False)
        elif letter in _OTHER_AXES:
            moved += letter if _turn(letter, value, state) else ''
        elif letter in _CENTRES or letter == 'R':
            arc_words = True
            if pivot and letter != 'R':  # the direction of the tool
                moved += letter
    turning = bool(moved)
    motion = state.motion
    is_arc = motion in (20, 30)
    if not turning and not named and not (is_arc and (arc_words or line.assigned)):
        return None
    _check_feed(number, state)
    strange = [name for name in line.assigned if not (is_arc and name in _ARC_NAMES)]
    bent = state.polar or state.transform or state.modal_call
    if motion not in (0, 10, 20, 30) or strange or bent:
        state.lose(named_axes(line))
        raise UnreadableError(_why(motion, strange, state))
    state.position = target
    placed = all(map(math.isfinite, (*start, *target)))
    if not placed:
        state.kind = ''
        start, target = _somewhere(line, start, target, state)
    begin, end = (start[0], start[1], start[2]), (target[0], target[1], target[2])
    if turning:
        _lose_relative(line, moved, state)
    feed = None if motion == 0 else state.feed
    run = state.run_of('rapid' if motion == 0 else 'kept' if turning or feed is None else 'feed')
    segment: Segment
    if is_arc:
        segment = _arc(line, number, state, (begin, end, feed, turning, run))
    else:
        segment = LineSegment(number, begin, end, feed, motion == 0, turning, run)
    if placed:
        return segment
    state.kind = ''
    return UnplacedSegment.of(segment)


def _somewhere(
    line: Line, start: list[float], target: list[float], state: ModalState
) -> tuple[list[float], list[float]]:
    """Return a start and an end that are as far apart as those of a line without a place.

    Raises
    ------
    UnreadableError
        If its way depends on the place.
    """
    begin = [value if isfinite(value) else 0.0 for value in start]
    end = begin.copy()
    words = {word.letter: word.value for word in line.words}
    for axis, letter in enumerate(_XYZ):
        relative = 'UVW'[axis] if state.lathe and 'UVW'[axis] in words else letter
        if relative not in words:
            continue
        value = words[relative]
        if isfinite(start[axis]) and isfinite(target[axis]):
            end[axis] = target[axis]
        elif value is None or (relative == letter and state.absolute):
            raise UnreadableError(NO_PLACE)
        else:
            end[axis] += state.length(axis, value, False)
    if state.centre_absolute and state.motion in (20, 30) and 'R' not in words:
        raise UnreadableError(NO_PLACE)
    return begin, end


DWELL_MAX = 1e7
"""Longest wait [s]: four months."""


def dwell(line: Line, number: int, state: ModalState) -> DwellSegment | None:
    """Return the wait of a line with G4: P, else X, U or F, in seconds.

    Printers take S in seconds and P in milliseconds.  None where the program does not tell how
    long it is: it is computed, or S counts turns of the spindle (Siemens).
    """
    found = {word.letter: word.value for word in line.words}
    if state.printer:
        found = {'P': found.get('S', 1e-3 * (found.get('P') or 0.0))}
    duration = next((found[letter] for letter in 'PXUF' if letter in found), 0.0)
    if duration is None or (duration == 0.0 and 'S' in found):
        state.kind = ''
        return None
    if not 0.0 <= duration <= DWELL_MAX:
        raise ProgramError(
            number,
            f'expected a wait of at least 0 s and at most {DWELL_MAX:g} s but found '
            f'{duration:g} s',
        )
    x, y, z = state.position
    place = (x, y, z)
    return DwellSegment(number, place, place, None, False, False, state.run_of('dwell'), duration)


def _coordinate(axis: int, value: float | None, before: float, state: ModalState) -> float:
    if value is None:
        return math.nan
    length = state.length(axis, value, state.absolute)
    return length if state.absolute else before + length


def _turn(letter: str, value: float | None, state: ModalState) -> bool:
    """Move another axis; return whether it may turn."""
    before = state.others.get(letter)
    if value is None:
        state.others.pop(letter, None)
        return True
    if state.absolute:
        state.others[letter] = value
        return before != value
    if before is not None:
        state.others[letter] = before + value
    return value != 0.0


def _lose_relative(line: Line, moved: str, state: ModalState) -> None:
    """Forget X, Y and Z where U, V and W may be their increments, as on lathes of Fanuc.

    A line that names X as well as U means two axes.
    """
    named = named_axes(line)
    for relative, axis in zip('UVW', _XYZ, strict=True):
        if relative in moved and axis not in named:
            state.position[_XYZ.index(axis)] = math.nan


def _check_feed(number: int, state: ModalState) -> None:
    if state.motion == 0 or state.motion is None or state.feed_mode != 94:
        return
    if state.feed == 0.0 or (state.feed is None and state.feed_known):
        found = 'none' if state.feed is None else '0'
        raise ProgramError(
            number, f'expected a feed above 0 (F) before a motion with feed but found {found}'
        )


def _why(motion: int | None, strange: list[str], state: ModalState) -> str:
    if strange:
        return f'a motion with {", ".join(sorted(strange))}'
    if state.polar:
        return 'a motion in polar coordinates (G16)'
    if state.transform:
        return f'a motion in the coordinates of {state.transform}'
    if state.modal_call or motion == -1:
        return 'a position at which a cycle runs'
    return 'a motion without G0 to G3 in effect'


def _arc(
    line: Line,
    number: int,
    state: ModalState,
    common: tuple[Point, Point, float | None, bool, int],
) -> ArcSegment:
    """Return the arc of a line: by its centre (I, J, K), or by its radius (R, CR=)."""
    begin, end, feed, turning, run = common
    axes = PLANES[state.plane]
    words = {word.letter: word.value for word in line.words}
    words |= {name: line.assigned[name] for name in _ARC_NAMES & set(line.assigned)}
    computed = [
        name for name in ('R', 'P', *_CENTRES, *_ARC_NAMES) if words.get(name, 0.0) is None
    ]
    if computed:
        raise UnreadableError(
            f'an arc whose {", ".join(sorted(computed))} the controller computes'
        )
    start2 = (begin[axes[0]], begin[axes[1]])
    end2 = (end[axes[0]], end[axes[1]])
    clockwise = state.motion == 20
    radius = words.get('CR', words.get('R'))
    plane = f'{_XYZ[axes[0]]} or {_XYZ[axes[1]]}'
    if radius is not None:
        if not {_XYZ[axes[0]], _XYZ[axes[1]]} & set(named_axes(line, relative=state.lathe)):
            raise ProgramError(
                number, f'expected an end ({plane}) of an arc with a radius but found none'
            )
        centre, sweep = by_radius(number, start2, end2, radius * state.length_unit, clockwise)
    else:
        letters = [_CENTRES[axes[0]], _CENTRES[axes[1]]]
        if not set(letters) & set(words):
            raise ProgramError(
                number,
                f'expected a centre ({" or ".join(letters)}) or a radius (R) of an arc in the '
                f'plane G{state.plane} but found none',
            )
        offset = [(words.get(letter) or 0.0) * state.length_unit for letter in letters]
        base = (0.0, 0.0) if state.centre_absolute else start2
        centre = (base[0] + offset[0], base[1] + offset[1])
        if not fits(start2, end2, centre, _misfit(state)):
            first, last = math.dist(start2, centre), math.dist(end2, centre)
            raise ProgramError(
                number,
                'expected start and end of the arc equally far from its centre but found '
                f'{1e3 * first:.6g} mm and {1e3 * last:.6g} mm: the radius does not fit; '
                + _remedy(state, words, (start2, end2, (offset[0], offset[1]))),
            )
        sweep = centred(start2, end2, centre, clockwise, _extra_turns(words, number, state))
    arc = ArcSegment(number, begin, end, feed, False, turning, run, axes, centre, sweep)
    if abs(sweep) > 2.0 * math.pi and arc.length > _LONGEST:
        raise ProgramError(
            number,
            f'expected no more than {_LONGEST:,.0f} m of an arc of several turns but found '
            f'{arc.length:,.0f} m; of no machine',
        )
    return arc


def _misfit(state: ModalState) -> float:
    return MISFIT_INCH if state.length_unit == INCH else MISFIT_MILLIMETRE


def _remedy(
    state: ModalState,
    words: dict[str, float | None],
    arc: tuple[tuple[float, float], tuple[float, float], tuple[float, float]],
) -> str:
    """Return what to do about a centre that does not fit: start, end, and what I, J, K say."""
    start, end, offset = arc
    axes = PLANES[state.plane]
    letters = [_CENTRES[axes[0]], _CENTRES[axes[1]]]
    named = ' and '.join(letters)
    relative = (start[0] + offset[0], start[1] + offset[1])
    read, other = ('relative to the start', 'absolute ones'), (offset, 'G90.1')
    if state.centre_absolute:
        read, other = (read[1], read[0]), (relative, 'G91.1')
    misfit = _misfit(state)
    if fits(start, end, other[0], misfit):
        return (
            f'{named} are read as {read[0]} and would fit as {read[1]}: write {other[1]} above, '
            'if the control reads them so'
        )
    outside = [letter for letter in _CENTRES if letter not in letters and words.get(letter)]
    if outside:
        return f'{outside[0]} lies outside of the plane G{state.plane}: write its plane above'
    share = [1.0 if axis else 0.5 for axis in axes]
    begin = (start[0] * share[0], start[1] * share[1])
    if state.x_share[0] == 1.0 and fits(
        begin,
        (end[0] * share[0], end[1] * share[1]),
        offset if state.centre_absolute else (begin[0] + offset[0], begin[1] + offset[1]),
        misfit,
    ):
        return 'X would fit as a diameter: write G7 above, if this is a program of a lathe'
    return f'check {named}, which are read as {read[0]}'


TURNS_IN_ALL = 10_000
"""Turns of a program beyond the first of each arc: more would take minutes to schedule."""


def _extra_turns(words: dict[str, float | None], number: int, state: ModalState) -> int:
    """Return the full turns on top: P counts all begun turns, TURN= the ones on top."""
    turns = words.get('TURN')
    first = 0.0
    if turns is None:
        first = 1.0
        turns = (words.get('P') or first) - first
    if turns < 0.0 or turns != int(turns):
        raise ProgramError(
            number, 'expected a whole number of turns of an arc, P from 1 or TURN= from 0'
        )
    state.turns += int(turns)
    for found, most, where in (
        (turns + first, TURNS_MAX + first, 'an arc'),
        (state.turns, TURNS_IN_ALL, 'all arcs of a program'),
    ):
        if found > most:
            raise ProgramError(
                number,
                f'expected no more than {most:,.0f} turns of {where} but found {found:,.0f}; '
                'of no machine',
            )
    return int(turns)


_LONGEST = 1e3
"""Length of an arc of several turns [m], beyond which it would take minutes to schedule."""

_FARTHEST = 1e3
"""Way of repeated holes beyond which nobody knows where they end [m]."""

_FOLLOWED = frozenset({730, 810, 820, 830, 840, 850, 860, 890})
"""Cycles that end above the hole.

G74 is a reference in Siemens' language; G76, G87 and G88 differ between controllers, or wait for
the operator.
"""


def begin_cycle(code: int, state: ModalState) -> None:
    """Take a cycle's G word: R and Z stay in effect only where the same cycle goes on."""
    if state.cycle is None or state.motion != -1:
        state.cycle = Cycle(code, state.position[PLANES[state.plane][2]])
    elif state.cycle.code != code:
        state.cycle = Cycle(code, state.cycle.start)


def runs_cycle(line: Line, state: ModalState) -> bool:
    """Return True if a line with a cycle in effect runs it: it names an axis."""
    return state.cycle is not None and any(word.letter in 'XYZABCUVW' for word in line.words)


def run_cycle(line: Line, state: ModalState) -> bool:
    """Move the state on by a cycle; return whether its end is known in all axes.

    Parameters
    ----------
    line : Line
        What the line says; its G, M and F words are in the state already.
    state : ModalState
        Modal state with a cycle in effect; axes whose end is unknown are lost.
    """
    cycle = state.cycle
    assert cycle is not None
    state.kind = ''
    first, second, across = PLANES[state.plane]
    value = {word.letter: word.value for word in line.words}
    bent = state.polar or state.transform or state.modal_call
    plain = not line.assigned and not bent
    if cycle.code not in _FOLLOWED or not plain or not value.keys().isdisjoint('ABCUVW'):
        state.lose()
        return False
    for axis in (first, second):
        state.position[axis] = _above(state, axis, value)
    cycle.retract = _length('R', value, cycle.retract, state)
    state.position[across] = _height(cycle, state)
    known = all(map(isfinite, state.position))
    if state.absolute:
        named = {_XYZ[axis] for axis in (first, second) if _XYZ[axis] in value}
        state.assumed -= named | ({_XYZ[across]} if state.retracts else set())
    return known


def _length(
    letter: str, value: dict[str, float | None], before: float | None, state: ModalState
) -> float | None:
    if letter not in value:
        return before
    number = value[letter]
    return None if number is None else number * state.length_unit


def _above(state: ModalState, axis: int, value: dict[str, float | None]) -> float:
    """Return where the last hole lies; L repeats relative ones (Fanuc's K is not followed)."""
    before = state.position[axis]
    if _XYZ[axis] not in value:
        return before
    number = value[_XYZ[axis]]
    if number is None:
        return nan
    length = state.length(axis, number, state.absolute)
    if state.absolute:
        return length
    repeats = nan if 'K' in value else value.get('L', 1.0)
    if not repeats or not isfinite(repeats) or abs(length * repeats) > _FARTHEST:
        return nan
    return before + length * round(repeats)


def _height(cycle: Cycle, state: ModalState) -> float:
    """Return where the axis across the plane ends."""
    if cycle.retract is None:
        return nan
    retract = cycle.retract if state.absolute else cycle.start + cycle.retract
    start = max(cycle.start, retract)  # from below R it rises to R first, and comes back there
    if state.retracts or start == retract:
        return retract
    return start if state.retracts is False else nan


POINTS_MAX = 2000
"""Control points of a curve at most: each takes up to 0.1 s to schedule."""

_FEWEST_ORDER = 3
"""LinuxCNC takes an L below that for this."""


class CurveBlock(ABC):
    """A curve that is being read.

    Parameters
    ----------
    line : int
        Number of its first line.
    state : ModalState
        Modal state before it; its position is the start.
    """

    def __init__(self, line: int, state: ModalState) -> None:
        self.line = line
        self.state = state
        self.start = tuple(state.position)
        self.control: list[list[float]] = []
        self.weight: list[float] = []

    @abstractmethod
    def take(self, words: list[Word], line: int) -> bool:
        """Take the words of a line; return whether the curve is complete with them."""

    @abstractmethod
    def close(self) -> NurbsCurve:
        """Return the curve; `ProgramError` if it is none."""

    def _numbers(self, words: list[Word], line: int) -> dict[str, float]:
        if len(self.control) > POINTS_MAX:
            raise ProgramError(
                line, f'expected at most {POINTS_MAX:,} control points of a NURBS block; cut it'
            )
        if not self.state.absolute:
            raise ProgramError(
                line, 'expected absolute coordinates (G90) in a NURBS block but found G91'
            )
        number: dict[str, float] = {}
        for word in words:
            if word.letter in 'ABCUVWXYZKLPR':
                if word.value is None:
                    raise ProgramError(
                        line, f'expected a plain number for {word.letter} in a NURBS block'
                    )
                number[word.letter] = word.value
        turned = sorted(set('ABCUVW') & set(number))
        if turned:
            raise ProgramError(
                line, f'expected X, Y and Z in a NURBS block but found {", ".join(turned)}'
            )
        return number

    def _curve(self, knot: list[float], degree: int) -> NurbsCurve:
        if not np.isfinite(self.control).all():
            raise ProgramError(
                self.line,
                'expected a known place before a NURBS block; name all three axes in a block '
                'with G0 or G1 before it',
            )
        try:
            curve = NurbsCurve(self.control, self.weight, knot, degree)
            check_machinable(curve.control, curve.weight, curve.knot, degree)
            return curve
        except ValueError as error:
            raise ProgramError(self.line, f'no NURBS curve begins here: {error}') from error


class PlaneCurveBlock(CurveBlock):
    """G5.2 ... G5.3 of LinuxCNC: control points in the plane, weights P, order L.

    The place before the block is the first control point.  The knots are not programmed: they
    are clamped and even, as LinuxCNC sets them.
    """

    def __init__(self, line: int, state: ModalState) -> None:
        super().__init__(line, state)
        self.order = _FEWEST_ORDER
        self.control.append(list(self.start))
        self.weight.append(1.0)

    def take(self, words: list[Word], line: int) -> bool:
        """Take a control point, see `CurveBlock.take`."""
        number = self._numbers(words, line)
        self.order = max(self.order, int(number.get('L', 0.0)))
        first, second, across = ('XYZ'[axis] for axis in PLANES[self.state.plane])
        if across in number or (first in number) != (second in number):
            raise ProgramError(
                line,
                f'expected {first} and {second} of a control point in a G5.2 block, without '
                f'{across}, but found {" ".join(sorted(set("XYZ") & set(number)))}',
            )
        if first in number:
            point = list(self.start)
            for axis in (first, second):
                index = 'XYZ'.index(axis)
                point[index] = self.state.length(index, number[axis], True)
            self.control.append(point)
            self.weight.append(number.get('P', 1.0))
        elif 'P' in number and len(self.control) == 1:
            self.weight[0] = number['P']
        return False

    def close(self) -> NurbsCurve:
        """Return the curve."""
        count, order = len(self.control), self.order
        if count < order:
            raise ProgramError(
                self.line,
                f'expected at least {order} control points of a curve of order {order} (L), the '
                f'place before it included, but found {count}',
            )
        inner = [float(number) for number in range(1, count - order + 1)]
        return self._curve([0.0] * order + inner + [count - order + 1.0] * order, order - 1)


class KnotCurveBlock(CurveBlock):
    """G6.2: order P, in each line a knot K and a control point with weight R, then knots alone.

    The first control point is where the tool stands, or is left out.
    """

    def __init__(self, line: int, state: ModalState) -> None:
        super().__init__(line, state)
        self.order = 4
        self.knot: list[float] = []

    def take(self, words: list[Word], line: int) -> bool:
        """Take a knot, and a control point, see `CurveBlock.take`."""
        number = self._numbers(words, line)
        if 'P' in number:
            self.order = int(number['P'])
            if self.order < 2 or self.order != number['P']:
                raise ProgramError(
                    line, f'expected a whole order P from 2 of a curve but found {number["P"]:g}'
                )
        if not number and self.control:
            return False
        if 'K' in number:
            # The first knot may be left out: it is the second one then.
            self.knot += [number['K']] * (2 if self.control and not self.knot else 1)
        elif self.control:
            raise ProgramError(line, 'expected a knot K in each line of a G6.2 block')
        if not self.control or not set('XYZR').isdisjoint(number):
            self._take_point(number, line)
        return len(self.knot) == len(self.control) + self.order

    def _take_point(self, number: dict[str, float], line: int) -> None:
        if len(self.knot) > len(self.control) + 1:
            raise ProgramError(
                line,
                f'expected {self.order} knots alone after the last control point of a curve of '
                f'order {self.order} (P) but found {len(self.knot) - len(self.control) - 1}',
            )
        point = list(self.control[-1] if self.control else self.start)
        for index, axis in enumerate('XYZ'):
            if axis in number:
                point[index] = self.state.length(index, number[axis], True)
        if not self.control and math.dist(point, self.start) > ABSOLUTE_MISFIT:
            raise ProgramError(
                line, 'expected the first control point of a G6.2 block where the tool stands'
            )
        self.control.append(point)
        self.weight.append(number.get('R', 1.0))

    def close(self) -> NurbsCurve:
        """Return the curve."""
        knot = self.knot
        if len(knot) != len(self.control) + self.order:
            raise ProgramError(
                self.line,
                f'expected {len(self.control) + self.order} knots for {len(self.control)} '
                f'control points of order {self.order} (P) but found {len(knot)}',
            )
        if any(after < before for before, after in pairwise(knot)):
            raise ProgramError(self.line, 'expected knots K that never fall in a G6.2 block')
        return self._curve(knot, self.order - 1)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Line by line: what each one means, with the modal state of all before it."""

import math
import re
from collections.abc import Callable
from copy import copy
from dataclasses import replace

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.feedrate.gcode import modal
from fuzzycnc_ros.core.feedrate.gcode.arcs import ABSOLUTE_MISFIT
from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Note, Role
from fuzzycnc_ros.core.feedrate.gcode.expressions import Expression, ExpressionError
from fuzzycnc_ros.core.feedrate.gcode.lexer import Line, Word, resolved
from fuzzycnc_ros.core.feedrate.gcode.modal import ModalState, least_feed
from fuzzycnc_ros.core.feedrate.gcode.motion import (
    NO_PLACE,
    CurveBlock,
    KnotCurveBlock,
    PlaneCurveBlock,
    UnreadableError,
    begin_cycle,
    dwell,
    move,
    named_axes,
    run_cycle,
    runs_cycle,
)
from fuzzycnc_ros.core.feedrate.gcode.outline import Outline
from fuzzycnc_ros.core.feedrate.gcode.parameters import Parameters
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    ArcSegment,
    NurbsSegment,
    ProgramError,
    Segment,
    UnplacedSegment,
)

_LETTERS = '@^'


def _cartesian(line: Line, state: ModalState) -> Line:
    """Return a line with X and Y in place of `@` and `^`.

    Parameters
    ----------
    line : Line
        What the line says, with a radius or an angle.
    state : ModalState
        Modal state before it; a part that is left out stays as it is.

    Returns
    -------
    Line
        X and Y have no value where the program does not say from where it starts.
    """
    value = {word.letter: word.value for word in line.words}
    place = _xy(value, state)
    spans = [(word.start, word.end) for word in line.words if word.letter in _LETTERS]
    found = copy(line)
    found.words = [word for word in line.words if word.letter not in _LETTERS]
    for axis, coordinate in zip('XY', place, strict=True):
        found.words.append(Word(axis, coordinate, *spans[0]))
    return found


def _xy(value: dict[str, float | None], state: ModalState) -> tuple[float | None, float | None]:
    """Return X and Y as the line would have to say them."""
    radius, angle = value.get('@', math.nan), value.get('^', math.nan)
    if radius is None or angle is None or 'X' in value or 'Y' in value:
        return None, None
    x, y = (state.position[axis] / state.length_unit for axis in (0, 1))
    start, way = (x, y), 1.0
    if not state.absolute or math.isnan(radius + angle):
        if not math.isfinite(x + y) or x == y == 0.0 or not state.assumed.isdisjoint('XY'):
            return None, None
        before = math.hypot(x, y), math.degrees(portable.arctan2(y, x))
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
    place = (radius * portable.cos(turn), radius * portable.sin(turn))
    if state.absolute:
        return place
    return (place[0] - start[0]) / way, (place[1] - start[1]) / way


class _Notes:
    """Collects notes; the same text is counted."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[int, int]] = {}

    def add(self, line: int, text: str) -> None:
        """Add a note of a line."""
        first, count = self._found.get(text, (line, 0))
        self._found[text] = (first, count + 1)

    def all(self) -> tuple[Note, ...]:
        """Return the notes in the order in which they were met first."""
        return tuple(Note(line, count, text) for text, (line, count) in self._found.items())


_SLOWEST = 1e-3 / modal.MINUTE
_FASTEST = 1e9
_CALL_LETTERS = frozenset('XYZABCUVWG')
_CURVE_LETTERS = frozenset('GNFXYZPLKRABCUVW')
_CALL_M = frozenset({97, 98, 99})
_NO_JUMPS: frozenset[int] = frozenset()
_NO_OUTLINE = Outline()
_LINE_NUMBER = re.compile(r'[ \t/]*N[ \t]*0*(\d{1,9})(?!\d)', re.IGNORECASE | re.ASCII)


class Interpreter:
    """Reads a program line by line in bounded memory.

    Parameters
    ----------
    length_unit : float
        What a length of 1 is before the program says G20 or G21 [m].
    outline : Outline
        What is known of the whole program.

    Attributes
    ----------
    state : ModalState
        Modal state after the last line.
    parameters : Parameters
        Values that the program has set.
    notes : _Notes
        What was passed through so far.
    followed : bool
        The lines belong to a part whose order O-words or calls decide.
    """

    def __init__(
        self,
        length_unit: float = modal.MILLIMETRE,
        outline: Outline = _NO_OUTLINE,
    ) -> None:
        self.state = modal.ModalState(length_unit)
        self._jumps = outline.jumps
        self._curve: CurveBlock | None = None
        self._held: list[Block] = []
        self._saved: list[tuple[dict[str, object], bool] | None] = [None]
        self._line = 0
        self.notes = _Notes()
        self.parameters = Parameters(self.state)
        self.followed = False
        self._words = _GWords(self.state, self._say)
        self.state.unnamed = outline.unnamed
        if outline.lathe:
            self.state.set_lathe()
            self.notes.add(
                1,
                'a lathe (limit or surface speed of the spindle, turning cycle, home by U and W): '
                'X is a diameter, U and W are relative, and feeds are per revolution until G94 or '
                'G98',
            )

    def read(self, text: str, line: Line, number: int) -> list[Block]:
        """Read the next line.

        Parameters
        ----------
        text : str
            The line with its ending.
        line : Line
            What it says.
        number : int
            Its number.

        Returns
        -------
        list of Block
            Blocks that are complete with it, in order.  Lines of a curve are held back until the
            curve is over.

        Raises
        ------
        ProgramError
            If the line says something impossible.
        """
        self._line = number
        if not line.computed and not line.settings:
            return self._open(text, line) if self._curve is None else self._continue(text, line)
        line = resolved(line, self.parameters, number)
        # Parameters change behind the line: all of its values are those from before it.
        found = [
            (
                target if isinstance(target, str) else self.value(target),
                None if line.optional else self.value(expression),
            )
            for target, expression in line.settings
        ]
        blocks = self._open(text, line) if self._curve is None else self._continue(text, line)
        for where, value in found:
            if isinstance(where, str):
                self.parameters.set_named(where, value)
            else:
                self.parameters.set_number(where, value)
        return blocks

    def pass_by(self, text: str, number: int, line: Line | None = None) -> list[Block]:
        """Pass a line that moves and sets nothing: an O-word, or text that is not run."""
        self._line = number
        block = self._block(text, line or Line(), Role.PLAIN, None)
        if self._curve is None:
            return [block]
        self._held.append(block)
        return []

    def lose(self, reason: str) -> None:
        """Note why nothing is known any more: neither places nor the feed."""
        self._say(reason)
        self.state.lose()
        self.state.lose_feed()

    def seal(self, text: str, number: int) -> Block:
        """Return the block from which on nothing is known: the program's feed has to be there."""
        self._line = number
        return self._block(text, Line(), Role.SEALED, None)

    def unknown_call(self, text: str, number: int, line: Line, name: str) -> Block:
        """Return the block of a call that is not followed, and forget what it may change."""
        self._line = number
        before = self._block(text, line, Role.SEALED, None)
        self.lose(
            f'call of {name or "a subroutine"}, which is not here: {_LOST}, the feed until F'
        )
        return replace(before, feed=None)

    def enter(self, arguments: list[float | None] | None) -> None:
        """Begin a subroutine; None hands on the arguments of the one that calls."""
        self.parameters.enter(arguments)
        self._saved.append(None)

    def leave(self, result: tuple[float | None, float]) -> None:
        """End a subroutine with its result; M73 restores the modes."""
        self.parameters.leave(result)
        saved = self._saved.pop()
        if saved is not None and saved[1]:
            self._restore(saved[0])

    def close(self) -> list[Block]:
        """End the program, and return what was held back.

        Raises
        ------
        ProgramError
            If a curve is not complete.
        """
        return self._finish() if self._curve else []

    def value(self, expression: Expression | None) -> float | None:
        """Return the value of an expression, None where only the controller knows it."""
        try:
            return None if expression is None else expression(self.parameters)
        except ExpressionError as error:
            raise ProgramError(self._line, str(error)) from error

    def _open(self, text: str, line: Line) -> list[Block]:
        reached = self._jumps != _NO_JUMPS and self._reached(text)
        if reached:
            self.lose(f'a jump may come here (GOTO): {_LOST}, the feed until F')
            self.state.motion, self.state.cycle = None, None
        role, segment = self._meaning(line)
        if reached and not _names(line, 'F') and role is not Role.PLAIN:
            # A word here would hold for those who jump here, too.
            role = Role.SEALED
        if line.optional:
            self.state.kind = ''
            if role in (Role.FEED, Role.KEPT):
                role = Role.SEALED
                segment = None if segment is None else replace(segment, feed=None)
        block = self._block(text, line, role, segment)
        if self._curve is None:
            return [block]
        self._held = [block]
        return self._finish() if self._curve.take(line.words, self._line) else []

    def _reached(self, text: str) -> bool:
        """Return True if a jump may lead to a line."""
        number = _LINE_NUMBER.match(text)
        return number is not None and (self._jumps is None or int(number[1]) in self._jumps)

    def _continue(self, text: str, line: Line) -> list[Block]:
        curve = self._curve
        assert curve is not None
        code = [round(10.0 * (word.value or 0.0)) for word in line.words if word.letter == 'G']
        if code and code != [self.state.motion]:
            done = self._finish()
            if code in ([53], [63]):
                self.state.motion = None
                return [*done, self._block(text, line, Role.PLAIN, None)]
            return [*done, *self._open(text, line)]
        letters = {word.letter for word in line.words}
        if line.names or line.calls or line.strange or not letters <= _CURVE_LETTERS:
            raise ProgramError(
                self._line,
                'expected control points only in a NURBS block; end it before (G5.3, G1)',
            )
        self._set_feed(line)
        complete = curve.take(line.words, self._line)
        self._held.append(self._block(text, line, Role.PLAIN, None))
        return self._finish() if complete else []

    def _finish(self) -> list[Block]:
        """Close the curve and return its blocks, the first one with the segment."""
        curve, held, state = self._curve, self._held, self.state
        assert curve is not None
        self._curve, self._held = None, []
        shape = curve.close()
        first, last = shape.control[0].tolist(), shape.control[-1].tolist()
        state.position = last
        inside = any(block.word for block in held[1:])
        if inside:
            self._say('feed word inside a NURBS block: the curve keeps its feed')
        kept = state.feed is None or held[0].optional or inside
        if state.feed_mode == 94 and (
            state.feed == 0.0 or (state.feed is None and state.feed_known)
        ):
            raise ProgramError(curve.line, 'expected a feed above 0 (F) before a NURBS block')
        segment = NurbsSegment(
            line=curve.line,
            start=(first[0], first[1], first[2]),
            end=(last[0], last[1], last[2]),
            feed=None if kept else state.feed,
            rapid=False,
            turning=False,
            run=state.run_of('kept' if kept else 'feed'),
            curve=shape,
            last_line=held[-1].line,
        )
        role = Role.KEPT if kept else Role.FEED
        return [replace(held[0], role=role, segment=segment), *held[1:]]

    def _block(self, text: str, line: Line, role: Role, segment: Segment | None) -> Block:
        state = self.state
        word = None
        for letter, value, start, end in line.words:
            if letter == 'F' and value is not None and state.feed_mode == 94:
                word = None if state.motion in modal.THREADS else (start, end)
            elif letter == 'G' and value == 4.0:  # a wait: its F is no feed
                word = None
                break
        return Block(
            line=self._line,
            text=text,
            role=role,
            segment=segment,
            feed=state.feed,
            word=word,
            insert=line.end,
            feed_unit=state.feed_unit,
            optional=line.optional,
            followed=self.followed,
            rounding=state.rounding,
        )

    def _meaning(self, line: Line) -> tuple[Role, Segment | None]:
        state = self.state
        if line.percent:
            state.percents += 1
            state.ended = state.percents > 1
            return Role.PLAIN, None
        if line.optional:
            self._say('block that may be skipped (/): taken as run, with its own feed')
            state.kind = ''
        if line.command:
            self._say(f'command to the control ($): kept; {_LOST}')
            state.lose()
            moving = line.command.upper().startswith(modal.MOVING_COMMANDS)
            return (Role.SEALED if moving else Role.PLAIN), None
        if line.flow is not None:
            self.lose(f'O-words are not followed here: {_LOST}, the feed until F')
            self.parameters.forget(everything=True)
            return Role.SEALED, None
        if line.kept:
            self._say(f'{line.kept}: kept, with what stands beside it')
        if line.names and line.names[0] in modal.KLIPPER:
            self._say(f'{line.names[0]}: passed through')
            return Role.PLAIN, None
        if not modal.DECLARATIONS.isdisjoint(line.names):
            self._say('declaration: passed through')
            return Role.PLAIN, None
        codes, ms = [], []
        for letter, value, _, _ in line.words:
            if letter == 'G':
                codes.append(-1 if value is None else round(10.0 * value))
            elif letter == 'M':
                ms.append(value)
        if codes and not modal.SHARED.isdisjoint(codes):
            role = self._shared(codes, line)
            if role is not None:
                return role, None
        elsewhere, feed_unit = 'SUPA' in line.names, state.feed_unit
        changed = state.unit_said or state.feed is not None or len(state.assumed) < 3
        moves, gone = True, False
        for code in codes:
            kind = self._words.take(code, line)
            elsewhere = elsewhere or kind == 'elsewhere'
            gone = gone or kind == 'gone'
            moves = moves and kind not in ('call', 'shift', 'dwell')
        if 40 not in codes:
            self._set_feed(line)
            if state.feed_unit != feed_unit and _names(line, 'F'):
                # LinuxCNC takes it in the old unit, GRBL in the new one: 25 times as fast or slow.
                # Before any unit was said, the old one is that of a machine that is set up for it.
                if changed:
                    self._say(
                        'feed beside a change of units: unknown, as controllers differ; give F '
                        'alone'
                    )
                    state.lose_feed()
                else:
                    self._say(
                        'feed beside the first unit: taken in it, as controllers differ (LinuxCNC '
                        "in the machine's own one); give F alone"
                    )
        if ms:
            self._machine(ms)
        if line.names or line.calls or line.strange:
            role = self._names(line)
            if role is not None:
                return role, None
        if not modal.MOVING_M.isdisjoint(ms):
            return Role.SEALED, None
        if 40 in codes:
            wait = dwell(line, self._line, state)
            if wait is None:
                self._say('a wait whose time the program does not state')
                return Role.SEALED, None
            return Role.PLAIN, wait
        if modal.CALLS & set(codes) or (ms and _CALL_M & set(ms)) or self._called(line):
            self.lose(f'call of a subprogram: {_LOST}, the feed until F')
            self.parameters.forget()
            return Role.SEALED, None
        if elsewhere:
            state.lose(named_axes(line, relative=True) or 'XYZ')
            self._say('motion to a place of the machine (G28, G30, G53, G75, SUPA, probing)')
            return (Role.RAPID if state.motion == 0 else Role.KEPT), None
        if not moves or gone:
            return (Role.SEALED if gone else Role.PLAIN), None
        if state.motion in (52, 62):
            return self._begin_curve(line)
        return self._move(line)

    def _shared(self, codes: list[int], line: Line) -> Role | None:
        """Heed a cycle whose G word is a unit elsewhere; None where it is none."""
        letters = {word.letter for word in line.words} | line.assigned.keys()
        meaning = modal.shared_meaning(codes, letters)
        if not meaning:
            return None
        name = f'G{next(code for code in codes if code in modal.SHARED) / 10:g}'
        if meaning == 'home':
            self._say(f'{name} HP=: motion to a place of the machine; {_LOST}')
            self.state.lose()
            return Role.RAPID if self.state.motion == 0 else Role.KEPT
        if meaning == 'turning':
            self.lose(f'turning cycle ({name}): {_LOST}, the feed until F')
        else:
            self._set_feed(line)
            self._say(f'pattern of holes or pocket ({name}), which keeps its feed: {_LOST}')
            self.state.lose()
        return Role.SEALED

    def _move(self, line: Line) -> tuple[Role, Segment | None]:
        state = self.state
        if line.polar:
            line = _cartesian(line, state)
        if state.motion == -1 and not state.modal_call and runs_cycle(line, state):
            self._say(
                'fixed cycle: keeps its feed'
                if run_cycle(line, state)
                else f'a position at which a cycle runs: {_LOST}'
            )
            return Role.SEALED, None
        try:
            segment = move(line, self._line, state)
        except UnreadableError as reason:
            state.kind = ''
            self._say(f'{reason}: passed through with its own feed')
            if state.motion == 0 and not state.modal_call:
                return Role.RAPID, None
            sealed = state.motion == -1 or state.motion in modal.THREADS or state.modal_call
            return (Role.SEALED if sealed else Role.KEPT), None
        if segment is None:
            if state.motion in (0, 10) and _names(line, 'E'):  # filament alone
                state.kind = ''
                return (Role.RAPID if state.motion == 0 else Role.KEPT), None
            return Role.PLAIN, None
        if isinstance(segment, UnplacedSegment):
            self._say(f'{NO_PLACE}: passed through with its own feed')
            return (Role.RAPID if segment.rapid else Role.KEPT), segment
        if segment.rapid:
            return Role.RAPID, segment
        if isinstance(segment, ArcSegment) and segment.misfit > ABSOLUTE_MISFIT:
            self._say(
                'an arc whose start and end are not equally far from its centre: its radius '
                'changes along the way, as LinuxCNC runs it'
            )
        if segment.turning:
            self._say('motion of other axes than X, Y and Z: keeps its feed')
        if segment.turning or segment.feed is None:
            return Role.KEPT, segment
        return (Role.FEED if segment.schedulable else Role.PLAIN), segment

    def _begin_curve(self, line: Line) -> tuple[Role, Segment | None]:
        state = self.state
        if not any(
            word.letter in 'XYZKP' or (word.letter == 'G' and word.value in (5.2, 6.2))
            for word in line.words
        ):
            return Role.PLAIN, None
        kind = PlaneCurveBlock if state.motion == 52 else KnotCurveBlock
        self._curve = kind(self._line, state)
        return Role.PLAIN, None

    def _names(self, line: Line) -> Role | None:
        """Heed identifiers and calls; return the role of a line that they decide alone."""
        state = self.state
        names = set(line.names)
        if 'MCALL' in names:
            state.modal_call = bool(line.calls)
            state.kind = ''
            self._say('modal call of a cycle (MCALL): passed through')
            return Role.SEALED
        for name in names & modal.DIAMETER_NAMES.keys():
            state.x_share = modal.DIAMETER_NAMES[name]
        frames = (names | set(line.calls)) & modal.FRAME_NAMES
        if frames:
            state.lose()
            if frames & modal.TRANSFORM_ENDS:
                state.transform = ''
            state.transform = min(frames & modal.TRANSFORM_NAMES, default=state.transform)
            self._say(f'{min(frames)}: new coordinates; {_LOST}')
            return Role.PLAIN
        calls = [call for call in line.calls if call not in modal.SILENT_CALLS]
        unknown = names - modal.SILENT_NAMES - modal.MACHINE_NAMES - modal.DIAMETER_NAMES.keys()
        for name in sorted((names & modal.SILENT_NAMES) | (set(line.calls) - set(calls))):
            self._say(f'{name}: passed through')
        if calls and all(call.startswith('CYCLE') for call in calls):
            self._say(f'{calls[0]}: passed through; {_LOST}')
            state.lose()
            return Role.SEALED
        if calls or unknown or line.strange:
            what = next(iter((*calls, *sorted(unknown))), 'signs')
            self.lose(f'unknown text ({what}): passed through; {_LOST}, the feed until F')
            self.parameters.forget(everything=True)
            return Role.SEALED
        return None

    def _set_feed(self, line: Line) -> None:
        state = self.state
        for letter, value, _, _ in line.words:
            if letter == 'F' and state.feed_mode == 94:
                if state.motion in modal.THREADS:
                    state.lose_feed()
                elif value is None:
                    self._say('computed feed: kept')
                    state.lose_feed()
                elif value != 0.0 and not least_feed(state.feed_unit) <= value <= _FASTEST:
                    found = f'F{value:g}'
                    raise ProgramError(
                        self._line,
                        f'expected a feed above 0 but found {found}'
                        if value < 0.0
                        else f'expected a feed from {least_feed(state.feed_unit):g} to '
                        f'{_FASTEST:g} but found {found}; of no machine',
                    )
                else:
                    state.feed, state.feed_known = value * state.feed_unit, True
                    if 0.0 < state.feed < _SLOWEST:
                        self._say('feed below 1 mm/min: if it is one per revolution, say G95')

    def _machine(self, numbers: list[float | None]) -> None:
        if not modal.PRINTER_M.isdisjoint(numbers):
            self.state.printer = True
        if not modal.FRAME_M.isdisjoint(numbers):
            self.state.lose()
            self._say(f'M128 or M129: new coordinates; {_LOST}')
        if not (modal.MOVING_M | modal.SHIFTING_M).isdisjoint(numbers):
            self.state.lose()
            self._say(f'motion or shift by M: {_LOST}')
        if any(number in modal.STOPS for number in numbers):
            self.state.kind = ''
        if any(number in modal.ENDS for number in numbers):
            self.state.ended = True
        if any(number in (70.0, 73.0) for number in numbers):
            self._saved[-1] = (self.state.saved(), 73.0 in numbers)
        elif 71.0 in numbers:
            self._saved[-1] = None
        elif 72.0 in numbers and self._saved[-1] is not None:
            self._restore(self._saved[-1][0])

    def _restore(self, modes: dict[str, object]) -> None:
        self.state.restore(modes)
        self._say('M72 or M73 restores the feed: unknown until F')

    def _called(self, line: Line) -> bool:
        """Return True if the line is a Siemens call of a subprogram, `L100`."""
        letters = {word.letter for word in line.words}
        return 'L' in letters and not letters & _CALL_LETTERS and self.state.motion != 52

    def _say(self, text: str) -> None:
        self.notes.add(self._line, text)


def _names(line: Line, letter: str) -> bool:
    return any(word.letter == letter for word in line.words)


_LOST = 'the position of the tool is unknown until all axes are named'


def _axes(line: Line) -> bool:
    """Return True if a line names an axis."""
    return any(word.letter in 'XYZABCUVW' for word in line.words)


def _limits_spindle(line: Line) -> bool:
    """Return True if a line with G50 or G92 concerns the spindle speed alone."""
    return _names(line, 'S') and not _axes(line)


def _is_box(line: Line) -> bool:
    """Return True if G90, G92 or G94 of a lathe is a cycle: with an axis, without a motion."""
    moves = any(word.letter == 'G' and word.value in (0.0, 1.0, 2.0, 3.0) for word in line.words)
    return not moves and bool(named_axes(line, relative=True))


class _GWords:
    """Takes G words, as numbers in tenths: 53 is G5.3, below 0 is one that is computed.

    Parameters
    ----------
    state : ModalState
        Modal state that they change.
    say : callable
        Told what is passed through.
    """

    def __init__(self, state: modal.ModalState, say: Callable[[str], None]) -> None:
        self._state = state
        self._say = say

    def take(self, code: int, line: Line) -> str:
        """Heed a G word; return what it does to the line, empty for nothing special."""
        state = self._state
        if code in modal.MOTION:
            state.motion = code
            state.cycle = None
        elif code in modal.THREADS:
            self._thread(code, line)
        elif state.lathe and code in modal.BOXES and _is_box(line):
            begin_cycle(code, state)
            state.motion = -1
        elif state.lathe and code in (980, 990):
            self._feed_mode(94 if code == 980 else 95)
        elif code in modal.PLANE:
            state.plane = modal.PLANE[code]
        elif code in modal.LENGTH_UNIT:
            state.length_unit = modal.LENGTH_UNIT[code]
            if code in modal.FEED_UNITS:
                state.unit_said = True
                state.feed_unit = state.length_unit / modal.MINUTE
        elif code in modal.DIAMETER:
            state.x_share = modal.DIAMETER[code]
        elif code in (900, 910):
            state.absolute = code == 900
        elif code in (901, 911):
            state.centre_absolute = code == 901
        elif code in (930, 940, 950):
            self._feed_mode(code // 10)
        elif code == 40:
            return 'dwell'
        elif code in modal.CYCLES:
            begin_cycle(code, state)
            state.motion = -1
        elif code in modal.ELSEWHERE:
            return 'elsewhere'
        elif code in modal.CALLS:
            return 'call'
        elif code == 100 and state.printer and not any(w.letter in 'LXYZ' for w in line.words):
            self._say('G10 of a printer: passed through')
        elif code == 500 and _limits_spindle(line):
            self._say('limit of the spindle (G50 S): passed through')
        elif code == 920 or (code == 500 and state.lathe and named_axes(line, relative=True)):
            self._set_place(line)
            return 'shift'
        elif code in modal.FRAMES:
            state.lose()
            self._say(f'G{code / 10:g}: new coordinates; {_LOST}')
            return 'shift'
        elif code in modal.TRANSFORMED or code in modal.CYLINDERS:
            return self._bend(code, line)
        elif code in modal.TRANSFORMED.values():
            self._set_transform('', code)
            return 'shift'
        else:
            return self._other_code(code, line)
        return ''

    def _other_code(self, code: int, line: Line) -> str:
        """Heed a G word that moves nothing by itself."""
        state = self._state
        if code in modal.OFFSETS and not (1100 <= code < 1300 and named_axes(line)):
            number = next((word.value for word in line.words if word.letter == 'P'), None)
            offset = (code, number if code in (541, 1540) else None)
            if state.offset not in (None, offset):
                state.lose()
                self._say(f'change of the work offset: {_LOST}')
            state.offset = offset
        elif code in modal.PIVOTS or (code == 490 and state.pivot):
            state.pivot = state.tool_length = code != 490
            state.lose()
            self._say(f'G{code / 10:g}: coordinates of the tip of the tool; {_LOST}')
        elif code in modal.TOOL_LENGTHS or (code == 490 and state.tool_length):
            state.tool_length = code != 490
            state.lose('Z')
            self._say('change of the tool length: the position of Z is unknown until it is named')
        elif code in modal.CUTTER:
            state.cutter = True
            self._say(f'cutter compensation (G{code / 10:g}): the path is the programmed one')
        elif code == 400:
            state.cutter = False
        elif code in modal.EXACT:
            state.rounding = 0.0
        elif code in modal.ROUNDS:
            self._round_corners(code, line)
        elif code in (980, 990):
            state.retracts = code == 990
        elif code in (160, 150):
            state.polar = code == 160
        elif code == 800:
            state.motion = None if state.motion == -1 else state.motion
            state.cycle = None
        elif code not in modal.HARMLESS:
            self._say(
                f'unknown word G{code / 10:g}: passed through' if code >= 0 else 'computed G'
            )
            if code < 0 or named_axes(line):
                state.lose()
                return 'gone'
        return ''

    def _round_corners(self, code: int, line: Line) -> None:
        """G64: corners may be rounded off, by as much as P says."""
        most = next((word.value for word in line.words if word.letter == 'P'), 0.0)
        self._state.rounding = most * self._state.length_unit if code == 640 and most else None
        if self._state.rounding is None:
            self._say(
                f'G{code / 10:g} does not say how far corners are rounded off; unless that is '
                'given, they are stopped at'
            )

    def _thread(self, code: int, line: Line) -> None:
        """Begin a thread."""
        state = self._state
        state.motion, state.cycle = code, None
        if _names(line, 'F'):
            state.lose_feed()
        self._say(f'threading (G{code / 10:g}): keeps its pitch; the feed is unknown until F')

    def _bend(self, code: int, line: Line) -> str:
        """Begin polar or cylindrical coordinates; words beside them are no motion."""
        name = f'G{code / 10:g}'
        if code in modal.CYLINDERS:
            size = [word.value for word in line.words if word.letter in 'CRXYA']
            self._set_transform(name if any(value != 0.0 for value in size) else '', code)
        elif code == 1120 and named_axes(line):  # a pole of Siemens
            self._say(f'unknown word {name}: passed through')
            self._state.lose()
            return 'gone'
        else:
            self._set_transform(name, code)
        return 'shift'

    def _set_transform(self, name: str, code: int) -> None:
        self._state.transform = name
        self._state.lose()
        self._say(f'G{code / 10:g}: new coordinates; {_LOST}')

    def _set_place(self, line: Line) -> None:
        """G92, or G50 of lathes: the tool stands where the words say, from now on."""
        state = self._state
        if _limits_spindle(line) or (state.printer and _names(line, 'E') and not _axes(line)):
            self._say('G92 without an axis (limit of the spindle, extruder): passed through')
            return
        state.kind = ''
        self._say('G92: new coordinates' if not state.lathe else 'G50: new coordinates')
        for letter, value, _, _ in line.words:
            if state.lathe and letter in 'UVW':
                if value is None:
                    state.lose('XYZ'['UVW'.index(letter)])
                else:
                    axis = 'UVW'.index(letter)
                    state.position[axis] += state.length(axis, value, False)
                continue
            if letter in 'XYZ':
                if value is None:
                    state.lose(letter)
                else:
                    axis = 'XYZ'.index(letter)
                    state.position[axis] = state.length(axis, value, True)
                    state.assumed.discard(letter)
            elif letter in 'ABCUVW':
                state.others.pop(letter, None)
                if value is not None:
                    state.others[letter] = value

    def _feed_mode(self, mode: int) -> None:
        state = self._state
        if mode != state.feed_mode:
            state.feed, state.feed_known, state.feed_mode = None, True, mode
        if mode != 94:
            self._say(f'G{mode}: the feed is no length per time and is kept')

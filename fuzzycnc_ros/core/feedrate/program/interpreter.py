# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Line by line: what each one means, with the modal state of all before it."""

from dataclasses import replace

from fuzzycnc_ros.core.feedrate.program import modal
from fuzzycnc_ros.core.feedrate.program.blocks import Block, Note, Role
from fuzzycnc_ros.core.feedrate.program.curve_blocks import (
    CurveBlock,
    KnotCurveBlock,
    PlaneCurveBlock,
)
from fuzzycnc_ros.core.feedrate.program.lexer import Line, ProgramError, read_line
from fuzzycnc_ros.core.feedrate.program.motion import UnreadableError, dwell, move, named_axes
from fuzzycnc_ros.core.feedrate.program.segments import NurbsSegment, Segment

_LOST = 'where the tool stands is unknown until all axes are named'
_CALL_LETTERS = frozenset('XYZABCUVWG')
_CURVE_LETTERS = frozenset('GNFXYZPLKRABCUVW')
_CALLS = frozenset({650, 660, 661})
_CALL_M = frozenset({97, 98, 99})


class Interpreter:
    """Reads a program line by line in bounded memory.

    Parameters
    ----------
    length_unit : float
        What a length of 1 is before the program says G20 or G21 [m].
    """

    def __init__(self, length_unit: float = modal.MILLIMETRE) -> None:
        self._state = modal.State(length_unit)
        self._curve: CurveBlock | None = None
        self._held: list[Block] = []
        self._note: dict[str, tuple[int, int]] = {}
        self._line = 0

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was passed through so far, in the order in which it was met first."""
        return tuple(Note(line, count, text) for text, (line, count) in self._note.items())

    def read(self, text: str) -> list[Block]:
        """Read the next line.

        Parameters
        ----------
        text : str
            The line with its ending.

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
        self._line += 1
        if self._state.ended:
            return [self._block(text, Line(), Role.PLAIN, None)]
        line = read_line(text, self._line)
        if self._curve is None:
            return self._open(text, line)
        return self._continue(text, line, self._curve)

    def close(self) -> list[Block]:
        """End the program, and return what was held back.

        Raises
        ------
        ProgramError
            If a curve is not complete.
        """
        return self._finish() if self._curve else []

    def _open(self, text: str, line: Line) -> list[Block]:
        role, segment = self._meaning(line)
        if line.optional:
            self._state.kind = ''
            if role in (Role.FEED, Role.KEPT):
                role = Role.SEALED
                segment = None if segment is None else replace(segment, feed=None)
        block = self._block(text, line, role, segment)
        if self._curve is None:
            return [block]
        self._held = [block]
        return self._finish() if self._curve.take(line.words, self._line) else []

    def _continue(self, text: str, line: Line, curve: CurveBlock) -> list[Block]:
        code = [round(10.0 * (word.value or 0.0)) for word in line.words if word.letter == 'G']
        if code and code != [self._state.motion]:
            done = self._finish()
            if code in ([53], [63]):
                self._state.motion = None
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
        curve, held, state = self._curve, self._held, self._state
        assert curve is not None
        self._curve, self._held = None, []
        shape = curve.close()
        first, last = shape.control[0].tolist(), shape.control[-1].tolist()
        state.position = last
        kept = state.feed is None or held[0].optional or any(block.word for block in held[1:])
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
        state = self._state
        word = None
        for letter, value, start, end in line.words:
            if letter == 'F' and value is not None and state.feed_mode == 94:
                word = (start, end)
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
        )

    def _meaning(self, line: Line) -> tuple[Role, Segment | None]:
        state = self._state
        if line.percent:
            state.percents += 1
            state.ended = state.percents > 1
            return Role.PLAIN, None
        if line.optional:
            self._say('block that may be skipped (/): taken as run, with its own feed')
            state.kind = ''
        if not modal.DECLARATIONS.isdisjoint(line.names):
            self._say('declaration: passed through')
            return Role.PLAIN, None
        codes, ms = [], []
        for letter, value, _, _ in line.words:
            if letter == 'G':
                codes.append(-1 if value is None else round(10.0 * value))
            elif letter == 'M':
                ms.append(value)
        elsewhere, feed_unit = 'SUPA' in line.names, state.feed_unit
        moves, gone = True, False
        for code in codes:
            kind = self._code(code, line)
            elsewhere = elsewhere or kind == 'elsewhere'
            gone = gone or kind == 'gone'
            moves = moves and kind not in ('call', 'shift', 'dwell')
        if 40 not in codes:
            self._set_feed(line)
            if state.feed_unit != feed_unit and any(word.letter == 'F' for word in line.words):
                self._say('feed beside a change of units: taken in the new unit (LinuxCNC: old)')
        if ms:
            self._machine(ms)
        if line.names or line.calls or line.strange:
            role = self._names(line)
            if role is not None:
                return role, None
        if 40 in codes:
            return Role.PLAIN, dwell(line, self._line, state)
        if _CALLS & set(codes) or (ms and _CALL_M & set(ms)) or self._called(line):
            self._say('call of a subprogram: ' + _LOST + ', the feed until F')
            state.lose()
            state.lose_feed()
            return Role.SEALED, None
        if elsewhere:
            state.lose(named_axes(line) or 'XYZ')
            self._say('motion to a place of the machine (G28, G30, G53, G75, SUPA, probing)')
            return (Role.RAPID if state.motion == 0 else Role.KEPT), None
        if not moves or gone:
            return (Role.SEALED if gone else Role.PLAIN), None
        if state.motion in (52, 62):
            return self._begin_curve(line)
        return self._move(line)

    def _move(self, line: Line) -> tuple[Role, Segment | None]:
        state = self._state
        try:
            segment = move(line, self._line, state)
        except UnreadableError as reason:
            state.kind = ''
            self._say(f'{reason}: passed through with its own feed')
            if state.motion == 0 and not state.modal_call:
                return Role.RAPID, None
            return (Role.SEALED if state.motion == -1 or state.modal_call else Role.KEPT), None
        if segment is None:
            return Role.PLAIN, None
        if segment.rapid:
            return Role.RAPID, segment
        if segment.turning:
            self._say('motion of other axes than X, Y and Z: keeps its feed')
        if segment.turning or segment.feed is None:
            return Role.KEPT, segment
        return (Role.FEED if segment.schedulable else Role.PLAIN), segment

    def _begin_curve(self, line: Line) -> tuple[Role, Segment | None]:
        state = self._state
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
        state = self._state
        names = set(line.names)
        if 'MCALL' in names:
            state.modal_call = bool(line.calls)
            state.kind = ''
            self._say('modal call of a cycle (MCALL): passed through')
            return Role.SEALED
        if names & modal.FRAME_NAMES:
            state.lose()
            self._say(f'{sorted(names & modal.FRAME_NAMES)[0]}: new coordinates; {_LOST}')
            return Role.PLAIN
        calls = [call for call in line.calls if call not in modal.SILENT_CALLS]
        unknown = names - modal.SILENT_NAMES - modal.MACHINE_NAMES
        for name in sorted((names & modal.SILENT_NAMES) | (set(line.calls) - set(calls))):
            self._say(f'{name}: passed through')
        if calls and all(call.startswith('CYCLE') for call in calls):
            self._say(f'{calls[0]}: passed through; {_LOST}')
            state.lose()
            return Role.SEALED
        if calls or unknown or line.strange:
            what = next(iter((*calls, *sorted(unknown))), 'signs')
            self._say(f'unknown text ({what}): passed through; {_LOST}, the feed until F')
            state.lose()
            state.lose_feed()
            return Role.SEALED
        return None

    def _code(self, code: int, line: Line) -> str:
        """Heed a G word; return what it does to the line, empty for nothing special."""
        state = self._state
        if code in modal.MOTION:
            state.motion = code
        elif code in modal.PLANE:
            state.plane = modal.PLANE[code]
        elif code in modal.LENGTH_UNIT:
            state.length_unit = modal.LENGTH_UNIT[code]
            if code in modal.FEED_UNITS:
                state.feed_unit = state.length_unit / modal.MINUTE
        elif code in (900, 910):
            state.absolute = code == 900
        elif code in (901, 911):
            state.centre_absolute = code == 901
        elif code in (930, 940, 950):
            self._feed_mode(code // 10)
        elif code == 40:
            return 'dwell'
        elif code in modal.CYCLES:
            state.motion = -1
        elif code in modal.ELSEWHERE:
            return 'elsewhere'
        elif code in _CALLS:
            return 'call'
        elif code in modal.FRAMES:
            state.lose()
            self._say(f'G{code / 10:g}: new coordinates; {_LOST}')
            return 'shift'
        elif code == 920:
            self._set_place(line)
            return 'shift'
        else:
            return self._other_code(code, line)
        return ''

    def _other_code(self, code: int, line: Line) -> str:
        """Heed a G word that moves nothing by itself."""
        state = self._state
        if code in modal.OFFSETS:
            if state.offset not in (None, code):
                state.lose()
                self._say(f'change of the work offset: {_LOST}')
            state.offset = code
        elif code in modal.TOOL_LENGTHS or (code == 490 and state.tool_length):
            state.tool_length = code != 490
            state.lose('Z')
            self._say('change of the tool length: where Z stands is unknown until it is named')
        elif code in modal.CUTTER:
            self._say(f'cutter compensation (G{code / 10:g}): the path is the programmed one')
        elif code in (160, 150):
            state.polar = code == 160
        elif code == 800:
            state.motion = None if state.motion == -1 else state.motion
        elif code not in modal.HARMLESS:
            self._say(
                f'unknown word G{code / 10:g}: passed through' if code >= 0 else 'computed G'
            )
            if code < 0 or named_axes(line):
                state.lose()
                return 'gone'
        return ''

    def _set_place(self, line: Line) -> None:
        """G92: the tool stands where the words say, from now on."""
        state = self._state
        state.kind = ''
        self._say('G92: new coordinates')
        for letter, value, _, _ in line.words:
            if letter in 'XYZ':
                if value is None:
                    state.lose(letter)
                else:
                    state.position['XYZ'.index(letter)] = value * state.length_unit
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

    def _set_feed(self, line: Line) -> None:
        state = self._state
        for letter, value, _, _ in line.words:
            if letter == 'F' and state.feed_mode == 94:
                if value is None:
                    self._say('computed feed: kept')
                    state.lose_feed()
                elif value < 0.0:
                    raise ProgramError(self._line, f'expected a feed above 0 but found F{value:g}')
                else:
                    state.feed, state.feed_known = value * state.feed_unit, True

    def _machine(self, numbers: list[float | None]) -> None:
        if any(number in modal.STOPS for number in numbers):
            self._state.kind = ''
        if any(number in modal.ENDS for number in numbers):
            self._state.ended = True

    def _called(self, line: Line) -> bool:
        """Whether the line is a Siemens call of a subprogram, `L100`."""
        letters = {word.letter for word in line.words}
        return 'L' in letters and not letters & _CALL_LETTERS and self._state.motion != 52

    def _say(self, text: str) -> None:
        line, count = self._note.get(text, (self._line, 0))
        self._note[text] = (line, count + 1)

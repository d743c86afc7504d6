# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Line by line: what each one means, with the modal state of all before it."""

from dataclasses import replace

from fuzzycnc_ros.core.feedrate.program import cycles, modal, polar
from fuzzycnc_ros.core.feedrate.program.blocks import Block, Role
from fuzzycnc_ros.core.feedrate.program.curve_blocks import (
    CurveBlock,
    KnotCurveBlock,
    PlaneCurveBlock,
)
from fuzzycnc_ros.core.feedrate.program.expressions import Expression, ExpressionError
from fuzzycnc_ros.core.feedrate.program.g_words import LOST, GWords
from fuzzycnc_ros.core.feedrate.program.lexer import Line, ProgramError, resolved
from fuzzycnc_ros.core.feedrate.program.motion import UnreadableError, dwell, move, named_axes
from fuzzycnc_ros.core.feedrate.program.notes import Notes
from fuzzycnc_ros.core.feedrate.program.parameters import Parameters
from fuzzycnc_ros.core.feedrate.program.segments import NurbsSegment, Segment

_CALL_LETTERS = frozenset('XYZABCUVWG')
_CURVE_LETTERS = frozenset('GNFXYZPLKRABCUVW')
_CALL_M = frozenset({97, 98, 99})


class Interpreter:
    """Reads a program line by line in bounded memory.

    Parameters
    ----------
    length_unit : float
        What a length of 1 is before the program says G20 or G21 [m].

    Attributes
    ----------
    state : State
        Modal state after the last line.
    parameters : Parameters
        Values that the program has set.
    notes : Notes
        What was passed through so far.
    followed : bool
        The lines belong to a part whose order O-words or calls decide.
    """

    def __init__(self, length_unit: float = modal.MILLIMETRE) -> None:
        self.state = modal.State(length_unit)
        self._curve: CurveBlock | None = None
        self._held: list[Block] = []
        self._saved: list[tuple[dict[str, object], bool] | None] = [None]
        self._line = 0
        self.notes = Notes()
        self.parameters = Parameters(self.state)
        self.followed = False
        self._words = GWords(self.state, self._say)

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
        self.lose(f'call of {name or "a subroutine"}, which is not here: {LOST}, the feed until F')
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
        role, segment = self._meaning(line)
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
            followed=self.followed,
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
            self._say(f'command to the control ($): kept; {LOST}')
            state.lose()
            return Role.PLAIN, None
        if line.flow is not None:
            self.lose(f'O-words are not followed here: {LOST}, the feed until F')
            self.parameters.forget(everything=True)
            return Role.SEALED, None
        if not modal.DECLARATIONS.isdisjoint(line.names):
            self._say('declaration: passed through')
            return Role.PLAIN, None
        codes, ms = [], []
        for letter, value, _, _ in line.words:
            if letter == 'G':
                codes.append(-1 if value is None else round(10.0 * value))
            elif letter == 'M':
                ms.append(value)
        if codes and not modal.LATHE_CYCLES.isdisjoint(codes) and _names(line, 'Q'):
            self.lose(f'turning cycle (G70 to G72): {LOST}, the feed until F')
            return Role.SEALED, None
        elsewhere, feed_unit = 'SUPA' in line.names, state.feed_unit
        moves, gone = True, False
        for code in codes:
            kind = self._words.take(code, line)
            elsewhere = elsewhere or kind == 'elsewhere'
            gone = gone or kind == 'gone'
            moves = moves and kind not in ('call', 'shift', 'dwell')
        if 40 not in codes:
            self._set_feed(line)
            if state.feed_unit != feed_unit and _names(line, 'F'):
                self._say('feed beside a change of units: taken in the new unit (LinuxCNC: old)')
        if ms:
            self._machine(ms)
        if line.names or line.calls or line.strange:
            role = self._names(line)
            if role is not None:
                return role, None
        if 40 in codes:
            return Role.PLAIN, dwell(line, self._line, state)
        if modal.CALLS & set(codes) or (ms and _CALL_M & set(ms)) or self._called(line):
            self.lose(f'call of a subprogram: {LOST}, the feed until F')
            self.parameters.forget()
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
        state = self.state
        if line.polar:
            line = polar.cartesian(line, state)
        if state.motion == -1 and not state.modal_call and cycles.runs(line, state):
            self._say(
                'fixed cycle: keeps its feed'
                if cycles.run(line, state)
                else f'a position at which a cycle runs: {LOST}'
            )
            return Role.SEALED, None
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
        if names & modal.FRAME_NAMES:
            state.lose()
            self._say(f'{sorted(names & modal.FRAME_NAMES)[0]}: new coordinates; {LOST}')
            return Role.PLAIN
        calls = [call for call in line.calls if call not in modal.SILENT_CALLS]
        unknown = names - modal.SILENT_NAMES - modal.MACHINE_NAMES
        for name in sorted((names & modal.SILENT_NAMES) | (set(line.calls) - set(calls))):
            self._say(f'{name}: passed through')
        if calls and all(call.startswith('CYCLE') for call in calls):
            self._say(f'{calls[0]}: passed through; {LOST}')
            state.lose()
            return Role.SEALED
        if calls or unknown or line.strange:
            what = next(iter((*calls, *sorted(unknown))), 'signs')
            self.lose(f'unknown text ({what}): passed through; {LOST}, the feed until F')
            self.parameters.forget(everything=True)
            return Role.SEALED
        return None

    def _set_feed(self, line: Line) -> None:
        state = self.state
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
        """Whether the line is a Siemens call of a subprogram, `L100`."""
        letters = {word.letter for word in line.words}
        return 'L' in letters and not letters & _CALL_LETTERS and self.state.motion != 52

    def _say(self, text: str) -> None:
        self.notes.add(self._line, text)


def _names(line: Line, letter: str) -> bool:
    return any(word.letter == letter for word in line.words)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Read part programs, and run what O-words and calls steer, line by line as a controller does."""

import re
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import chain, islice

from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Note, Program, Role
from fuzzycnc_ros.core.feedrate.gcode.expressions import Expression
from fuzzycnc_ros.core.feedrate.gcode.interpreter import Interpreter
from fuzzycnc_ros.core.feedrate.gcode.lexer import FlowWord, Line, read_line, says
from fuzzycnc_ros.core.feedrate.gcode.modal import INCH, MILLIMETRE
from fuzzycnc_ros.core.feedrate.gcode.outline import Outline, outline_of
from fuzzycnc_ros.core.feedrate.gcode.parameters import ARGUMENTS
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError

_O_WORD = re.compile(r'[ \t/]*(?:N[ \t]*\d+[ \t]*)?O[ \t]*[\d<#\[]', re.IGNORECASE | re.ASCII)
_OPENERS = {
    'if': ('endif',),
    'while': ('endwhile',),
    'do': ('while',),
    'repeat': ('endrepeat',),
}
_KEPT = 20_000  # lines that are kept as read

_MAIN = ''
"""Name of what is in no subroutine."""


class _Listing:
    """The lines of a program or of a subroutine's file, from a line on to the end.

    Parameters
    ----------
    lines : list of str
        Lines with their endings.
    first : int
        Number of the first one.
    label : str
        What it is called in messages; empty for the program itself.

    Attributes
    ----------
    flow : dict
        Index of each line with an O-word, and the word.
    """

    def __init__(self, lines: list[str], first: int = 1, label: str = '') -> None:
        self.lines = lines
        self.first = first
        self.label = label
        self.flow: dict[int, FlowWord] = {}
        self._read: dict[int, Line] = {}
        self._scope: dict[int, str] = {}
        self._place: dict[tuple[str, str], list[int]] = {}
        self._start: dict[str, int] = {}
        self._end: dict[str, int] = {}
        self._number: dict[str, int] = {}
        self._scan()
        self._closing = {self._next(index, ('while',)) for index in self._all('do')}
        self._spans = [
            (index, end)
            for index, word in self.flow.items()
            if self._scope[index] == _MAIN and word.kind in _OPENERS
            and index not in self._closing
            and (end := self.next(index, _OPENERS[word.kind])) is not None
        ]  # fmt: skip

    def __len__(self) -> int:
        """Return the number of lines."""
        return len(self.lines)

    def line(self, index: int) -> Line:
        """Return what a line says; those of loops are not read anew."""
        found = self._read.get(index)
        if found is None:
            found = read_line(self.lines[index], self.first + index)
            if len(self._read) < _KEPT:
                self._read[index] = found
        return found

    def subroutine(self, name: str) -> int | None:
        """Return the index of `oNAME sub`, None if there is none."""
        return self._start.get(name)

    def end(self, name: str) -> int:
        """Return the index of `oNAME endsub`, or the last line."""
        return self._end.get(name, len(self.lines) - 1)

    def labelled(self, name: str) -> int | None:
        """Return the index of a lone `O100`, where a subroutine of M98 begins."""
        return self._number.get(name)

    def closes(self, index: int) -> bool:
        """Return True if a `while` closes a `do`."""
        return index in self._closing

    def next(self, index: int, kinds: tuple[str, ...]) -> int | None:
        """Return where the next O-word of the same name and one of the kinds stands."""
        return self._next(index, kinds)

    def before(self, index: int, kind: str) -> int | None:
        """Return where the last O-word of the same name and the kind stands before a line."""
        places = self._place[self._scope[index], str(self.flow[index].name)]
        found = [at for at in places if at < index and self.flow[at].kind == kind]
        return found[-1] if found else None

    def outermost(self, index: int) -> int:
        """Return where the outermost loop or branch begins that a line of the program is in."""
        return min((start for start, end in self._spans if start <= index <= end), default=index)

    def calls_after(self, index: int) -> bool:
        """Return True if a subroutine may be called from a line on."""
        return any(at >= index and word.kind == 'call' for at, word in self.flow.items()) or any(
            '98' in text for text in self.lines[index:]
        )

    def idle(self, index: int) -> int | None:
        """Return where a branch ends that does nothing but end the program or say something."""
        end = self.next(index, ('endif',))
        if end is None:
            return None
        for at in range(index + 1, end):
            word = self.flow.get(at)
            if word is not None:
                if word.kind not in ('if', 'elseif', 'else', 'endif'):
                    return None
                continue
            try:
                line = self.line(at)
            except ProgramError:
                return None
            ends = all(
                word.letter == 'N' or (word.letter == 'M' and word.value in (0.0, 1.0, 2.0, 30.0))
                for word in line.words
            )
            others = line.names or line.calls or line.settings or line.assigned
            if not ends or others or line.strange or line.percent or line.command:
                return None
        return end

    def _scan(self) -> None:
        scope = _MAIN
        for index, text in enumerate(self.lines):
            if not _O_WORD.match(text):
                continue
            try:
                line = self.line(index)
            except ProgramError:
                continue  # refused when it is run
            word = line.flow
            if word is None:
                self._label(line, index)
                continue
            if word.kind == 'sub' and isinstance(word.name, str) and scope == _MAIN:
                scope = word.name
                self._start.setdefault(scope, index)
            self.flow[index] = word
            self._scope[index] = scope
            self._place.setdefault((scope, str(word.name)), []).append(index)
            if word.kind == 'endsub' and word.name == scope:
                self._end.setdefault(scope, index)
                scope = _MAIN

    def _label(self, line: Line, index: int) -> None:
        words = [word for word in line.words if word.letter != 'N']
        if len(words) == 1 and words[0].letter == 'O' and words[0].value is not None:
            self._number.setdefault(str(round(words[0].value)), index)

    def _all(self, kind: str) -> list[int]:
        return [index for index, word in self.flow.items() if word.kind == kind]

    def _next(self, index: int, kinds: tuple[str, ...]) -> int | None:
        places = self._place[self._scope[index], str(self.flow[index].name)]
        return next((at for at in places if at > index and self.flow[at].kind in kinds), None)


LINES = 200_000
"""Lines that a steered part, or a file, has at most: they are held in memory."""

Files = Callable[[str], str | None]
"""Told the name of a subroutine; returns the text of its file, None where there is none."""


class _Subroutines:
    """Finds subroutines in the order of LinuxCNC: before the call, in a file, behind the call.

    Parameters
    ----------
    main : _Listing
        The program.
    files : callable or None
        Finds files.
    """

    def __init__(self, main: _Listing, files: Files | None) -> None:
        self._main = main
        self._files = files
        self._loaded: dict[str, _Listing | None] = {}

    def find(self, name: str, caller: _Listing, index: int) -> tuple[_Listing, int] | None:
        """Return where `oNAME sub` stands, called before a line of a text; None for nowhere."""
        own = caller.subroutine(name)
        if own is not None and own < index:
            return caller, own
        main = self._main.subroutine(name)
        if main is not None and caller is not self._main:
            return self._main, main
        listing = self._file(name)
        start = None if listing is None else listing.subroutine(name)
        if listing is not None and start is not None:
            return listing, start
        return None if own is None else (caller, own)

    def _file(self, name: str) -> _Listing | None:
        if name not in self._loaded:
            text = self._files(name) if self._files is not None and name else None
            lines = [] if text is None else text.splitlines(keepends=True)
            known = 0 < len(lines) <= LINES
            self._loaded[name] = _Listing(lines, label=f'{name}.ngc') if known else None
        return self._loaded[name]


PASSES = 200_000
"""Lines that are run at most."""

_DEPTH = 9
"""Subroutines that call each other at most, as in LinuxCNC."""


def _steers(line: Line) -> bool:
    """Return True if a line decides which one is run next."""
    return line.flow is not None or any(
        word.letter == 'M' and word.value == 98.0 for word in line.words
    )


class _AstrayError(Exception):
    """Nobody but the controller knows how the program goes on; the message says why."""


@dataclass(frozen=True, slots=True)
class _Frame:
    """Return address of a subroutine, and its remaining repetitions (M98 with L)."""

    listing: _Listing
    index: int
    name: str
    fanuc: bool
    start: int
    again: int


class _Follower:
    """Runs the rest of a program.

    Parameters
    ----------
    interpreter : Interpreter
        With the state before it.
    lines : list of str
        All lines from the first one that steers.
    first : int
        Number of the first one.
    files : callable or None
        Finds subroutines that lie in files of their own.
    """

    def __init__(
        self, interpreter: Interpreter, lines: list[str], first: int, files: Files | None
    ) -> None:
        self._interpreter = interpreter
        self._listing = _Listing(lines, first)
        self._files = files

    def blocks(self) -> Iterator[Block]:
        """Yield a block for each line that is run, and then for those that are not.

        Notes
        -----
        The part is run twice.  Where the first run goes astray, everything from the outermost
        loop or branch of that place on stays as it is, and so do subroutines: they may be called
        from there with another feed in effect.
        """
        listing = self._listing
        trial = _Run(deepcopy(self._interpreter), listing, self._files)
        for _ in trial.blocks():
            pass
        astray = trial.astray
        stop = None if astray is None else listing.outermost(astray[0])
        sealed = stop is not None and listing.calls_after(stop)
        self._interpreter.followed = True
        run = _Run(self._interpreter, listing, self._files, stop, sealed)
        done = bytearray(len(listing))
        for block in run.blocks():
            if block.text:
                done[block.line - listing.first] = 1
            yield block
        if astray is not None and stop is not None:
            self._interpreter.notes.add(
                listing.first + stop,
                f'kept from here on with its own feeds, and subroutines: {astray[1]}',
            )
        for index, text in enumerate(listing.lines):
            if not done[index]:
                number = listing.first + index
                if (stop is None or index < stop) and says(text):
                    self._interpreter.notes.add(
                        number, 'not run: in a subroutine that nothing calls, or another branch'
                    )
                if index == stop:
                    yield self._interpreter.seal(text, number)
                else:
                    yield from self._interpreter.pass_by(text, number)
        yield from self._interpreter.close()


class _Run:
    """One run through the steered part, to its end or to a line of it.

    Attributes
    ----------
    astray : tuple of int and str, or None
        Index of the line of the program from which on it cannot be followed, and why.
    """

    def __init__(
        self,
        interpreter: Interpreter,
        listing: _Listing,
        files: Files | None,
        stop: int | None = None,
        sealed: bool = False,
    ) -> None:
        self._interpreter = interpreter
        self._main = self._listing = listing
        self._subroutines = _Subroutines(listing, files)
        self._stop = stop
        self._sealed = sealed
        self._frames: list[_Frame] = []
        self._repeats: dict[tuple[int, int], int] = {}
        self._index = 0
        self._line = Line()
        # LinuxCNC keeps a `break` out of while, and a `continue` in do, beyond its loop: so the
        # next loop of the other kind ends early, or begins once more.
        self._broken = self._continued = False
        self.astray: tuple[int, str] | None = None

    def blocks(self) -> Iterator[Block]:
        """Yield a block for each line that is run."""
        count = 0
        while not self._interpreter.state.ended:
            if not self._frames and self._index == self._stop:
                return
            at, listing = self._index, self._listing
            called = self._frames[0].index - 1 if self._frames else at
            try:
                count += 1
                if count > PASSES:
                    raise _AstrayError(f'it runs more than {PASSES:,} lines')
                if at >= len(listing):
                    if self._frames:
                        raise _AstrayError('a subroutine does not end')
                    return
                found = self._step(listing, at)
            except _AstrayError as reason:
                where = f' of {listing.label}' if listing.label else ''
                where = f'line {listing.first + min(at, len(listing) - 1)}{where}'
                self.astray = (called, f'{where}: {reason}')
                return
            except ProgramError as error:
                if not listing.label:
                    raise
                self.astray = (called, f'{listing.label}, {error}')
                return
            yield from self._shown(found, listing, called)

    def _shown(self, blocks: list[Block], listing: _Listing, called: int) -> list[Block]:
        """Return blocks as they count: those of files and sealed subroutines take no words."""
        if listing.label:
            number = self._main.first + called
            return [replace(_sealed(block), line=number, text='') for block in blocks]
        return [_sealed(one) for one in blocks] if self._sealed and self._frames else blocks

    def _step(self, listing: _Listing, at: int) -> list[Block]:
        """Run a line, and go to the next one."""
        text, number = listing.lines[at], listing.first + at
        word = listing.flow.get(at)
        line = self._line = listing.line(at)
        self._index = at + 1
        if word is None and not line.words:
            if line.percent and listing.label:
                return self._interpreter.pass_by(text, number, line)
            return self._interpreter.read(text, line, number)
        if word is not None:
            if line.optional or line.words[1:] or line.strange or line.names:
                raise _AstrayError('an O-word that may be skipped, or with other words')
            return self._steer(word, line, text, number)
        codes = [one.value for one in line.words if one.letter == 'M']
        if 98.0 in codes and not line.optional:
            return self._call_number(line, text, number)
        if 99.0 in codes and self._frames and self._frames[-1].fanuc:
            blocks = self._interpreter.pass_by(text, number, line)
            self._return((0.0, 0.0))
            return blocks
        return self._interpreter.read(text, line, number)

    def _steer(self, word: FlowWord, line: Line, text: str, number: int) -> list[Block]:
        if word.kind == 'call':
            return self._call(word, line, text, number)
        blocks = self._interpreter.pass_by(text, number, line)
        getattr(self, f'_on_{word.kind or "nothing"}')(word)
        return blocks

    # What each O-word does; the index is that of the line after it.

    def _on_nothing(self, word: FlowWord) -> None:
        raise _AstrayError('an O-word that says nothing that is known')

    def _on_sub(self, word: FlowWord) -> None:
        at = self._index - 1
        if self._frames and not self._frames[-1].fanuc and self._frames[-1].start == at:
            return
        self._index = self._listing.end(str(word.name)) + 1

    def _on_endsub(self, word: FlowWord) -> None:
        if not self._frames or self._frames[-1].fanuc:
            raise _AstrayError('an end of no subroutine')
        given = word.arguments[0] if word.arguments else None
        result = (0.0, 0.0) if given is None else (self._value(given), 1.0)
        self._return(result)

    _on_return = _on_endsub

    def _on_if(self, word: FlowWord) -> None:
        here = self._index - 1
        try:
            true = self._condition(word)
        except _AstrayError:
            end = self._listing.idle(here)
            if end is None:
                raise
            self._index = end + 1  # if it goes on at all, then from there
            return
        if not true:
            self._skip_branch(here)

    def _skip_branch(self, here: int) -> None:
        """Go to the branch that is taken instead."""
        found: int | None = here
        while True:
            assert found is not None
            found = self._listing.next(found, ('elseif', 'else', 'endif'))
            if found is None:
                raise _AstrayError('no endif follows')
            word = self._listing.flow[found]
            if word.kind != 'elseif' or self._condition(word):
                self._index = found + 1
                return

    def _on_else(self, word: FlowWord) -> None:
        self._index = self._end(self._index - 1, ('endif',)) + 1

    _on_elseif = _on_else

    def _on_endif(self, word: FlowWord) -> None:
        pass

    def _on_do(self, word: FlowWord) -> None:
        pass

    def _on_while(self, word: FlowWord) -> None:
        here = self._index - 1
        if not self._listing.closes(here):
            if not self._condition(word):
                self._leave(here, 'while')
            return
        if self._broken:
            self._broken = False
        elif self._condition(word):
            self._back(here, 'do')

    def _on_endwhile(self, word: FlowWord) -> None:
        self._back(self._index - 1, 'while', again=True)

    def _on_repeat(self, word: FlowWord) -> None:
        here = self._index - 1
        key = (id(self._listing), here)
        if key not in self._repeats:
            self._repeats[key] = int(self._condition_value(word) + 0.5)
        if self._repeats[key] > 0:
            self._repeats[key] -= 1
        else:
            del self._repeats[key]
            self._leave(here, 'repeat')

    def _on_endrepeat(self, word: FlowWord) -> None:
        self._back(self._index - 1, 'repeat', again=True)

    def _on_break(self, word: FlowWord) -> None:
        self._broken = True
        self._leave_loop()

    def _on_continue(self, word: FlowWord) -> None:
        self._continued = True
        self._leave_loop()

    def _leave_loop(self) -> None:
        """Skip to the end of a loop, which decides whether it goes on."""
        here = self._index - 1
        end = self._end(here, ('endwhile', 'while'))
        if self._listing.closes(end):
            self._index = end
        else:
            self._leave(here, 'while')

    def _leave(self, here: int, kind: str) -> None:
        """Go behind the end of a loop, or back to its begin where a `continue` waits for that."""
        end = self._end(here, (f'end{kind}',))
        self._index = end + 1
        if self._continued:
            self._continued = False
            self._back(end, kind, again=True)

    def _back(self, here: int, kind: str, again: bool = False) -> None:
        """Go back to the line that begins a loop, or behind it."""
        begin = self._listing.before(here, kind)
        if begin is None:
            raise _AstrayError(f'no {kind} stands before')
        self._index = begin + (not again)

    def _end(self, here: int, kinds: tuple[str, ...]) -> int:
        """Return where a loop or a branch ends; LinuxCNC heeds each `break` on the way there."""
        end = self._listing.next(here, kinds)
        if end is None:
            raise _AstrayError(f'no {kinds[0]} follows')
        passed = self._listing.next(here, ('break',))
        self._broken = self._broken or (passed is not None and passed < end)
        return end

    def _condition(self, word: FlowWord) -> bool:
        return self._condition_value(word) != 0.0

    def _condition_value(self, word: FlowWord) -> float:
        if not word.arguments:
            raise _AstrayError(f'expected a value in brackets after {word.kind}')
        value = self._value(word.arguments[0])
        if value is None:
            unknown = self._interpreter.parameters.unknown
            raise _AstrayError(
                f'{word.kind} depends on {unknown}, which only the controller knows'
            )
        return value

    def _value(self, expression: Expression) -> float | None:
        return self._interpreter.value(expression)

    # Subroutines

    def _call(self, word: FlowWord, line: Line, text: str, number: int) -> list[Block]:
        """Begin `o100 call`, or lose the way of the tool where nobody knows the subroutine."""
        name = word.name
        if not isinstance(name, str):
            value = self._value(name)
            name = '' if value is None else str(round(value))
        found = self._subroutines.find(name, self._listing, self._index)
        if found is None:
            self._interpreter.parameters.forget()
            return [self._interpreter.unknown_call(text, number, line, name)]
        blocks = self._interpreter.pass_by(text, number, line)
        arguments = [self._value(expression) for expression in word.arguments[:ARGUMENTS]]
        self._enter(*found, name, arguments)
        return blocks

    def _call_number(self, line: Line, text: str, number: int) -> list[Block]:
        """Begin M98 P100 L2."""
        value = {word.letter: word.value for word in line.words}
        program, repeats = value.get('P'), value.get('L', 1.0)
        if program is None and not line.computed:  # P"file" of RepRap
            return self._interpreter.read(text, line, number)
        if line.computed or program is None or repeats is None:
            raise _AstrayError('M98 with a computed number')
        start = self._main.labelled(str(round(program)))
        if start is None or self._listing is not self._main:
            return self._interpreter.read(text, line, number)
        others = {'G', 'X', 'Y', 'Z'} & value.keys()
        if others:
            raise _AstrayError('M98 with other words')
        blocks = self._interpreter.pass_by(text, number, line)
        if repeats > 0.0:
            self._enter(self._main, start, str(round(program)), None, again=round(repeats) - 1)
        return blocks

    def _enter(
        self,
        listing: _Listing,
        start: int,
        name: str,
        arguments: list[float | None] | None,
        again: int = 0,
    ) -> None:
        if listing.label:
            self._interpreter.notes.add(
                self._main.first + (self._frames[0].index if self._frames else self._index) - 1,
                f'{listing.label}: subroutine in a file of its own, keeps its feeds',
            )
        if len(self._frames) >= _DEPTH:
            raise _AstrayError(f'more than {_DEPTH} subroutines call each other')
        frame = _Frame(self._listing, self._index, name, arguments is None, start, again)
        self._frames.append(frame)
        self._interpreter.enter(arguments)
        self._listing, self._index = listing, start

    def _return(self, result: tuple[float | None, float]) -> None:
        frame = self._frames.pop()
        self._interpreter.leave(result)
        if frame.again:
            self._frames.append(replace(frame, again=frame.again - 1))
            self._interpreter.enter(None)
            self._index = frame.start
            return
        self._listing, self._index = frame.listing, frame.index


def _sealed(block: Block) -> Block:
    """Return a block that keeps its feed and takes no word."""
    segment = block.segment
    role = block.role
    if role is Role.RAPID and segment is not None:
        role = Role.PLAIN
    elif role is not Role.PLAIN:
        role = Role.SEALED
    if segment is not None and segment.schedulable:
        segment = replace(segment, feed=None)
    return replace(block, role=role, segment=segment)


_CONVERSATIONAL = re.compile(
    r'\ufeff?\s*((?:\d+\s+)?(?:BEGIN\s+PGM|BLK\s+FORM|TOOL\s+(?:CALL|DEF)|CYCL\s+DEF)\b.*'
    r'|%\w+\s+G7[01]\s*\*)',
    re.IGNORECASE,
)
_HEADER = 50
"""Lines in which another language is looked for behind others, such as `%` and comments."""
_LINE = re.compile(r'[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+')
_UNITS = {'mm': MILLIMETRE, 'inch': INCH}


class ProgramReader:
    r"""Reads a part program from any source of lines, in memory that does not grow with it.

    Parameters
    ----------
    units : {'mm', 'inch'}
        Unit before the program says G20 or G21.
    follow : bool
        O-words and M98 are run.
    files : callable, optional
        Told the name of a subroutine, returns the text of its file; None where there is none.
    outline : Outline, optional
        What `outline_of` found in the whole program; without it nothing is known of what follows.

    Examples
    --------
    >>> reader = ProgramReader()
    >>> for block in reader.blocks(['G0 X0 Y0 Z0\n', 'G1 X30 F600\n']):
    ...     print(block.line, block.role.name, block.segment.length)
    1 RAPID 0.0
    2 FEED 0.03
    """

    def __init__(
        self,
        units: str = 'mm',
        *,
        follow: bool = False,
        files: Files | None = None,
        outline: Outline | None = None,
    ) -> None:
        if units not in _UNITS:
            raise ValueError(f"expected units 'mm' or 'inch' but found {units!r}")
        self._interpreter = Interpreter(_UNITS[units], outline or Outline())
        self._follow = follow
        self._files = files

    @property
    def notes(self) -> tuple[Note, ...]:
        """Notes on lines passed through so far."""
        return self._interpreter.notes.all()

    def blocks(self, lines: Iterable[str]) -> Iterator[Block]:
        """Yield the blocks of a program.

        Parameters
        ----------
        lines : iterable of str
            Lines with their endings, as a file opened with `newline=''` yields them.

        Yields
        ------
        Block
            One per line, in order; from the first O-word on one for each time that a line is run,
            and at last the lines that are not.  The lines of a NURBS block come together at its
            end.

        Raises
        ------
        ProgramError
            At the first line that says something impossible, and if no line says anything.
        """
        interpreter, follow, source = self._interpreter, self._follow, iter(lines)
        state, number, empty = interpreter.state, 0, True
        while (text := next(source, None)) is not None:
            number += 1
            if state.ended:
                if says(text):
                    interpreter.notes.add(number, 'text after the end of the program: not read')
                yield from interpreter.pass_by(text, number)
                continue
            if (empty or number <= _HEADER) and (found := _CONVERSATIONAL.match(text)):
                language = 'DIN/ISO' if found[1].startswith('%') else 'plain-text language'
                raise ProgramError(
                    number,
                    f"expected G-code but found Heidenhain's {language} "
                    f'({found[1].split(";")[0].strip()[:30]}): post the program for a control '
                    'that reads G-code',
                )
            line = read_line(text, number)
            empty = empty and line.end == 0
            if follow and (line.flow is not None or '98' in text) and _steers(line):
                rest = list(islice(chain([text], source), LINES + 1))
                if len(rest) <= LINES:
                    yield from _Follower(interpreter, rest, number, self._files).blocks()
                    return
                follow = False
                interpreter.notes.add(
                    number,
                    f'O-words are not followed: more than {LINES:,} lines come from here on',
                )
                source = chain(rest[1:], source)
            yield from interpreter.read(text, line, number)
        yield from interpreter.close()
        if empty:
            raise ProgramError(1, 'expected a part program but found no word in it: it is empty')


def read_program(text: str, units: str = 'mm') -> Program:
    r"""Read a part program.

    Parameters
    ----------
    text : str
        The program.  To get it back to the last byte, decode with `errors='surrogateescape'`
        and without translation of line endings.
    units : {'mm', 'inch'}
        Unit before the program says G20 or G21.

    Returns
    -------
    Program
        All lines with what they move, in the order in which they are run: O-words and M98 are
        followed.  The tool starts at the origin.

    Raises
    ------
    ProgramError
        At the first line that says something impossible: unbalanced parentheses, an arc whose
        radius does not fit or whose end is missing, a motion before any feed, a number that is
        not finite, text that is no text; and if no line says anything.

    Examples
    --------
    >>> program = read_program('G21 G0 X0 Y0 Z1\nG1 Z0 F300\nG2 X2 I1\nM30\n')
    >>> [f'{1e3 * segment.length:.3f}' for segment in program.segments]
    ['1.000', '1.000', '3.142']
    >>> program.runs
    ((1, 3),)
    """
    lines = [match[0] for match in _LINE.finditer(text)]
    reader = ProgramReader(units, follow=True, outline=outline_of(lines))
    blocks = tuple(reader.blocks(lines))
    return Program(blocks, reader.notes)

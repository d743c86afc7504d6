# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where O-words lead: the lines of a text, its subroutines, and which words belong together."""

import re

from fuzzycnc_ros.core.feedrate.gcode.lexer import FlowWord, Line, ProgramError, read_line

_O_WORD = re.compile(r'[ \t/]*(?:N[ \t]*\d+[ \t]*)?O[ \t]*[\d<#\[]', re.IGNORECASE | re.ASCII)
_OPENERS = {
    'if': ('endif',),
    'while': ('endwhile',),
    'do': ('while',),
    'repeat': ('endrepeat',),
}
_KEPT = 20_000  # lines that are kept as read

MAIN = ''
"""Name of what is in no subroutine."""


class Listing:
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
            if self._scope[index] == MAIN and word.kind in _OPENERS
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
        """Whether a `while` closes a `do`."""
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
        """Whether a subroutine may be called from a line on."""
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
        scope = MAIN
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
            if word.kind == 'sub' and isinstance(word.name, str) and scope == MAIN:
                scope = word.name
                self._start.setdefault(scope, index)
            self.flow[index] = word
            self._scope[index] = scope
            self._place.setdefault((scope, str(word.name)), []).append(index)
            if word.kind == 'endsub' and word.name == scope:
                self._end.setdefault(scope, index)
                scope = MAIN

    def _label(self, line: Line, index: int) -> None:
        words = [word for word in line.words if word.letter != 'N']
        if len(words) == 1 and words[0].letter == 'O' and words[0].value is not None:
            self._number.setdefault(str(round(words[0].value)), index)

    def _all(self, kind: str) -> list[int]:
        return [index for index, word in self.flow.items() if word.kind == kind]

    def _next(self, index: int, kinds: tuple[str, ...]) -> int | None:
        places = self._place[self._scope[index], str(self.flow[index].name)]
        return next((at for at in places if at > index and self.flow[at].kind in kinds), None)

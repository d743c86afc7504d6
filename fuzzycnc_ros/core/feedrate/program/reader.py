# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Read part programs, whole or as a stream."""

import re
from collections.abc import Iterable, Iterator
from itertools import chain, islice

from fuzzycnc_ros.core.feedrate.program.blocks import Block, Note, Program
from fuzzycnc_ros.core.feedrate.program.follow import Follower, steers
from fuzzycnc_ros.core.feedrate.program.interpreter import Interpreter
from fuzzycnc_ros.core.feedrate.program.lexer import ProgramError, read_line, says
from fuzzycnc_ros.core.feedrate.program.modal import INCH, MILLIMETRE
from fuzzycnc_ros.core.feedrate.program.subroutines import LINES, Files

_LINE = re.compile(r'[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+')
_UNITS = {'mm': MILLIMETRE, 'inch': INCH}


class ProgramReader:
    r"""Reads a part program from any source of lines, in memory that does not grow with it.

    Parameters
    ----------
    units : {'mm', 'inch'}
        Unit before the program says G20 or G21.

    Examples
    --------
    >>> reader = ProgramReader()
    >>> for block in reader.blocks(['G0 X0 Y0 Z0\n', 'G1 X30 F600\n']):
    ...     print(block.line, block.role.name, block.segment.length)
    1 RAPID 0.0
    2 FEED 0.03
    """

    def __init__(
        self, units: str = 'mm', *, follow: bool = False, files: Files | None = None
    ) -> None:
        if units not in _UNITS:
            raise ValueError(f"expected units 'mm' or 'inch' but found {units!r}")
        self._interpreter = Interpreter(_UNITS[units])
        self._follow = follow
        self._files = files

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was passed through so far."""
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
            line = read_line(text, number)
            empty = empty and line.end == 0
            if follow and (line.flow is not None or '98' in text) and steers(line):
                rest = list(islice(chain([text], source), LINES + 1))
                if len(rest) <= LINES:
                    yield from Follower(interpreter, rest, number, self._files).blocks()
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
    reader = ProgramReader(units, follow=True)
    blocks = tuple(reader.blocks(match[0] for match in _LINE.finditer(text)))
    return Program(blocks, reader.notes)

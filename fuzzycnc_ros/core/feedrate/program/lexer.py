# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of part programs: what a line says, without a meaning yet.

Two families of controllers are read, and any mixture of them: RS 274 (LinuxCNC, Fanuc and alike)
with comments in parentheses, and Siemens with assignments, calls and identifiers.
"""

import math
import re
from typing import NamedTuple

LENGTH_MAX = 1e6
"""Longest way or radius in a program [mm or inch]: a kilometre and more is of no machine."""


class ProgramError(ValueError):
    """A part program that says something impossible; names its line.

    Parameters
    ----------
    line : int
        Number of the line, the first one is 1.
    message : str
        What was expected, what was found, and the remedy.
    """

    def __init__(self, line: int, message: str) -> None:
        super().__init__(f'line {line}: {message}')
        self.line = line


class Word(NamedTuple):
    """A letter with its number, at `[start, end)` of the line.

    The value is None where the controller computes it, from a variable or an expression.
    """

    letter: str
    value: float | None
    start: int
    end: int


class Line:
    """What a line says.

    Attributes
    ----------
    words : list of Word
        Letters in upper case with their numbers, in order; `X=5.` counts as `X5.`.
    names : list of str
        Identifiers that stand alone, in upper case, `TRAFOOF`.
    calls : list of str
        Identifiers with arguments in parentheses, `CYCLE832`.
    assigned : dict
        Name in upper case to its number, None where it is no plain number, `TURN=0`.
    strange : bool
        Something stands there that no rule knows.
    optional : bool
        The line starts with `/`: a switch at the machine may skip it.
    percent : bool
        The line is a `%`.
    end : int
        Where the last word ends; comments and line ending follow.
    """

    __slots__ = ('assigned', 'calls', 'end', 'names', 'optional', 'percent', 'strange', 'words')

    def __init__(self) -> None:
        self.words: list[Word] = []
        self.names: list[str] = []
        self.calls: list[str] = []
        self.assigned: dict[str, float | None] = {}
        self.strange = False
        self.optional = False
        self.percent = False
        self.end = 0


_NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)'
_PLAIN = re.compile(
    rf'[ \t]*(?:[A-Z][ \t]*{_NUMBER}[ \t]*)*(?:;[^\r\n]*)?[\r\n]*', re.IGNORECASE | re.ASCII
)
_WORD = re.compile(rf'([A-Z])[ \t]*({_NUMBER})', re.IGNORECASE | re.ASCII)
_LONE_WORD = re.compile(rf'([A-Z])[ \t]*({_NUMBER})(?![\d.]|[ \t]*=)', re.IGNORECASE | re.ASCII)
_ASSIGNMENT = re.compile(
    r'([A-Z_][A-Z0-9_]*(?:\[[^\]\r\n]*\])?|#\d+|#<[^>\r\n]+>)[ \t]*=[ \t]*',
    re.IGNORECASE | re.ASCII,
)
_NAME = re.compile(r'(?:[A-Z]_?[A-Z]|_)[A-Z0-9_]*', re.IGNORECASE | re.ASCII)
_WHOLE_NUMBER = re.compile(_NUMBER, re.ASCII)
_STRING = re.compile(r'"[^"\r\n]*"')
_BINARY = re.compile('[\x00-\x08\x0e-\x19\x1b-\x1f\x7f\ufffd]')
_NO_NUMBER = re.compile(r'[A-Z](?:NAN|INF|INFINITY)', re.ASCII)
_LETTERS = frozenset('XYZABCUVWIJKRFGMNST')
_BLANK = frozenset(' \t\r\n\f\v\x1a\ufeff')


def read_line(text: str, number: int) -> Line:
    """Take a line apart.

    Parameters
    ----------
    text : str
        The line, with or without its ending.
    number : int
        Its number, for errors.

    Returns
    -------
    Line
        What it says.

    Raises
    ------
    ProgramError
        Where parentheses or quotes do not match, a letter lacks its number, a number is not
        finite, or the text is no text.

    Examples
    --------
    >>> [(word.letter, word.value) for word in read_line('N1G1 x-1.5 (to the left)', 1).words]
    [('N', 1.0), ('G', 1.0), ('X', -1.5)]
    """
    line = Line()
    if _PLAIN.fullmatch(text):
        body = text.find(';')
        for match in _WORD.finditer(text, 0, len(text) if body < 0 else body):
            line.words.append(_word(match, number))
        if line.words:
            line.end = line.words[-1].end
        return line
    if _BINARY.search(text):
        raise ProgramError(
            number, 'expected text but found control characters; is this a binary file?'
        )
    _scan(text, number, line)
    return line


def _word(match: re.Match[str], number: int) -> Word:
    value = float(match[2])
    if not math.isfinite(value):
        raise ProgramError(number, f'expected a finite number but found {match[0][:30]!r}...')
    if abs(value) > LENGTH_MAX and match[1].upper() in 'XYZIJKR':
        raise ProgramError(
            number,
            f'expected lengths up to {LENGTH_MAX:g} but found {match[0][:30]!r}; of no machine',
        )
    return Word(match[1].upper(), value, match.start(), match.end())


def _scan(text: str, number: int, line: Line) -> None:
    at, size = 0, len(text)
    while at < size:
        sign = text[at]
        if sign in _BLANK:
            at += 1
            continue
        if sign == ';':
            break
        if sign == '(':
            at = _closing(text, at, number, strings=False)
            continue
        if sign == '/' and not line.words and not line.names:
            line.optional = True
            at += 1
            continue
        if sign == '%' and not line.words:
            line.percent = True
            at = line.end = size
            break
        at = line.end = _item(text, at, number, line)


def _item(text: str, at: int, number: int, line: Line) -> int:
    """Read a word, an assignment, a call or a name, and return where it ends."""
    match = _LONE_WORD.match(text, at)
    if match:
        line.words.append(_word(match, number))
        return match.end()
    match = _ASSIGNMENT.match(text, at)
    if match:
        return _assign(text, match, number, line)
    match = _NAME.match(text, at)
    if match:
        name = match[0].upper()
        if name[0] in _LETTERS and _NO_NUMBER.fullmatch(name):
            raise ProgramError(number, f'expected a number after {name[0]} but found {name[1:]}')
        if text.startswith('(', match.end()):
            line.calls.append(name)
            return _closing(text, match.end(), number, strings=True)
        line.names.append(name)
        return match.end()
    return _remainder(text, at, number, line)


def _assign(text: str, match: re.Match[str], number: int, line: Line) -> int:
    end = _value_end(text, match.end(), number)
    raw = text[match.end() : end].rstrip(',')
    value = float(raw) if _WHOLE_NUMBER.fullmatch(raw) else None
    name = match[1].upper()
    if len(name) == 1 and name != 'T':
        line.words.append(Word(name, value, match.start(), end))
    else:
        line.assigned[name] = value
    return end


def _remainder(text: str, at: int, number: int, line: Line) -> int:
    """Read a letter with an expression, or what no rule knows."""
    sign = text[at]
    if sign == ')':
        raise ProgramError(number, 'expected ( before ) but found none: unbalanced parentheses')
    if sign == '"':
        return _string(text, at, number)
    if sign.isascii() and sign.isalpha():
        start = at + 1
        while start < len(text) and text[start] in ' \t':
            start += 1
        if text[start : start + 1] in ('#', '['):
            end = _value_end(text, start, number)
            line.words.append(Word(sign.upper(), None, at, end))
            return end
        if sign.upper() in _LETTERS:
            raise ProgramError(
                number,
                f'expected a number after {sign} but found {text[start:].split(";")[0].strip()!r}',
            )
    line.strange = line.strange or sign not in ',:'
    return at + 1


def _value_end(text: str, at: int, number: int) -> int:
    """Return where a value ends: at a blank outside of brackets and quotes, or at a comment."""
    depth = 0
    while at < len(text):
        sign = text[at]
        if sign == '"':
            at = _string(text, at, number)
            continue
        if sign in '([':
            depth += 1
        elif sign in ')]':
            depth -= 1
            if depth < 0:
                raise ProgramError(number, f'expected no {sign} here: unbalanced parentheses')
        elif depth == 0 and (sign in _BLANK or sign == ';'):
            break
        at += 1
    if depth:
        raise ProgramError(
            number, 'expected a closing bracket but the line ends: unbalanced parentheses'
        )
    return at


def _string(text: str, at: int, number: int) -> int:
    match = _STRING.match(text, at)
    if not match:
        raise ProgramError(number, 'expected a closing " but the line ends')
    return match.end()


def _closing(text: str, at: int, number: int, *, strings: bool) -> int:
    """Return where the parenthesis at `at` is over."""
    depth = 0
    while at < len(text):
        sign = text[at]
        if strings and sign == '"':
            at = _string(text, at, number)
            continue
        depth += (sign == '(') - (sign == ')')
        at += 1
        if depth == 0:
            return at
    raise ProgramError(
        number, 'expected ) but the line ends: unbalanced parentheses; close the comment'
    )

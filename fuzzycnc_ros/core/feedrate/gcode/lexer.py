# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of part programs: what a line says, without a meaning yet.

Two families of controllers are read, and any mixture of them: RS 274 (LinuxCNC, Fanuc and alike)
with comments in parentheses, expressions and O-words, and Siemens with assignments, calls and
identifiers.
"""

import math
import re
from copy import copy
from typing import NamedTuple

from fuzzycnc_ros.core.feedrate.gcode.expressions import (
    SPACED_NUMBER,
    Expression,
    ExpressionError,
    Target,
    Values,
    parameter_name,
    read_target,
    read_value,
)
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError


class Word(NamedTuple):
    """A letter with its number, at `[start, end)` of the line.

    The value is None where the controller computes it, from a variable or an expression.
    """

    letter: str
    value: float | None
    start: int
    end: int


class FlowWord(NamedTuple):
    """An O-word of RS 274: `o<name> call [1]`.

    The name is a text, or an expression for a number.  The kind is in small letters; empty for a
    lone `O100`.
    """

    name: str | Expression
    kind: str
    arguments: tuple[Expression, ...]


class Line:
    """Words, names, calls and assignments of one line.

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
    computed : list
        Index of each word whose value is an expression, and the expression.
    settings : list
        Parameters that the line sets, and their expressions, None where they are of no RS 274.
    flow : FlowWord or None
        Its O-word.
    command : str
        The line where it is a command to the control, not a block, GRBL's `$H`; empty for none.
    kept : str
        Command that has the rest of the line as its own, `M84` of `M84 X Y E`; empty for none.
    strange : bool
        Something stands there that no rule knows.
    optional : bool
        The line starts with `/`: a switch at the machine may skip it.
    percent : bool
        The line is a `%`.
    polar : bool
        It names a radius or an angle (`@`, `^`).
    end : int
        Where the last word ends; comments and line ending follow.
    """

    __slots__ = (
        'assigned',
        'calls',
        'command',
        'computed',
        'end',
        'flow',
        'kept',
        'names',
        'optional',
        'percent',
        'polar',
        'settings',
        'strange',
        'words',
    )

    def __init__(self) -> None:
        self.words: list[Word] = []
        # Most lines are words alone: what is rare is shared until `open` is called.
        self.names = self.calls = _NAMES
        self.assigned = _ASSIGNED
        self.computed = _NOTHING_COMPUTED
        self.settings = _SETTINGS
        self.flow: FlowWord | None = None
        self.command = self.kept = ''
        self.strange = self.optional = self.percent = self.polar = False
        self.end = 0

    def open(self) -> None:
        """Make the line ready for more than words."""
        self.names, self.calls = [], []
        self.assigned, self.computed, self.settings = {}, [], []


_NAMES: list[str] = []
_ASSIGNED: dict[str, float | None] = {}
_NOTHING_COMPUTED: list[tuple[int, Expression]] = []
_SETTINGS: list[tuple[Target, Expression | None]] = []


_LENGTH_MAX = 1e6
"""Longest way or radius in a program [mm or inch]: a kilometre and more is of no machine."""


_NUMBER = r'[-+]?(?:\d+(?:\.\d*)?|\.\d+)'
_PLAIN = re.compile(
    rf'[ \t]*(?:[A-Z][ \t]*{_NUMBER}[ \t]*)*(?:;[^\r\n]*)?[\r\n]*', re.IGNORECASE | re.ASCII
)
_WORD = re.compile(rf'([A-Z])[ \t]*({_NUMBER})', re.IGNORECASE | re.ASCII)
# LinuxCNC ignores blanks wherever they stand.
_SPACED = rf'[-+]?[ \t]*(?:{SPACED_NUMBER})'
_LONE_WORD = re.compile(rf'([A-Z])[ \t]*({_SPACED})(?![\d.]|[ \t]*=)', re.IGNORECASE | re.ASCII)
_ASSIGNMENT = re.compile(
    r'([A-Z_][A-Z0-9_]*(?:\[[^\]\r\n]*\])?)[ \t]*=[ \t]*',
    re.IGNORECASE | re.ASCII,
)
_CORNER = re.compile(rf',[ \t]*([ACR])[ \t]*{_NUMBER}', re.IGNORECASE | re.ASCII)
_NAME = re.compile(r'(?:[A-Z]_?[A-Z]|_)[A-Z0-9_]*', re.IGNORECASE | re.ASCII)
_WHOLE_NUMBER = re.compile(_NUMBER, re.ASCII)
_FLOW = re.compile(
    r'O[ \t]*(?:(\d(?:[ \t]*\d)*)|<([^>\r\n]+)>|(?=[#\[]))[ \t]*'
    # As in LinuxCNC a keyword may be longer than it is: callsub is a call.
    r'(?:(SUB|ENDSUB|CALL|DO|WHILE|REPEAT|IF|ELSEIF|ELSE|ENDIF|BREAK|CONTINUE|ENDWHILE|ENDREPEAT'
    r'|RETURN)[A-Z]*)?',
    re.IGNORECASE | re.ASCII,
)
_KEYWORD = re.compile(r'[ \t]*(CALL|RETURN|ENDSUB|SUB)[A-Z]*', re.IGNORECASE | re.ASCII)
_COMPUTED = re.compile(
    r'([A-Z@^])[ \t]*(?=[-+ \t]*[#\[]|[-+ \t]*'
    r'(?:ABS|ACOS|ASIN|ATAN|COS|EXISTS|EXP|FIX|FUP|LN|ROUND|SIN|SQRT|TAN)[ \t]*\[)',
    re.IGNORECASE | re.ASCII,
)
_BRACKET = re.compile(r'(?:[ \t]|\([^)\r\n]*\))*(?=\[)')
_EQUALS = re.compile(r'[ \t]*=')
_GOES_ON = re.compile(r'[ \t]*(?:[-+*/]|(?:AND|X?OR|MOD)(?![A-Z]))', re.IGNORECASE | re.ASCII)
_POLAR = re.compile(rf'([@^])[ \t]*({_SPACED})', re.ASCII)
_SPINDLE = re.compile(r'\$[ \t]*-?\d+', re.ASCII)
_SILENT = re.compile(r'(?:[\s%]|\([^)\r\n]*\))*(?:;[^\r\n]*[\r\n]*)?')
_STRING = re.compile(r'"[^"\r\n]*"')
_BINARY = re.compile('[\x00-\x08\x0e-\x19\x1b-\x1f\x7f\ufffd]')
_NO_NUMBER = re.compile(r'[A-Z](?:NAN|INF|INFINITY)', re.ASCII)
_LETTERS = frozenset('XYZABCUVWIJKRFGMNST')
_IDLE = frozenset('SE')
"""Letters that move nothing and may stand bare."""
_ENDS = frozenset(['', *' \t\r\n;('])
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
            if line.words[0].letter in 'MN':
                _keep_words(line)
        return line
    if _BINARY.search(text):
        raise ProgramError(
            number,
            'expected text but found control characters; save it as UTF-8 if it is UTF-16, or is '
            'this a binary file?',
        )
    line.open()
    try:
        if not _keep_text(text, line):
            _scan(text, number, line)
    except ProgramError:
        if not _keep_command(text, line):
            raise
        return line
    line.polar = any(word.letter in '@^' for word in line.words)
    if line.words and line.words[0].letter in 'MN':
        _keep_words(line)
    if line.strange or (line.names and line.words and _owns_words(line.words)):
        _keep_command(text, line)
    return line


# Commands that own what stands beside them: a word of it is no motion and no feed, whatever its
# letter.  They are those of 3D printers; on other controllers numbers from 200 on stand alone.
_OWNERS = frozenset(
    {17, 18, 84, 92, *range(104, 110), 113, 115, 117, 118, 119, 140, 141, 190, 191}
)
_OWNERS_FROM = 200
_TEXTS = frozenset({23, 28, 32, 36, 117, 118, 550, 551, 587, 588, 589, 1002})
"""Commands followed by any text."""

_FIRST = re.compile(
    r'[ \t]*(?:N[ \t]*\d+[ \t]*)?M[ \t]*(\d{1,5})(?:\.\d+)?(?=[ \t\r\nA-Z;(]|\Z)',
    re.IGNORECASE | re.ASCII,
)
_HOMING = re.compile(
    r'[ \t]*(?:N[ \t]*\d+[ \t]*)?G[ \t]*0*(2[6-9]|3[0-5])(?:\.\d+)?(?![\d.])',
    re.IGNORECASE | re.ASCII,
)
_EXTENDED = re.compile(r'[ \t]*([A-Z][A-Z_][A-Z0-9_]+)(?=[ \t\r\n]|\Z)', re.IGNORECASE | re.ASCII)
_MOTION = re.compile(r'(?<![A-Z_])G[ \t]*\d', re.IGNORECASE | re.ASCII)
_BARE_AXIS = re.compile(r'(?<![A-Z_])[XYZ](?![A-Z_])', re.IGNORECASE | re.ASCII)


def _owns_words(words: list[Word]) -> bool:
    """Return True if the first word, but for a line number, is a command that owns the others."""
    first = words[1] if words[0].letter == 'N' and len(words) > 1 else words[0]
    if first.letter != 'M' or first.value is None:
        return False
    return first.value >= _OWNERS_FROM or first.value in _OWNERS


def _keep_words(line: Line) -> None:
    """Leave a command alone with the words beside it, if it owns them."""
    words = line.words
    at = 1 if words[0].letter == 'N' else 0
    if len(words) > at + 1 and _owns_words(words) and not any(one.letter == 'G' for one in words):
        assert words[at].value is not None
        line.kept = f'M{words[at].value:g}'
        del words[at + 1 :]
        line.computed = []


def _keep_text(text: str, line: Line) -> bool:
    """Take a command that is followed by any text."""
    first = _FIRST.match(text)
    if first is None or int(first[1]) not in _TEXTS:
        return False
    return _keep_command(text, line)


def _keep_command(text: str, line: Line) -> bool:
    """Take a line that is no sequence of words as a command with its own text; False if not.

    What it says besides is not read: bare letters, versions, names, `KEY=VALUE`.  A line with a
    motion is none.
    """
    first, homing = _FIRST.match(text), _HOMING.match(text)
    match = first or homing or (None if line.strange else _EXTENDED.match(text))
    if match is None:
        return False
    free = first is not None and int(first[1]) in _TEXTS
    rest = text[match.end() :] if free else text[match.end() :].split(';')[0]
    if not free and _MOTION.search(rest):
        return False
    line.open()
    line.words = [
        _word(word, 0) for word in _WORD.finditer(text, 0, match.end()) if first or homing
    ]
    line.kept = match[0].strip() if first is None else f'M{line.words[-1].value:g}'
    line.strange, line.end = False, match.end() + len(rest.rstrip())
    if homing:
        line.words += [
            Word(axis[0].upper(), None, match.end() + axis.start(), match.end() + axis.end())
            for axis in _BARE_AXIS.finditer(rest)
        ]
    elif not first:
        line.names.append(match[1].upper())
    return True


def _word(match: re.Match[str], number: int) -> Word:
    try:
        value = float(match[2])
    except ValueError:
        value = float(''.join(match[2].split()))
    if not math.isfinite(value):
        raise ProgramError(number, f'expected a finite number but found {match[0][:30]!r}...')
    letter = match[1].upper()
    if abs(value) > _LENGTH_MAX:
        _check_length(letter, value, match[0], number)
    return Word(letter, value, match.start(), match.end())


def _check_length(letter: str, value: float, found: str, number: int) -> None:
    """Refuse a length of no machine; `found` is what the line says."""
    if abs(value) > _LENGTH_MAX and letter in 'XYZIJKR':
        raise ProgramError(
            number,
            f'expected lengths up to {_LENGTH_MAX:g} but found {found[:30]!r}; of no machine',
        )


def says(text: str) -> bool:
    """Return True if a line is more than blanks, comments or a `%`."""
    return _SILENT.fullmatch(text) is None


def resolved(line: Line, values: Values, number: int) -> Line:
    """Return a line whose expressions are computed, as far as their parameters are known.

    Parameters
    ----------
    line : Line
        The line as read.
    values : Values
        The parameters before it.
    number : int
        Its number, for errors.

    Raises
    ------
    ProgramError
        If an expression has no value, or is a length of no machine.
    """
    found = copy(line)
    found.words = line.words.copy()
    for index, expression in line.computed:
        letter, _, start, end = line.words[index]
        try:
            value = expression(values)
        except ExpressionError as error:
            raise ProgramError(number, str(error)) from error
        if value is not None:
            _check_length(letter, value, f'{letter}{value:g}', number)
        found.words[index] = Word(letter, value, start, end)
    return found


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
        if sign == '$':
            line.command = '' if line.words else text[at:]
            match = _SPINDLE.match(text, at)
            if line.command or not match:
                at = line.end = size
                line.strange = not line.command
                break
            at = line.end = match.end()
            continue
        at = line.end = _item(text, at, number, line)


def _item(text: str, at: int, number: int, line: Line) -> int:
    """Read a word, an assignment, a call or a name, and return where it ends."""
    match = _FLOW.match(text, at)
    if match and (match[3] or not match[1]):
        return _flow(text, match, number, line)
    match = _LONE_WORD.match(text, at) or _POLAR.match(text, at)
    if match:
        line.words.append(_word(match, number))
        return match.end()
    match = _CORNER.match(text, at)
    if match:
        line.assigned[f',{match[1].upper()}'] = None
        return match.end()
    if text[at] == '#':
        return _setting(text, at, number, line)
    match = _ASSIGNMENT.match(text, at)
    if match:
        return _assign(text, match, number, line)
    match = _COMPUTED.match(text, at)
    if match:
        return _computed(text, match, number, line)
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


def _computed(text: str, match: re.Match[str], number: int, line: Line) -> int:
    """Read a letter with an expression; one that RS 274 does not know ends at a blank."""
    letter = match[1].upper()
    try:
        expression, end = read_value(text, match.end())
    except ExpressionError:
        end = _value_end(text, match.end(), number)
    else:
        line.computed.append((len(line.words), expression))
    line.words.append(Word(letter, None, match.start(), end))
    return end


def _setting(text: str, at: int, number: int, line: Line) -> int:
    """Read `#1=2`; a macro of another control, without brackets, has no value here."""
    try:
        target, end = read_target(text, at)
    except ExpressionError:
        line.strange = True
        return at + 1
    match = _EQUALS.match(text, end)
    if not match:
        line.strange = True
        return at + 1
    try:
        expression, end = read_value(text, match.end())
    except ExpressionError:
        line.settings.append((target, None))
        return _value_end(text, match.end(), number)
    if _GOES_ON.match(text, end):
        line.settings.append((target, None))
        return _value_end(text, end, number)
    line.settings.append((target, expression))
    return end


def _flow(text: str, match: re.Match[str], number: int, line: Line) -> int:
    """Read an O-word with what stands in brackets after it."""
    end, kind = match.end(), match[3]
    try:
        digits = ''.join((match[1] or '0').split())
        name: str | Expression = parameter_name(match[2] or str(int(digits)))
        if not match[1] and not match[2]:
            name, end = read_value(text, end)
            word = _KEYWORD.match(text, end)
            kind, end = (word[1], word.end()) if word else (None, end)
        arguments = []
        while begun := _BRACKET.match(text, end):
            expression, end = read_value(text, begun.end())
            arguments.append(expression)
    except ExpressionError as error:
        raise ProgramError(number, str(error)) from error
    line.flow = FlowWord(name, (kind or '').lower(), tuple(arguments))
    return end


def _remainder(text: str, at: int, number: int, line: Line) -> int:
    """Read a letter with an expression, or what no rule knows."""
    sign = text[at]
    if sign == ')':
        raise ProgramError(number, 'expected ( before ) but found none: unbalanced parentheses')
    if sign == '"':
        return _string(text, at, number)
    if sign.isascii() and sign.isalpha():
        if sign.upper() in _IDLE and text[at + 1 : at + 2] in _ENDS:
            line.kept = sign.upper()
            return at + 1
        if sign.upper() in _LETTERS:
            found = text[at + 1 :].split(';')[0].strip()
            raise ProgramError(number, f'expected a number after {sign} but found {found!r}')
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

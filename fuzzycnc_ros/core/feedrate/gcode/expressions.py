# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Expressions of RS 274: `[#1 + 2*SIN[30]]`, read once and computed as often as they are run."""

import math
import re
from collections.abc import Callable
from functools import lru_cache
from typing import Protocol


class Values(Protocol):
    """Parameters by number and name, as an expression asks for them."""

    def number(self, index: float | None) -> float | None:
        """Return a numbered parameter, None where only the controller knows it."""

    def named(self, name: str) -> float | None:
        """Return a named parameter, None where only the controller knows it."""

    def exists(self, name: str) -> float | None:
        """Return 1 where a named parameter is set, 0 where not, None where nobody knows."""

    def doubt(self, what: str) -> None:
        """Be told what makes a value unknown, for messages."""


Expression = Callable[[Values], float | None]
"""Computes a value; None where it depends on what only the controller knows."""

_EQUAL = 1e-4
"""Numbers closer than this count as equal in EQ and NE, in newer LinuxCNC in GE and LE too."""

_DIGITS = 64
"""Bits of the long numbers of x86, in which LinuxCNC computes sines."""
_KEPT = 4096
"""Values remembered: programs go round in the same angles."""

_LENGTH = 512
"""Longest line with an expression; LinuxCNC takes 255."""

_DEPTH = 40
"""Brackets that lie in each other at most."""

_BLANK = re.compile(r'[ \t]*')
SPACED_NUMBER = r'\d(?:[ \t]*\d)*(?:[ \t]*\.(?:[ \t]*\d)*)?|\.(?:[ \t]*\d)+'
"""A number without its sign, as LinuxCNC reads it: blanks may stand anywhere in it."""

_NUMBER = re.compile(rf'[-+]?(?:{SPACED_NUMBER})', re.ASCII)
_NAME = re.compile(r'<([^>\r\n]+)>')
_OPERATION = re.compile(r'\*\*|[-+*/]|AND|X?OR|MOD|[EN][EQ]|[GL][ET]', re.IGNORECASE | re.ASCII)
_FUNCTION = re.compile(
    r'(ABS|ACOS|ASIN|ATAN|COS|EXISTS|EXP|FIX|FUP|LN|ROUND|SIN|SQRT|TAN)[ \t]*(?=\[)',
    re.IGNORECASE | re.ASCII,
)


class ExpressionError(ValueError):
    """No expression stands there, or it has no value; its message says what was expected."""


def read_value(text: str, at: int, depth: int = 0) -> tuple[Expression, int]:
    """Read a value: a number, a parameter, a bracket or a function, with or without a sign.

    Parameters
    ----------
    text : str
        The line.
    at : int
        Where the value begins.
    depth : int
        In how many brackets and signs it lies.

    Returns
    -------
    Expression
        It.
    int
        Where it ends.

    Raises
    ------
    ExpressionError
        If there is none.

    Examples
    --------
    >>> read_value('X[2 + 3*2**2]', 1)[0](None)
    14.0
    """
    if len(text) > _LENGTH:
        raise ExpressionError(f'expected a line of at most {_LENGTH} signs around an expression')
    at = _skip(text, at)
    match = _NUMBER.match(text, at)
    if match and math.isfinite(value := float(''.join(match[0].split()))):
        return (lambda _: value), match.end()
    if depth > _DEPTH:
        raise ExpressionError(f'expected at most {_DEPTH} brackets in each other but found more')
    sign = text[at : at + 1]
    if sign == '[':
        return _bracket(text, at, depth + 1)
    if sign == '#':
        return _parameter(text, at, depth + 1)
    if sign and sign in '+-':
        inner, end = read_value(text, at + 1, depth + 1)
        return (inner if sign == '+' else _negative(inner)), end
    match = _FUNCTION.match(text, at)
    if match:
        return _function(text, match, depth + 1)
    raise ExpressionError(f'expected a number, # or [ but found {text[at:].rstrip()[:20]!r}')


def read_target(text: str, at: int, depth: int = 0) -> tuple['Target', int]:
    """Read the parameter that an assignment sets, from its `#` on; as `read_value`."""
    at = _skip(text, at + 1)
    match = _NAME.match(text, at)
    if match:
        return parameter_name(match[1]), match.end()
    return read_value(text, at, depth)


Target = str | Expression
"""Target of an assignment: a name, or an expression that computes a number."""


def parameter_name(text: str) -> str:
    """Return the name of a parameter as LinuxCNC keeps it: small letters, no blanks."""
    return ''.join(text.split()).lower()


def _skip(text: str, at: int) -> int:
    match = _BLANK.match(text, at)
    return match.end() if match else at


def _negative(inner: Expression) -> Expression:
    def negative(values: Values) -> float | None:
        value = inner(values)
        return None if value is None else -value

    return negative


def _parameter(text: str, at: int, depth: int) -> tuple[Expression, int]:
    target, end = read_target(text, at, depth)
    if isinstance(target, str):
        name = target
        return (lambda values: values.named(name)), end
    index = target
    return (lambda values: values.number(index(values))), end


def _bracket(text: str, at: int, depth: int) -> tuple[Expression, int]:
    found, end = _operations(text, at + 1, 1, depth)
    end = _skip(text, end)
    if text[end : end + 1] != ']':
        raise ExpressionError(f'expected ] or an operator but found {text[end:].rstrip()[:20]!r}')
    return found, end + 1


def _operations(text: str, at: int, lowest: int, depth: int) -> tuple[Expression, int]:
    """Read operations that bind at least as strongly as `lowest`, from the left."""
    left, at = read_value(text, at, depth)
    while match := _OPERATION.match(text, _skip(text, at)):
        name = match[0].upper()
        if name not in _RANKS:
            raise ExpressionError(f'expected an operator but found {match[0]!r}')
        if _RANKS[name] < lowest:
            break
        right, at = _operations(text, match.end(), _RANKS[name] + 1, depth)
        left = _both(_OPERATIONS[name], left, right)
    return left, at


def _both(
    compute: Callable[[float, float], float | None], left: Expression, right: Expression
) -> Expression:
    def both(values: Values) -> float | None:
        first, second = left(values), right(values)
        if first is None or second is None:
            return None
        value = _finite(compute, first, second)
        if value is None:
            values.doubt(f'whether {first:.9g} and {second:.9g} are equal')
        return value

    return both


def _function(text: str, match: re.Match[str], depth: int) -> tuple[Expression, int]:
    name = match[1].upper()
    if name == 'EXISTS':
        return _existence(text, match.end())
    inner, end = _bracket(text, match.end(), depth)
    if name == 'ATAN':
        end = _skip(text, end)
        if text[end : end + 1] != '/' or text[_skip(text, end + 1) :][:1] != '[':
            raise ExpressionError('expected ATAN[...]/[...] but found no second bracket')
        other, end = _bracket(text, _skip(text, end + 1), depth)
        return _both(lambda y, x: _degrees(math.atan2(y, x)), inner, other), end
    compute = _FUNCTIONS[name]

    def function(values: Values) -> float | None:
        value = inner(values)
        return None if value is None else _finite(compute, value)

    return function, end


def _existence(text: str, at: int) -> tuple[Expression, int]:
    at = _skip(text, at + 1)
    target, end = read_target(text, at) if text[at : at + 1] == '#' else (None, at)
    end = _skip(text, end)
    if target is None or text[end : end + 1] != ']':
        raise ExpressionError('expected a parameter in EXISTS[#<name>]')
    if isinstance(target, str):
        name = target
        return (lambda values: values.exists(name)), end + 1
    return (lambda _: 1.0), end + 1


def _finite(compute: Callable[..., float | None], *operands: float) -> float | None:
    """Compute, and refuse what is no number."""
    try:
        found = compute(*operands)
        if found is None:
            return None
        value = float(found)
    except (ArithmeticError, ValueError, TypeError):  # a root that is complex is no float
        value = math.nan
    if not math.isfinite(value):
        what = ' and '.join(f'{operand:g}' for operand in operands)
        raise ExpressionError(
            f'expected an expression that has a value but found a division by 0, a root or a '
            f'logarithm of {what} that has none'
        )
    return value


def _modulo(left: float, right: float) -> float:
    rest = math.fmod(left, right)
    return rest + abs(right) if rest < 0.0 else rest


def _above(left: float, right: float) -> bool | None:
    """Compare; None where versions of LinuxCNC differ: whether almost equal is enough."""
    if left >= right:
        return True
    return None if abs(left - right) < _EQUAL else False


# LinuxCNC turns degrees into radians and back with the 64 bits of x86's long numbers: at 90
# degrees that decides the sign of a cosine.  Such numbers differ between processors, mpmath's do
# not.


@lru_cache(_KEPT)
def _trigonometric(name: str, angle: float) -> float:
    """Return the sine, cosine or tangent of an angle in degrees.

    Examples
    --------
    >>> _trigonometric('cos', 90.0)  # of a long number a little more than a quarter turn
    -2.508278806334166e-20
    """
    from mpmath import libmp

    turn = libmp.mpf_mul(libmp.from_float(angle), libmp.mpf_pi(_DIGITS, 'n'), _DIGITS, 'n')
    radians = libmp.mpf_div(turn, libmp.from_int(180), _DIGITS, 'n')
    found = getattr(libmp, f'mpf_{name}')(radians, _DIGITS, 'n')
    return float(libmp.to_float(found, rnd='n'))


def _degrees(angle: float) -> float:
    """Return an angle in radians in degrees."""
    from mpmath import libmp

    if not angle:
        return angle
    over = libmp.mpf_mul(libmp.from_float(angle), libmp.from_int(180))
    quotient = libmp.mpf_div(over, libmp.mpf_pi(_DIGITS, 'n'), _DIGITS, 'n')
    return float(libmp.to_float(quotient, rnd='n'))


def _round(value: float) -> float:
    return float(int(value + math.copysign(0.5, value)))


_RANKS = {
    **dict.fromkeys(('AND', 'OR', 'XOR'), 1),
    **dict.fromkeys(('EQ', 'NE', 'GT', 'GE', 'LT', 'LE'), 2),
    **dict.fromkeys(('+', '-'), 3),
    **dict.fromkeys(('*', '/', 'MOD'), 4),
    '**': 5,
}

_OPERATIONS: dict[str, Callable[[float, float], float | None]] = {
    '**': pow,
    '*': lambda left, right: left * right,
    '/': lambda left, right: left / right,
    'MOD': _modulo,
    '+': lambda left, right: left + right,
    '-': lambda left, right: left - right,
    'EQ': lambda left, right: abs(left - right) < _EQUAL,
    'NE': lambda left, right: abs(left - right) >= _EQUAL,
    'GT': lambda left, right: left > right,
    'GE': _above,
    'LT': lambda left, right: left < right,
    'LE': lambda left, right: _above(right, left),
    'AND': lambda left, right: left != 0.0 and right != 0.0,
    'OR': lambda left, right: left != 0.0 or right != 0.0,
    'XOR': lambda left, right: (left != 0.0) != (right != 0.0),
}

_FUNCTIONS: dict[str, Callable[[float], float]] = {
    'ABS': abs,
    'ACOS': lambda value: _degrees(math.acos(value)),
    'ASIN': lambda value: _degrees(math.asin(value)),
    'COS': lambda value: _trigonometric('cos', value),
    'EXP': math.exp,
    'FIX': math.floor,
    'FUP': math.ceil,
    'LN': math.log,
    'ROUND': _round,
    'SIN': lambda value: _trigonometric('sin', value) if value else value,  # -0 too
    'SQRT': math.sqrt,
    'TAN': lambda value: _trigonometric('tan', value) if value else value,
}

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a line of a part program is made of."""

from typing import NamedTuple

from fuzzycnc_ros.core.feedrate.program.expressions import Expression, Target


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


class FlowWord(NamedTuple):
    """An O-word of RS 274: `o<name> call [1]`.

    The name is a text, or an expression for a number.  The kind is in small letters; empty for a
    lone `O100`.
    """

    name: str | Expression
    kind: str
    arguments: tuple[Expression, ...]


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
    computed : list
        Index of each word whose value is an expression, and the expression.
    settings : list
        Parameters that the line sets, and their expressions, None where they are of no RS 274.
    flow : FlowWord or None
        Its O-word.
    command : bool
        It is a command to the control, not a block: GRBL's `$H`.
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
        self.computed = _COMPUTED
        self.settings = _SETTINGS
        self.flow: FlowWord | None = None
        self.command = self.strange = self.optional = self.percent = self.polar = False
        self.end = 0

    def open(self) -> None:
        """Make the line ready for more than words."""
        self.names, self.calls = [], []
        self.assigned, self.computed, self.settings = {}, [], []


_NAMES: list[str] = []
_ASSIGNED: dict[str, float | None] = {}
_COMPUTED: list[tuple[int, Expression]] = []
_SETTINGS: list[tuple[Target, Expression | None]] = []

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""NURBS curves that a program gives over many lines: G5.2 ... G5.3, and G6.2."""

import math
from abc import ABC, abstractmethod
from itertools import pairwise

import numpy as np

from fuzzycnc_ros.core.feedrate.gcode.arcs import ABSOLUTE_MISFIT, PLANES
from fuzzycnc_ros.core.feedrate.gcode.lexer import ProgramError, Word
from fuzzycnc_ros.core.feedrate.gcode.modal import State
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve, check_machinable

FEWEST_ORDER = 3
"""LinuxCNC takes an L below that for this."""


class CurveBlock(ABC):
    """A curve that is being read.

    Parameters
    ----------
    line : int
        Number of its first line.
    state : State
        Modal state before it; its position is the start.
    """

    def __init__(self, line: int, state: State) -> None:
        self.line = line
        self.state = state
        self.start = tuple(state.position)
        self.control: list[list[float]] = []
        self.weight: list[float] = []

    @abstractmethod
    def take(self, words: list[Word], line: int) -> bool:
        """Take the words of a line; return whether the curve is complete with them."""

    @abstractmethod
    def close(self) -> NurbsCurve:
        """Return the curve; `ProgramError` if it is none."""

    def _numbers(self, words: list[Word], line: int) -> dict[str, float]:
        if not self.state.absolute:
            raise ProgramError(
                line, 'expected absolute coordinates (G90) in a NURBS block but found G91'
            )
        number: dict[str, float] = {}
        for word in words:
            if word.letter in 'ABCUVWXYZKLPR':
                if word.value is None:
                    raise ProgramError(
                        line, f'expected a plain number for {word.letter} in a NURBS block'
                    )
                number[word.letter] = word.value
        turned = sorted(set('ABCUVW') & set(number))
        if turned:
            raise ProgramError(
                line, f'expected X, Y and Z in a NURBS block but found {", ".join(turned)}'
            )
        return number

    def _curve(self, knot: list[float], degree: int) -> NurbsCurve:
        if not np.isfinite(self.control).all():
            raise ProgramError(
                self.line,
                'expected a known place before a NURBS block; name all three axes in a block '
                'with G0 or G1 before it',
            )
        try:
            curve = NurbsCurve(self.control, self.weight, knot, degree)
            check_machinable(curve.control, curve.weight, curve.knot, degree)
            return curve
        except ValueError as error:
            raise ProgramError(self.line, f'no NURBS curve begins here: {error}') from error


class PlaneCurveBlock(CurveBlock):
    """G5.2 ... G5.3 of LinuxCNC: control points in the plane, weights P, order L.

    The place before the block is the first control point.  The knots are not programmed: they
    are clamped and even, as LinuxCNC sets them.
    """

    def __init__(self, line: int, state: State) -> None:
        super().__init__(line, state)
        self.order = FEWEST_ORDER
        self.control.append(list(self.start))
        self.weight.append(1.0)

    def take(self, words: list[Word], line: int) -> bool:
        """Take a control point, see `CurveBlock.take`."""
        number = self._numbers(words, line)
        self.order = max(self.order, int(number.get('L', 0.0)))
        first, second, across = ('XYZ'[axis] for axis in PLANES[self.state.plane])
        if across in number or (first in number) != (second in number):
            raise ProgramError(
                line,
                f'expected {first} and {second} of a control point in a G5.2 block, without '
                f'{across}, but found {" ".join(sorted(set("XYZ") & set(number)))}',
            )
        if first in number:
            point = list(self.start)
            for axis in (first, second):
                point['XYZ'.index(axis)] = number[axis] * self.state.length_unit
            self.control.append(point)
            self.weight.append(number.get('P', 1.0))
        elif 'P' in number and len(self.control) == 1:
            self.weight[0] = number['P']
        return False

    def close(self) -> NurbsCurve:
        """Return the curve."""
        count, order = len(self.control), self.order
        if count < order:
            raise ProgramError(
                self.line,
                f'expected at least {order} control points of a curve of order {order} (L), the '
                f'place before it included, but found {count}',
            )
        inner = [float(number) for number in range(1, count - order + 1)]
        return self._curve([0.0] * order + inner + [count - order + 1.0] * order, order - 1)


class KnotCurveBlock(CurveBlock):
    """G6.2: order P, in each line a knot K and a control point with weight R, then knots alone.

    The first control point is where the tool stands, or is left out.
    """

    def __init__(self, line: int, state: State) -> None:
        super().__init__(line, state)
        self.order = 4
        self.knot: list[float] = []

    def take(self, words: list[Word], line: int) -> bool:
        """Take a knot, and a control point, see `CurveBlock.take`."""
        number = self._numbers(words, line)
        if 'P' in number:
            self.order = int(number['P'])
            if self.order < 2 or self.order != number['P']:
                raise ProgramError(
                    line, f'expected a whole order P from 2 of a curve but found {number["P"]:g}'
                )
        if not number and self.control:
            return False
        if 'K' in number:
            # The first knot may be left out: it is the second one then.
            self.knot += [number['K']] * (2 if self.control and not self.knot else 1)
        elif self.control:
            raise ProgramError(line, 'expected a knot K in each line of a G6.2 block')
        if not self.control or not set('XYZR').isdisjoint(number):
            self._take_point(number, line)
        return len(self.knot) == len(self.control) + self.order

    def _take_point(self, number: dict[str, float], line: int) -> None:
        if len(self.knot) > len(self.control) + 1:
            raise ProgramError(
                line,
                f'expected {self.order} knots alone after the last control point of a curve of '
                f'order {self.order} (P) but found {len(self.knot) - len(self.control) - 1}',
            )
        point = list(self.control[-1] if self.control else self.start)
        for index, axis in enumerate('XYZ'):
            if axis in number:
                point[index] = number[axis] * self.state.length_unit
        if not self.control and math.dist(point, self.start) > ABSOLUTE_MISFIT:
            raise ProgramError(
                line, 'expected the first control point of a G6.2 block where the tool stands'
            )
        self.control.append(point)
        self.weight.append(number.get('R', 1.0))

    def close(self) -> NurbsCurve:
        """Return the curve."""
        knot = self.knot
        if len(knot) != len(self.control) + self.order:
            raise ProgramError(
                self.line,
                f'expected {len(self.control) + self.order} knots for {len(self.control)} '
                f'control points of order {self.order} (P) but found {len(knot)}',
            )
        if any(after < before for before, after in pairwise(knot)):
            raise ProgramError(self.line, 'expected knots K that never fall in a G6.2 block')
        return self._curve(knot, self.order - 1)

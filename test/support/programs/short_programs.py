# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Random short part programs, and how LinuxCNC's figures of them stand beside the model's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

HEAD = 'G21 G90 G94 G17 G40\n'
KINDS = (
    'two lines', 'slow block', 'small angles', 'line and arc', 'arcs', 'lines and arcs',
    'lines in space', 'helix',
)  # fmt: skip
PLUNGES = ('plunge',)
"""Kinds that were drawn by themselves."""
BATCH = 20
"""Programs that share an acceleration."""
MACHINE_CONSTANT = 2.15e-4
"""Error of the built-in machine in a bend by the acceleration across it [s^2]."""
LONGEST = 1.0
"""Time that a block may take at its feed; a slower feed is raised [s]."""


@dataclass(frozen=True)
class ShortProgram:
    """A program of few blocks from the origin.

    Parameters
    ----------
    kind : str
        One of `KINDS` or `PLUNGES`.
    text : str
        Path mode and blocks.
    acceleration : tuple of float, length 3
        Of X, Y and Z [m/s^2].
    """

    kind: str
    text: str
    acceleration: tuple[float, float, float]


class _Pen:
    """Writes blocks one after the other."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random
        self._at = np.zeros(3)
        self._heading = random.uniform(-np.pi, np.pi)
        self.lines: list[str] = []
        self.feed = float('nan')

    def turn(self, low: float, high: float) -> None:
        """Turn left or right by an angle between two [deg]."""
        self._heading += self._sign() * np.radians(self._random.uniform(low, high))

    def line(self, length: float, slope: float = 0.0, feed: float | None = None) -> None:
        """Go straight [mm], up by a slope."""
        flat = length * np.cos(slope)
        way = np.array([np.cos(self._heading), np.sin(self._heading), 0.0]) * flat
        way[2] = length * np.sin(slope)
        self._go('G1', way, '', length, feed)

    def arc(self, radius: float, sweep: float, climb: float = 0.0, same: bool = False) -> None:
        """Go round a bend [mm, rad], with the same feed as before or one that may be drawn."""
        sign = self._sign()
        out = np.array([-np.sin(self._heading), np.cos(self._heading), 0.0]) * sign * radius
        self._heading += sign * sweep
        back = np.array([np.sin(self._heading), -np.cos(self._heading), 0.0]) * sign * radius
        way = out + back
        way[2] = climb
        word = f' I{out[0]:.7f} J{out[1]:.7f}'
        feed = self.feed if same else None
        self._go('G3' if sign > 0 else 'G2', way, word, radius * sweep, feed)

    def rapid(self, length: float, rise: float = 0.0) -> None:
        """Go straight as a rapid [mm], and up."""
        way = np.array([np.cos(self._heading), np.sin(self._heading), 0.0]) * length
        way[2] = rise
        self._at = self._at + way
        x, y, z = self._at
        self.lines.append(f'G0 X{x:.7f} Y{y:.7f} Z{z:.7f}\n')

    def plunge(self, depth: float, feed: float) -> None:
        """Go down [mm]."""
        self._go('G1', np.array([0.0, 0.0, -depth]), '', depth, feed)

    def length(self) -> float:
        """Draw the length of a block [mm]."""
        return float(np.exp(self._random.uniform(np.log(0.05), np.log(20.0))))

    def bend(self) -> tuple[float, float]:
        """Draw radius and sweep of an arc [mm, rad]."""
        radius = float(np.exp(self._random.uniform(np.log(0.1), np.log(50.0))))
        return radius, float(np.clip(self.length() / radius, 0.02, 1.9 * np.pi))

    def _sign(self) -> float:
        return 1.0 if self._random.random() < 0.5 else -1.0

    def _go(self, word: str, way, rest: str, length: float, feed: float | None) -> None:
        self._at = self._at + way
        x, y, z = self._at
        if feed is None and (self.feed != self.feed or self._random.random() < 0.5):
            feed = float(np.exp(self._random.uniform(np.log(100.0), np.log(12000.0))))
        if feed is not None:
            self.feed = feed
        self.feed = max(self.feed, 60.0 * length / LONGEST)
        self.lines.append(f'{word} X{x:.7f} Y{y:.7f} Z{z:.7f}{rest} F{self.feed:.3f}\n')


def short_program(seed: int, number: int, kinds: Sequence[str] = KINDS) -> ShortProgram:
    """Return the program of a number; those of a batch have one acceleration."""
    batch = np.random.default_rng([seed, 1, number // BATCH])
    rise = float(np.exp(batch.uniform(np.log(0.1), np.log(5.0))))
    shares = batch.uniform(0.4, 1.0, 3) if batch.random() < 0.2 else np.ones(3)
    random = np.random.default_rng([seed, 2, number])
    kind = kinds[number % len(kinds)]
    pen = _Pen(random)
    _WRITERS[kind](pen, random)
    text = _mode(random) + ''.join(pen.lines)
    x, y, z = (rise * shares).tolist()
    return ShortProgram(kind, text, (x, y, z))


def _mode(random: np.random.Generator) -> str:
    drawn = random.random()
    if drawn < 0.06:
        return 'G61\n'
    if drawn < 0.12:
        return 'G64\n'
    rounding = float(np.exp(random.uniform(np.log(0.005), np.log(0.1))))
    which = random.integers(3)
    if which == 0:
        return f'G64 P{rounding:.5f}\n'
    merging = 0.0 if which == 1 else rounding * random.random()
    return f'G64 P{rounding:.5f} Q{merging:.5f}\n'


def _two_lines(pen: _Pen, random: np.random.Generator) -> None:
    pen.line(pen.length())
    pen.turn(0.0, 180.0)
    pen.line(pen.length())


def _slow_block(pen: _Pen, random: np.random.Generator) -> None:
    fast = float(random.uniform(800.0, 12000.0))
    pen.line(float(random.uniform(1.0, 10.0)), feed=fast)
    for _ in range(random.integers(1, 4)):
        pen.turn(2.0, 60.0)
        pen.line(float(random.uniform(0.05, 0.5)), feed=fast * float(random.uniform(0.1, 0.5)))
    pen.turn(0.0, 40.0)
    pen.line(float(random.uniform(1.0, 5.0)), feed=fast)


def _small_angles(pen: _Pen, random: np.random.Generator) -> None:
    length = float(np.exp(random.uniform(np.log(0.05), np.log(3.0))))
    for _ in range(random.integers(3, 20)):
        pen.line(length * float(random.uniform(0.5, 1.5)))
        pen.turn(0.0, 15.0)


def _line_and_arc(pen: _Pen, random: np.random.Generator) -> None:
    straight = random.integers(2)
    for number in range(random.integers(2, 4)):
        if number % 2 == straight:
            pen.line(pen.length())
        else:
            pen.arc(*pen.bend())
        if random.random() < 0.6:
            pen.turn(0.0, 120.0)


def _arcs(pen: _Pen, random: np.random.Generator) -> None:
    for _ in range(random.integers(1, 4)):
        pen.arc(*pen.bend())
        if random.random() < 0.6:
            pen.turn(0.0, 120.0)


def _lines_and_arcs(pen: _Pen, random: np.random.Generator) -> None:
    for _ in range(random.integers(4, 11)):
        if random.random() < 0.4:
            pen.arc(*pen.bend())
        else:
            pen.line(pen.length())
        if random.random() < 0.7:
            pen.turn(0.0, float(random.choice([10.0, 60.0, 178.0])))


def _lines_in_space(pen: _Pen, random: np.random.Generator) -> None:
    for _ in range(random.integers(2, 6)):
        pen.line(pen.length(), slope=float(random.uniform(-1.5, 1.5)))
        pen.turn(0.0, 150.0)


def _helix(pen: _Pen, random: np.random.Generator) -> None:
    pen.line(pen.length())
    radius, sweep = pen.bend()
    pen.arc(radius, sweep, climb=float(random.uniform(-1.0, 1.0)) * radius * sweep)
    if random.random() < 0.5:
        pen.turn(0.0, 60.0)
    pen.line(pen.length())


def _plunge(pen: _Pen, random: np.random.Generator) -> None:
    """Plunges after rapids, and bends whose steady error may hide what a rapid leaves."""
    steady = float(np.exp(random.uniform(np.log(0.005), np.log(0.05))))
    for _ in range(random.integers(2, 5)):
        pen.rapid(pen.length(), rise=float(random.choice([0.0, 1.0])))
        for _ in range(random.integers(1, 4)):
            feed = float(np.exp(random.uniform(np.log(20.0), np.log(600.0))))
            pen.plunge(float(random.uniform(0.02, 0.3)), feed)
    radius = float(np.exp(random.uniform(np.log(0.3), np.log(3.0))))
    # mm/min at which axes of the built-in machine cut the bend by so much
    pen.feed = 60.0 * np.sqrt(steady * radius / MACHINE_CONSTANT)
    pen.arc(radius, float(random.uniform(0.5, 1.9) * np.pi), same=True)


_WRITERS = dict(
    zip(
        (*KINDS, *PLUNGES),
        (_two_lines, _slow_block, _small_angles, _line_and_arc, _arcs, _lines_and_arcs,
         _lines_in_space, _helix, _plunge),
        strict=True,
    )
)  # fmt: skip

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The moves that a simulated machine asks for by itself: it plays the operator."""

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from fuzzycnc_ros.runtime.records import PositionCommand, nanoseconds


class ServoMoves:
    """Positions of axes, commanded one after the other, each with its time.

    Parameters
    ----------
    axes : sequence of str
        Axes that there are.
    moves : sequence of str
        Targets [m] as `X:-0.05`, of several axes as `X:-0.05,Y:0.01`.
    duration : float
        Time of each [s].
    tolerance : float
        Distance from its target within which an axis has to read at the end [m].

    Attributes
    ----------
    failure : str
        Which move did not arrive; empty if none.

    Raises
    ------
    ValueError
        If a move does not name axes and numbers.
    """

    def __init__(
        self, axes: Sequence[str], moves: Sequence[str], *, duration: float, tolerance: float
    ) -> None:
        self._axes = tuple(axes)
        self._waiting = deque(self.parsed(text) for text in moves)
        self._duration = nanoseconds(duration)
        self._given = len(self._waiting) * self._duration
        self._tolerance = tolerance
        self._number = 0
        self._move: dict[str, float] = {}  # the one that is being made
        self._until = 0
        self.failure = ''

    @property
    def duration(self) -> int:
        """Time of all moves that were given at the beginning [ns]."""
        return self._given

    @property
    def over(self) -> bool:
        """Whether the time of the last one is over."""
        return not (self._move or self._waiting)

    def add(self, text: str) -> None:
        """Have one more move follow.

        Raises
        ------
        ValueError
            If it does not name axes and numbers.
        """
        self._waiting.append(self.parsed(text))

    def next(
        self, stamp: int, frame_id: str, readings: Mapping[str, float]
    ) -> PositionCommand | None:
        """Return the next move if its time has come at a period [ns], and judge the last."""
        if self._move:
            if stamp < self._until:
                return None
            self._judge(self._move, readings)
        self._move = self._waiting.popleft() if self._waiting else {}
        if not self._move:
            return None
        self._number += 1
        self._until = stamp + self._duration
        return PositionCommand(
            stamp=stamp,
            frame_id=frame_id,
            axis=tuple(self._move),
            position=np.array(list(self._move.values())),
            velocity=np.full(len(self._move), np.nan),
        )

    def _judge(self, move: Mapping[str, float], readings: Mapping[str, float]) -> None:
        for name, target in move.items():
            if self.failure or abs(readings[name] - target) <= self._tolerance:
                continue
            self.failure = (
                f'move {self._number}: expected {name} within '
                f'{1e6 * self._tolerance:g} um of {1e3 * target:g} mm but it reads '
                f'{1e3 * readings[name]:.4f} mm; is servo_controller active?'
            )

    def parsed(self, text: str) -> dict[str, float]:
        """Return the targets [m] of a move by axis.

        Raises
        ------
        ValueError
            If it does not name axes and numbers.
        """
        found: dict[str, float] = {}
        for item in text.split(','):
            name, _, value = item.partition(':')
            try:
                place = float(value)
            except ValueError:
                place = np.nan
            if name not in self._axes or name in found or not np.isfinite(place):
                raise ValueError(
                    f'moves: expected targets in m as X:-0.05 of axes among '
                    f'{", ".join(self._axes) or "none (servo_axes)"} but found {text!r}'
                )
            found[name] = place
        return found

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulated machine loads by itself, one after the other: it plays the operator."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import nanoseconds

_USUAL_SPEED = 0.02
"""Speed along a path that progress is told by, before anything is known [m/s]."""


class Programme(ABC):
    """Paths that are loaded one after the other.

    Parameters
    ----------
    names : sequence of str
        What is to be loaded.
    lengths : sequence of float
        Length of each path [m].
    timeout : float
        Time to wait for a trajectory before the programme is given up [s].
    nodes : str
        Which nodes make a trajectory of what is loaded, for the message.

    Attributes
    ----------
    failure : str
        Why the programme was given up; empty if it was not.
    """

    def __init__(
        self, names: Sequence[str], lengths: Sequence[float], *, timeout: float, nodes: str
    ) -> None:
        self._ids = [_unique(names, index) for index in range(len(names))]
        self._lengths = lengths
        self._timeout, self._nodes = nanoseconds(timeout), nodes
        self._number = -1
        self._since = 0
        self.failure = ''

    @property
    def over(self) -> bool:
        """Whether all paths were followed or the programme was given up."""
        return bool(self.failure) or self._number >= len(self._ids)

    @property
    def path_id(self) -> str:
        """Path that is loaded; empty if none is."""
        return self._ids[self._number] if 0 <= self._number < len(self._ids) else ''

    @property
    def waiting(self) -> bool:
        """Whether a path is loaded and its trajectory to be waited for."""
        return bool(self.path_id) and not self.failure

    def load_next(self, stamp: int, frame_id: str) -> tuple[Emission, ...]:
        """Go on to the next path; return what loads it, nothing if there is none left."""
        self._number += 1
        self._since = stamp
        return () if self.over else self._load(stamp, frame_id)

    @abstractmethod
    def _load(self, stamp: int, frame_id: str) -> tuple[Emission, ...]:
        """Return what loads the present path."""

    def wait(self, stamp: int, status: str, *, busy: bool) -> None:
        """Give up if the machine has been without a trajectory for too long.

        Parameters
        ----------
        stamp : int
            Machine time [ns].
        status : str
            What became of the trajectory, for the message.
        busy : bool
            Whether a trajectory is being followed.
        """
        if busy:
            self._since = stamp
        elif self.waiting and stamp - self._since >= self._timeout:
            self.failure = (
                f'path {self.path_id} was not followed to its end: no trajectory for '
                f'{1e-9 * self._timeout:g} s of machine time ({status}); {self._nodes} active?'
            )

    def ticks(self, period: float) -> int:
        """Return about how many periods [s] the whole programme takes."""
        return sum(self._usual_ticks(period))

    def ticks_done(self, period: float, arc_length: float) -> int:
        """Return how many of them are over at a place on the present path [m]."""
        usual = self._usual_ticks(period)
        before = sum(usual[: max(self._number, 0)])
        if not self.path_id:
            return before
        part = min(arc_length / self._lengths[self._number], 1.0)
        return before + int(part * usual[self._number])

    def _usual_ticks(self, period: float) -> list[int]:
        return [round(length / _USUAL_SPEED / period) for length in self._lengths]


def _unique(names: Sequence[str], index: int) -> str:
    """Return the name of a path; one that is loaded again gets a number."""
    count = list(names[:index]).count(names[index])
    return f'{names[index]}_{count + 1}' if count else names[index]

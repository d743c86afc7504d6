# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The hand-shake with a control that takes sets of lines, and who else takes part in it.

A set is written as a whole and gets a number; the next one waits until the control has
acknowledged it.  Whatever stands in the variables and was not written here is another writer's.
"""

from collections import deque

import numpy as np

from fuzzycnc_ros.adapters.opcua.offset_lines import LineOrders, LineStatus
from fuzzycnc_ros.core.inputs.lines import Lines
from fuzzycnc_ros.runtime.records import SECOND, Floats, nanoseconds

NUMBERS = 32767
"""Numbers go from 1 to this and begin anew, so that a 16-bit integer holds them; 0 is nobody."""
REMEMBERED = 16
"""Greatest lag of the numbers in the variables: some controls show what was written late."""
FINE = 1e-8
"""Change of an offset that is worth a new set [m]."""
COLLISION_PAUSE = 10.0
"""Time without any writer that must follow a collision of two [s]."""


class HandShake:
    """Number sets and heartbeats; know them again in what is read.

    Parameters
    ----------
    validity : float
        How long the control may follow a set without a newer one [s].
    """

    def __init__(self, validity: float) -> None:
        self._validity = validity
        self._sequences: deque[int] = deque(maxlen=REMEMBERED)
        self._heartbeats: deque[int] = deque(maxlen=REMEMBERED)
        self._ends: Floats | None = None
        self._lines: Lines | None = None
        self._stood: bytes | None = None
        self._written_at = 0
        self._acknowledged = True

    @property
    def sequence(self) -> int:
        """Number of the newest set; 0 before the first."""
        return self._sequences[-1] if self._sequences else 0

    @property
    def lines(self) -> Lines | None:
        """The newest set; None before the first."""
        return self._lines

    def begin(self, time: int, status: LineStatus) -> None:
        """Take hold at `time` [ns], with numbers that another bridge will hardly use."""
        start = 1 + (time // 1000) % NUMBERS
        while _next(start) in (status.sequence, status.acknowledged):
            start = _next(start)
        self.forget()
        # What stands is not another's until it changes.
        self._sequences.extend((status.sequence, start))
        self._heartbeats.extend((status.heartbeat, start))

    def forget(self) -> None:
        """Know nothing again that was written here."""
        self._sequences.clear()
        self._heartbeats.clear()
        self._ends = self._lines = self._stood = None
        self._acknowledged = True

    def await_no_more(self) -> None:
        """Let the next set come though the newest is not acknowledged: it may not be written."""
        self._acknowledged = True

    def wrote(self, status: LineStatus) -> bool:
        """Return True if the values in the variables were written here."""
        if status.sequence not in self._sequences or status.heartbeat not in self._heartbeats:
            return False
        if status.sequence == self.sequence:
            while len(self._sequences) > 1:  # what stood before it is over
                self._sequences.popleft()
        # Compared is what was read: a variable may hold less than was written.
        stands = values_of(status)
        if self._stood is None and self.acknowledged(status):
            self._stood = stands
        return self._stood is None or status.sequence != self.sequence or stands == self._stood

    def acknowledged(self, status: LineStatus) -> bool:
        """Return True if the control follows the newest set."""
        return self._lines is not None and status.acknowledged == self.sequence

    def waits(self, time: int) -> float:
        """Return how long the newest set has not been acknowledged [s]; 0 if it is."""
        return 0.0 if self._acknowledged else (time - self._written_at) / SECOND

    def orders(self, lines: Lines, ends: Floats, status: LineStatus, time: int) -> LineOrders:
        """Return what to write so that the control goes to `lines`, with `ends` at their ends."""
        self._acknowledged = self._acknowledged or self.acknowledged(status)
        self._heartbeats.append(_next(self._heartbeats[-1]))
        if self._acknowledged and self._is_news(ends, time):
            self._sequences.append(_next(self.sequence))
            self._lines, self._ends, self._stood = lines, ends, None
            self._written_at, self._acknowledged = time, False
        assert self._lines is not None, 'the first set is always news'
        return LineOrders(
            lines=self._lines,
            sequence=self.sequence,
            heartbeat=self._heartbeats[-1],
            validity=self._validity,
        )

    def _is_news(self, ends: Floats, time: int) -> bool:
        if self._ends is None:
            return True
        changed = np.any(np.abs(ends - self._ends) > FINE)
        cleared = np.any(self._ends) and not np.any(ends)
        due = time - self._written_at >= nanoseconds(self._validity / 3.0)
        return bool(changed or cleared or due)


class WriterWatch:
    """Tell whether others write, by whether anything moves that is not ours.

    Parameters
    ----------
    quiet : float
        How long nothing must have moved before somebody else may take hold [s].
    """

    def __init__(self, quiet: float) -> None:
        self._quiet = nanoseconds(quiet)
        self._seen: tuple[object, ...] | None = None
        self._since = 0
        self._from = 0  # nobody may take hold before
        self._moved = False
        self._name = ''

    @property
    def other(self) -> str:
        """Name of another writer that was seen; empty if none was."""
        return self._name if self._moved else ''

    def look(self, time: int, status: LineStatus, *, ours: bool) -> None:
        """Take what stands in the variables at `time` [ns]."""
        seen = (status.sequence, status.heartbeat, status.writer, values_of(status))
        if ours:
            self._moved, self._since = False, time - self._quiet
        elif self._seen is None:
            self._since = time
        elif seen != self._seen:
            self._since = time
            if time < self._from:
                self._from = time + nanoseconds(COLLISION_PAUSE)
            # Whoever gives the hand-shake back writes no more.
            self._moved = self._moved or status.sequence != 0
            if status.sequence != 0:
                who = status.writer or 'an unnamed writer'
                self._name = f'{who} (set {status.sequence})'
        if time - self._since >= self._quiet and time >= self._from:
            self._moved = False
        self._seen = seen

    def collide(self, time: int) -> None:
        """Note that another one wrote while we did: both have to let go."""
        self._from, self._moved = time + nanoseconds(COLLISION_PAUSE), True

    def free(self, time: int, status: LineStatus) -> bool:
        """Return True if there is no writer: the hand-shake was given back, or has stood still."""
        if self._seen is None or self._moved or time < self._from:
            return False
        return status.sequence == 0 or time - self._since >= self._quiet


def values_of(status: LineStatus) -> bytes:
    """Return the set that stands, to be compared."""
    lines = status.lines
    return np.concatenate([lines.offset, lines.slope, lines.reference_position]).tobytes()


def _next(number: int) -> int:
    return number % NUMBERS + 1

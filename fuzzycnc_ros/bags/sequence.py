# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Counting lost messages by the publication sequence numbers of those that came."""

from collections.abc import Callable, Hashable

MODULUS = 2**64
"""The numbers of rmw are 64 bits wide and then start anew."""

UNSUPPORTED = 2**64 - 1
"""What rmw states where a middleware has no sequence numbers."""


SILENT = 3
"""Publishers that are gone are those that were silent while each other spoke so often."""


class SequenceCounter:
    """Gaps in the sequence numbers of one topic.

    Parameters
    ----------
    publishers : callable, optional
        Says how many publishers the topic has now; 0 where that is not known yet.

    Attributes
    ----------
    missing : int
        Messages whose numbers were jumped over.
    streams : int
        Publishers that were told apart, those that are gone included.

    Notes
    -----
    Every publisher counts its own messages, from any start.  Where the caller can tell the
    publishers apart it names them.  rclpy cannot: it hands on numbers without the publisher that
    they are of.  Then a number is taken to continue the publisher whose last number lies closest
    below it, of two alike the one that spoke last; and one that lies below all of them, or is 0
    or 1, begins another publisher (or is one that restarted).

    Where it is known how many publishers there are, a jump while one of them has not been heard
    yet is its beginning, not a gap: a reader that comes late hears the first of each with a high
    number.  Without that a publisher that joins with a high number is counted as a gap, since a
    loss reported in vain is better than one passed over.  Where more were heard than there are,
    those that have been silent for long while the others spoke are gone, and nothing continues
    them.

    Examples
    --------
    >>> counter = SequenceCounter()
    >>> for number in (1, 2, 5, 6):
    ...     counter.update(number)
    >>> counter.missing
    2

    Two publishers that a late reader hears:

    >>> counter = SequenceCounter(lambda: 2)
    >>> for number in (41, 57, 42, 58):
    ...     counter.update(number)
    >>> counter.missing
    0
    """

    def __init__(self, publishers: Callable[[], int] | None = None) -> None:
        self.missing = 0
        self.streams = 0
        self._publishers = publishers
        self._last: dict[Hashable, int] = {}  # by publisher, the one that spoke last at the end
        self._count = 0  # numbers taken
        self._spoke: dict[Hashable, int] = {}  # count at the newest number of each

    def update(self, number: int | None, publisher: Hashable = None) -> None:
        """Take the sequence number of one message.

        Parameters
        ----------
        number : int or None
            Publication sequence number; None or 2^64 - 1 if there is none.
        publisher : hashable, optional
            Who sent it, where that is known.
        """
        if number is None or number == UNSUPPORTED:
            return
        key = publisher if publisher is not None else self._closest(number)
        last = self._last.pop(key, None)
        if last is None:
            self.streams += 1
        else:
            gap = (number - last - 1) % MODULUS
            if gap < MODULUS // 2:  # else the publisher restarted or repeated itself
                self.missing += gap
        self._last[key] = number
        self._count += 1
        self._spoke[key] = self._count

    def _closest(self, number: int) -> Hashable:
        """Return the anonymous publisher that a number continues, or a new one."""
        another = ('anonymous', self.streams)
        known = self._known(number)
        best: Hashable = another
        best_gap = MODULUS // 2
        for key, last in reversed(self._last.items()):
            gap = (number - last - 1) % MODULUS
            if gap < best_gap:
                best, best_gap = key, gap
        if best_gap and (number <= 1 or 0 < len(self._last) < known):
            return another
        return best

    def _known(self, number: int) -> int:
        """Forget publishers that are gone; return how many there are, 0 if that is not known."""
        heard = len(self._last)
        if self._publishers is None or not heard:
            return 0
        if heard == 1 and number - next(iter(self._last.values())) == 1:
            return heard  # the usual case needs no look at the graph
        known = self._publishers()
        for key in list(self._last)[: max(0, heard - known) if known else 0]:
            if self._count - self._spoke[key] > SILENT * heard:
                del self._last[key], self._spoke[key]
        return known

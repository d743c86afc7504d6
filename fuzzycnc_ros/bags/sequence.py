# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Counting lost messages by the publication sequence numbers of those that came."""

from collections.abc import Hashable

MODULUS = 2**64
"""The numbers of rmw are 64 bits wide and then start anew."""

UNSUPPORTED = 2**64 - 1
"""What rmw states where a middleware has no sequence numbers."""


class SequenceCounter:
    """Gaps in the sequence numbers of one topic.

    Attributes
    ----------
    missing : int
        Messages whose numbers were jumped over.
    streams : int
        Publishers that were told apart.

    Notes
    -----
    Every publisher counts its own messages, from any start.  Where the caller can tell the
    publishers apart it names them.  rclpy cannot: then a number is taken to continue the
    publisher whose last number lies closest below it, and one that lies below all of them, or
    0 or 1, begins another publisher (or is one that restarted).  A publisher that joins a topic
    with a high first number while another is known cannot be told from a gap; it is counted as
    one, since a loss reported in vain is better than one passed over.

    Examples
    --------
    >>> counter = SequenceCounter()
    >>> for number in (1, 2, 5, 6):
    ...     counter.update(number)
    >>> counter.missing
    2
    """

    def __init__(self) -> None:
        self.missing = 0
        self._last: dict[Hashable, int] = {}

    @property
    def streams(self) -> int:
        """Number of publishers that were told apart."""
        return len(self._last)

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
        last = self._last.get(key)
        if last is not None:
            gap = (number - last - 1) % MODULUS
            if gap < MODULUS // 2:  # else the publisher restarted or repeated itself
                self.missing += gap
        self._last[key] = number

    def _closest(self, number: int) -> Hashable:
        """Return the anonymous publisher that a number continues, or a new one."""
        best, best_gap = ('anonymous', len(self._last)), MODULUS // 2
        for key, last in self._last.items():
            gap = (number - last - 1) % MODULUS
            if gap < best_gap:
                best, best_gap = key, gap  # type: ignore[assignment]
        starts = number <= 1 and best_gap > 0
        return ('anonymous', len(self._last)) if starts else best

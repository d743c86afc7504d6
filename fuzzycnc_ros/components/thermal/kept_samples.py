# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of a run in bounded memory, however many sensors there are and however fast they are."""

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from fuzzycnc_ros.runtime.records import Stamp, Temperatures

T = TypeVar('T')

SAMPLES_MAX = 20_000
"""Most samples that are kept: two weeks at one a minute."""
READINGS_MAX = 4_000_000
"""Most readings in them, each of 9 bytes: 4,000 samples of 1,000 sensors."""


class KeptSamples(Generic[T]):
    """Samples, each with what belongs to it; where there are too many, every second, fourth, ...

    So a run that was sampled too fast to be kept is known evenly from its beginning on, not only
    in its last minutes.

    Parameters
    ----------
    sample_of : callable
        Returns the temperatures in an item.

    Attributes
    ----------
    newest : T or None
        The newest sample, whether it stays or not.
    """

    def __init__(self, sample_of: Callable[[T], Temperatures]) -> None:
        self._sample_of = sample_of
        self.clear()

    def clear(self) -> None:
        """Drop all."""
        self._items: list[T] = []
        self.newest: T | None = None
        self._stride, self._passed_over = 1, 0

    def __len__(self) -> int:
        """Return how many samples stay."""
        return len(self._items)

    def __iter__(self) -> Iterator[T]:
        """Return an iterator over the samples that stay, oldest first."""
        return iter(self._items)

    def add(self, item: T) -> None:
        """Take a sample, which is newer than all others."""
        self.newest = item
        if self._passed_over:
            self._passed_over -= 1
            return
        self._items.append(item)
        self._passed_over = self._stride - 1
        most = max(2, READINGS_MAX // max(1, len(self._sample_of(item).sensor)))
        if len(self._items) > min(most, SAMPLES_MAX):
            self._passed_over += self._stride if len(self._items) % 2 else 0
            del self._items[1::2]
            self._stride *= 2

    def drop_before(self, stamp: Stamp) -> None:
        """Drop what is older than a stamp [ns], but for the newest of that."""
        while len(self._items) > 1 and self._sample_of(self._items[1]).stamp <= stamp:
            del self._items[0]

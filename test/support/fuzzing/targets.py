# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a component at work must offer so that hostile records can be sent to it."""

import random
from abc import ABC, abstractmethod
from copy import deepcopy
from functools import cached_property

from benches.component_bench import Bench

from fuzzycnc_ros.runtime.records import SECOND, Record


class Target(ABC):
    """A component at work.

    `good` returns a record of an input as it belongs; `recover` gives good records from a time on
    and asserts that they get good answers.
    """

    component: str
    """Name of the component."""
    inputs: tuple[str, ...]
    start = 1000 * SECOND
    """Stamp of the first record that may be hostile [ns]."""
    step = SECOND
    """Time between two records [ns]."""
    makes_time = False
    """Whether no stamp of a record moves its time on."""

    @abstractmethod
    def bench(self) -> Bench:
        """Return a component at work."""

    @abstractmethod
    def good(self, name: str, stamp: int, rng: random.Random) -> Record:
        """Return a record of an input."""

    def go_on(self, bench: Bench, stamp: int, until: int) -> int:
        """Work up to a time [ns]; return the stamp of the next records, at least that of these."""
        work(bench, max(until, bench.merger.time))
        return stamp + self.step

    @abstractmethod
    def recover(self, bench: Bench, stamp: int) -> None:
        """Assert that good records get good answers."""

    def check(self, bench: Bench) -> None:  # noqa: B027 - not all have more to hold
        """Assert what must hold for everything that was published."""


class CopiedTarget(Target):
    """A component that is made once; records are sent to copies of it."""

    @cached_property
    def prepared(self) -> Bench:
        """A component at work; only copies of it are used."""
        return self.make()

    def bench(self) -> Bench:
        """Return a component at work."""
        return deepcopy(self.prepared)

    @abstractmethod
    def make(self) -> Bench:
        """Make a component at work."""


def work(bench: Bench, stamp: int) -> None:
    """Work up to a stamp [ns]."""
    bench.emitted += bench.merger.advance(stamp)

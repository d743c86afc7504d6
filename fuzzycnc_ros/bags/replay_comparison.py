# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded against recomputed messages: canonical bytes first, else how far numbers are apart."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, fields
from math import inf
from typing import Any

import numpy as np

from fuzzycnc_ros.bags.canonical import canonical_message
from fuzzycnc_ros.bags.typestore import deserialize
from fuzzycnc_ros.runtime.convert import stamp_of
from fuzzycnc_ros.runtime.records import SECOND

ROUNDING = 1e-9
"""Relative difference that linear algebra on another processor may cause [-]."""


@dataclass(frozen=True)
class TopicComparison:
    """Recorded against recomputed messages of one topic."""

    topic: str
    recorded: int
    recomputed: int
    identical: int
    first_difference: str = ''
    largest_difference: float = 0.0
    """Largest relative difference of a number [-]; infinite if anything else differs."""

    @property
    def equal(self) -> bool:
        """Whether nothing differs."""
        return self.recorded == self.recomputed == self.identical

    @property
    def equivalent(self) -> bool:
        """Whether nothing differs but the rounding of another processor's arithmetic."""
        return self.equal or self.largest_difference <= ROUNDING


def compare_topic(
    topic: str, recorded: list[tuple[str, bytes]], recomputed: list[tuple[str, str, int, Any]]
) -> TopicComparison:
    """Compare recorded messages of a topic, type and bytes, with recomputed ones.

    Parameters
    ----------
    topic : str
        The topic.
    recorded : list
        Type and bytes of each message.
    recomputed : list
        Topic, type, stamp [ns] and message of each.
    """
    before, after = _by_stamp(recorded), _by_stamp((k, m) for _, k, _, m in recomputed)
    identical, difference, largest = 0, '', 0.0
    for key in sorted(set(before) | set(after)):
        if key not in before or key not in after:
            apart, what = inf, 'not recomputed' if key in before else 'not recorded'
        else:
            (kind, old), (_, new) = before[key], after[key]
            if old == new:
                identical += 1
                continue
            what = 'differs'
            apart = relative_difference(deserialize(old, kind), deserialize(new, kind))
        largest = max(largest, apart)
        difference = difference or f'{what}, at machine time {key[0] / SECOND:.3f} s'
    return TopicComparison(topic, len(recorded), len(recomputed), identical, difference, largest)


def _by_stamp(messages: Iterable[tuple[str, Any]]) -> dict[tuple[int, int], tuple[str, bytes]]:
    """Return type and canonical bytes by stamp [ns] and number among those of the stamp.

    One message that is missing must not make all that follow it look different.
    """
    seen: Counter[int] = Counter()
    found = {}
    for kind, message in messages:
        payload = canonical_message(message, kind)
        stamp = stamp_of(deserialize(payload, kind).header.stamp)
        found[stamp, seen[stamp]] = (kind, payload)
        seen[stamp] += 1
    return found


def relative_difference(first: Any, second: Any) -> float:
    """Return the largest relative difference [-] between two messages of rosbags.

    Infinite if a text, a count, a flag or a length differs, or a NaN stands against a number.
    """
    if isinstance(first, (float, np.ndarray)):
        a, b = np.asarray(first), np.asarray(second)
        if a.shape != b.shape:
            return inf
        if a.dtype.kind != 'f':
            return 0.0 if np.array_equal(a, b) else inf
        if not np.array_equal(np.isnan(a), np.isnan(b)):
            return inf
        size = np.maximum(np.abs(a), np.abs(b))
        apart = np.divide(np.abs(a - b), size, out=np.zeros_like(size), where=size > 0.0)
        return float(np.nanmax(apart, initial=0.0))
    if isinstance(first, (list, tuple)):
        if len(first) != len(second):
            return inf
        pairs = zip(first, second, strict=True)
        return max((relative_difference(a, b) for a, b in pairs), default=0.0)
    if isinstance(first, (str, int, bool)):
        return 0.0 if first == second else inf
    names = [item.name for item in fields(first)]
    return max(
        (relative_difference(getattr(first, n), getattr(second, n)) for n in names), default=0.0
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recognise samples that a model was trained on: a bottom-k sketch of hashed shingles.

A file name proves nothing: bags are copied, renamed and cut.  Each group of neighbouring samples
(a shingle) is hashed by its readings; the smallest hashes of a run are kept.  Whatever part of
the run is judged later has its share of them.

References
----------
[broder1997]
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import NUMBER_MAX
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.run import ThermalRun

SHINGLE = 4
"""Neighbouring measurements that are hashed together: single readings repeat by chance."""

KEPT = 256
"""Hashes that are kept of a run; with fewer shingles, all."""

DIGITS = 12
"""Hexadecimal digits of a hash."""

COPY_SHARE = 0.5
"""Share of common samples from which two runs are taken for one recording [-]."""


@dataclass(frozen=True)
class Fingerprint:
    """Fingerprint of the measured samples of a run.

    Parameters
    ----------
    run : str
        Name of the run.
    start, stop : float
        First and last time that was measured [s].
    sensor, channel : tuple of str
        Whose readings were hashed, in this order.
    hashes : tuple of str
        The smallest hashes of its shingles, sorted.
    complete : bool
        Whether these are all of them.
    """

    run: str
    start: float
    stop: float
    sensor: tuple[str, ...]
    channel: tuple[str, ...]
    hashes: tuple[str, ...]
    complete: bool

    @staticmethod
    def of(run: ThermalRun) -> 'Fingerprint':
        """Take the fingerprint of the samples of a run that have a displacement."""
        rows = _measured(run)
        start, stop = run.time[rows[[0, -1]]] if len(rows) else run.time[[0, -1]]
        found = sorted(set(_shingles(run, run.sensor, run.channel, rows)))
        return Fingerprint(
            run=run.name,
            start=float(start),
            stop=float(stop),
            sensor=run.sensor,
            channel=run.channel,
            hashes=tuple(found[:KEPT]),
            complete=len(found) <= KEPT,
        )

    def known(self, run: ThermalRun, inside: NDArray[np.bool_] | None = None) -> float:
        """Return the share of the measured samples of a run that the fingerprint knows [-].

        Parameters
        ----------
        run : ThermalRun
            Run as it was recorded, not averaged.
        inside : ndarray of bool, shape (n,), optional
            Samples to look at; all if absent.

        Returns
        -------
        float
            An estimate where the fingerprint is not complete; NaN where nothing can be said.
        """
        if not set(self.sensor) <= set(run.sensor) or not set(self.channel) <= set(run.channel):
            return np.nan
        rows = _measured(run)
        if inside is not None:
            rows = rows[inside[rows]]
        found = set(_shingles(run, self.sensor, self.channel, rows))
        if not self.complete:
            found = {item for item in found if item <= self.hashes[-1]}
        return len(found.intersection(self.hashes)) / len(found) if found else np.nan

    def shared(self, other: 'Fingerprint') -> float:
        """Return the share of another run's samples that this one has too [-], an estimate.

        Only hashes are compared, so that many runs can be looked through pair by pair.
        """
        cut = [item.hashes[-1] for item in (self, other) if not item.complete]
        least = min(cut, default='g')  # behind every hexadecimal digit
        found = {item for item in other.hashes if item <= least}
        return len(found.intersection(self.hashes)) / len(found) if found else 0.0

    def document(self) -> dict[str, Any]:
        """Return the fingerprint as JSON values."""
        return {
            'run': self.run,
            'start': self.start,
            'stop': self.stop,
            'sensor': list(self.sensor),
            'channel': list(self.channel),
            'hashes': list(self.hashes),
            'complete': self.complete,
        }

    @classmethod
    def read(cls, node: Node) -> 'Fingerprint':
        """Return the fingerprint of a document.

        Raises
        ------
        ModelFileError
            If a value is missing or of another type.
        """
        return cls(
            run=node.get('run').text(),
            start=node.get('start').number(-NUMBER_MAX, NUMBER_MAX),
            stop=node.get('stop').number(-NUMBER_MAX, NUMBER_MAX),
            sensor=node.get('sensor').texts(),
            channel=node.get('channel').texts(),
            hashes=node.get('hashes').texts(),
            complete=node.get('complete').boolean(),
        )


def recognised_in(
    fingerprints: Sequence[Fingerprint], run: ThermalRun, inside: NDArray[np.bool_] | None = None
) -> tuple[dict[str, float], bool]:
    """Return which runs measured samples of a run were trained on in, and whether that is all.

    Returns
    -------
    shares : dict of str to float
        Name of a training run -> its share of the samples [-], where there is one.
    complete : bool
        Whether every training run could be looked for.
    """
    shares: dict[str, float] = {}
    complete = bool(fingerprints)
    for item in fingerprints:
        share = item.known(run, inside)
        complete &= not np.isnan(share)
        if share > 0.0:
            # Runs of several folders may have one name.
            shares[item.run] = shares.get(item.run, 0.0) + share
    return shares, complete


def _measured(run: ThermalRun) -> NDArray[np.int64]:
    return np.flatnonzero(np.isfinite(run.displacement).any(axis=1))


def _shingles(
    run: ThermalRun, sensor: Sequence[str], channel: Sequence[str], rows: NDArray[np.int64]
) -> Iterator[str]:
    """Return the hash of each group of successive measurements in which something changes."""
    channels = [run.channel.index(name) for name in channel]
    temperature = run.temperature[rows][:, run.columns(sensor)]
    displacement = 1e6 * run.displacement[rows][:, channels]
    # Rounded, so that a recording that was written and read again is recognised.
    table = np.round(np.hstack([temperature, displacement]), 3) + 0.0
    table = np.where(np.isnan(table), np.inf, table)
    for first in range(len(table) - SHINGLE + 1):
        group = table[first : first + SHINGLE]
        if (group != group[0]).any():
            yield blake2b(group.tobytes(), digest_size=DIGITS // 2).hexdigest()


def copies(runs: Sequence[Fingerprint]) -> dict[int, str]:
    """Return the runs that are the recording of an earlier one, by their place, and why so.

    What is held out would be trained on.
    """
    found: dict[int, str] = {}
    for (_, first), (place, second) in combinations(enumerate(runs), 2):
        if place not in found and (share := first.shared(second)) > COPY_SHARE:
            found[place] = (
                f'run {second.run!r}: expected another recording than {first.run!r}, but '
                f'found {100.0 * share:.0f} % of its samples in it; leave one of them out'
            )
    return found

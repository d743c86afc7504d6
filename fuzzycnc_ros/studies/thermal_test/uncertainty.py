# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of a range, as the GUM combines it: each term with its source, none made up."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.thermal_test.evaluation import JudgedPhase, noise
from fuzzycnc_ros.studies.thermal_test.recording import TestRecording
from fuzzycnc_ros.studies.thermal_test.set_up import TestSetUp

COVERAGE = 2.0
"""Coverage factor of expanded uncertainties: about 95 % of normal errors."""

STATED = 'stated'


@dataclass(frozen=True)
class Term:
    """A contribution to the standard uncertainty of a range.

    Parameters
    ----------
    name, source, rule : str
        What it is, where its size comes from, and how the standard uncertainty follows from it.
    uncertainty : mapping of str to float
        Standard uncertainty of a range by probe [m]; NaN where it is not known.
    """

    name: str
    source: str
    rule: str
    uncertainty: Mapping[str, float]


@dataclass(frozen=True)
class Budget:
    """Uncertainty of the ranges of a test.

    Parameters
    ----------
    terms : tuple of Term
        What contributes.
    """

    terms: tuple[Term, ...]

    def missing(self, probe: str) -> list[str]:
        """Return the terms that nobody has stated and the bag does not show."""
        return [term.name for term in self.terms if not isfinite(term.uncertainty[probe])]

    def combined(self, probe: str) -> float:
        """Return the combined standard uncertainty of a range from the known terms [m].

        NaN where none is known.
        """
        known = [term.uncertainty[probe] for term in self.terms]
        squares = [size**2 for size in known if isfinite(size)]
        return sqrt(sum(squares)) if squares else nan

    def expanded(self, probe: str) -> float:
        """Return the expanded uncertainty of a range [m], k = 2."""
        return COVERAGE * self.combined(probe)


def find_budget(
    recording: TestRecording,
    probes: Mapping[str, int],
    set_up: TestSetUp,
    judged: Sequence[JudgedPhase],
) -> Budget:
    """Return the uncertainty of the ranges of a test.

    Parameters
    ----------
    recording : TestRecording
        The test.
    probes : mapping of str to int
        Column of each probe.
    set_up : TestSetUp
        What is stated of the instrument.
    judged : sequence of JudgedPhase
        Phases; those of the environment show how it drifts.
    """
    repeat, source = _repeatability(recording, probes, set_up)
    return Budget(
        (
            Term(
                'Instrument',
                STATED if isfinite(set_up.uncertainty) else '',
                'U / 2: expanded uncertainty with k = 2',
                dict.fromkeys(probes, set_up.uncertainty / COVERAGE),
            ),
            Term(
                'Probe repeat',
                source,
                's √2: a range has two readings',
                {name: sqrt(2.0) * size for name, size in repeat.items()},
            ),
            Term(
                'Resolution',
                STATED if isfinite(set_up.resolution) else '',
                'r √2 / √12: rectangular, two readings',
                dict.fromkeys(probes, set_up.resolution * sqrt(2.0 / 12.0)),
            ),
            _environment(probes, judged),
        )
    )


def _repeatability(
    recording: TestRecording, probes: Mapping[str, int], set_up: TestSetUp
) -> tuple[dict[str, float], str]:
    """Return the standard deviation of each probe [m], and where it comes from."""
    if isfinite(set_up.repeatability):
        return dict.fromkeys(probes, set_up.repeatability), STATED
    columns = list(probes.values())
    told = recording.deviation[:, columns]
    if np.isfinite(told).any(axis=0).all():
        return dict(
            zip(probes, np.sqrt(np.nanmean(told**2, axis=0)).tolist(), strict=True)
        ), 'bag: standard_deviation of displacement, root mean square'
    values = [recording.measured[:, column] for column in columns]
    found = [_scatter(column) for column in values]
    source = 'bag: scatter of neighbouring samples, by second differences'
    return dict(zip(probes, found, strict=True)), source if any(map(isfinite, found)) else ''


def _scatter(values: NDArray[np.float64]) -> float:
    """Return the noise of a probe [m], NaN if too few samples show it."""
    known = values[np.isfinite(values)]
    return noise(known) if len(known) >= 30 else nan


def _environment(probes: Mapping[str, int], judged: Sequence[JudgedPhase]) -> Term:
    """Return what the environment may have moved meanwhile, by the phases that show it alone."""
    phases = [item for item in judged if item.phase.kind == 'environment']
    largest = {
        name: max(
            (
                item.bare[name].whole.value
                for item in phases
                if isfinite(item.bare[name].whole.value)
            ),
            default=nan,
        )
        for name in probes
    }
    known = any(map(isfinite, largest.values()))
    shown = ', '.join(
        f'{item.phase.name} ({item.phase.duration / 3600.0:.2g} h)' for item in phases
    )
    return Term(
        "Environment's drift",
        f'bag: range in {shown}' if known else '',
        'range / √12: rectangular',
        {name: size / sqrt(12.0) for name, size in largest.items()},
    )

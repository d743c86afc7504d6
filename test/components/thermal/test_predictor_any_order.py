# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal predictor: whatever happens in whatever order, what it says stays sound.

Samples with lost sensors and gaps, probes good and bad, changes of models, restarts.
"""

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.predictor_bench import (
    MICRON,
    bench_with_model,
    model_text,
    probe_of,
    recordings,
    reference_of,
    sample_of,
)
from tiers import rest_slow

MODELS = ((), ('D0',), ('D0', 'T1'))
ROWS = 200


class Day:
    """A day on which anything may happen."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._run = recordings()[self._one_of('T2', 'T3')]
        self._changes = {
            'learn': self._one_of(False, True),
            'swap_time': self._one_of(60.0, 300.0, 900.0),
            'settle_time': self._one_of(600.0, 3600.0),
            'gap_max': 600.0,
        }
        self._bench = bench_with_model(model_text(*self._one_of(*MODELS)), **self._changes)

    def live(self) -> int:
        """Live through it; return how many errors were valid."""
        row, valid = 0, 0
        while row < ROWS:
            if row == 2:
                self._bench.push('thermal_reference', reference_of(self._run))
            elif row > 2:
                self._probe(row)
                self._disturb()
            before = len(self._bench.records('thermal_error'))
            self._bench.give('temperatures', sample_of(self._run, row, self._lost()))
            (error,) = self._bench.records('thermal_error')[before:]
            self._check(error)
            valid += error.valid
            gap = row > 2 and self._chance(0.02)
            row += 1 + gap * int(self._random.integers(1, 15))
        return valid

    def _check(self, error) -> None:
        if not error.valid:
            assert error.reason
            assert np.isnan(error.error).all()
            return
        assert np.isfinite(error.error).all()
        assert (np.abs(error.error) < 200.0 * MICRON).all()
        assert (error.standard_deviation > 0.0).all()
        state = self._bench.records('predictor_state')[-1]
        assert state.stamp == error.stamp
        assert np.isfinite(state.state).all()

    def _probe(self, row: int) -> None:
        if self._chance(0.1):
            measured = self._run.displacement[row] * (1.0 + self._random.normal(0.0, 0.2))
            measured = measured + 60.0 * MICRON * self._chance(0.1)
            if self._chance(0.2):
                measured[0] = np.nan
            later = -float(self._random.integers(0, 50))
            self._bench.push(
                'displacement', probe_of(self._run, row, later=later, displacement=measured)
            )

    def _disturb(self) -> None:
        if self._chance(0.05):
            assert self._bench.request('use_model', model=model_text(*self._one_of(*MODELS)))
        if self._chance(0.02):
            self._restart()
        assert self._bench.health()

    def _restart(self) -> None:
        before: Bench = self._bench
        self._bench = bench_with_model(before.component.model_text, **self._changes)
        saved = before.records('predictor_state')
        if saved:
            self._bench.component.restore('predictor_state', saved[-1])
        self._bench.push('thermal_reference', reference_of(self._run))

    def _lost(self) -> tuple[str, ...]:
        if self._chance(0.05):
            share = self._one_of(0.3, 0.6, 1.0)
            return tuple(name for name in self._run.sensor if self._chance(share))
        return ()

    def _chance(self, share: float) -> bool:
        return bool(self._random.random() < share)

    def _one_of(self, *options):
        return options[int(self._random.integers(len(options)))]


@pytest.mark.parametrize('seed', rest_slow(range(8), 0, 1, 2))
def test_any_day_ends_well(seed):
    assert Day(seed).live() > 20

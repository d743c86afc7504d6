# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sequential test of whether probes see an offset as it is."""

from itertools import accumulate

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.confirmation import is_right, is_wrong, judged

OFFSET = 10e-6


def evidence_of(missed, offset=OFFSET, deviation=1e-6):
    """Return the evidence after each probe that misses its prediction by so much [m]."""
    return np.array(
        list(accumulate(missed, lambda e, m: judged(e, m, deviation, offset), initial=0.0))
    )


@pytest.mark.parametrize(('factor', 'right'), [(1.0, True), (-1.0, False), (25.4, False)])
def test_probes_that_see_an_offset_as_it_is_are_told_apart(factor, right):
    noise = np.random.default_rng(3).normal(0.0, 1e-6, 6)
    evidence = evidence_of((1.0 - factor) * OFFSET + noise)
    assert is_right(evidence[-1:]).item() is right
    assert is_wrong(evidence[-1:]).item() is not right


def test_an_offset_below_the_deviation_says_nothing():
    assert np.abs(evidence_of([0.0, 1e-6, -1e-6], offset=0.2e-6)).max() < 0.1


def test_what_was_right_by_chance_is_contradicted_later():
    evidence = evidence_of([0.0] * 20 + [OFFSET] * 3)
    assert is_right(evidence[1:-3]).all()
    assert is_wrong(evidence[-1:]).item()


def test_one_chip_does_not_contradict_and_wrong_stays_wrong():
    assert not is_wrong(evidence_of([0.0, 0.0, OFFSET])).any()
    assert is_wrong(evidence_of([OFFSET] * 2 + [0.0] * 9)[-1:]).item()

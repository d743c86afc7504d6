# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The quilter of the scenario `shift`: gains of a first piece on sheets unlike the mean."""

import pytest

from fuzzycnc_ros.cli.demo.shift_quilter import (
    PATTERN_BAGS,
    first_piece,
    pattern_alone,
    trained_foam,
)
from fuzzycnc_ros.studies.soft.pattern import PatternLog

pytestmark = pytest.mark.replay


@pytest.mark.slow
@pytest.mark.parametrize('seed', [3, pytest.param(20, marks=pytest.mark.qualify)])
def test_a_first_piece_tells_what_the_sheet_is_like(tmp_path, seed):
    """Of thirty seeds the model as trained does worst on 3, the adapted one on 20."""
    foam = trained_foam(seed)
    adapted = first_piece(tmp_path, foam, seed)
    assert (tmp_path / 'foam.json').read_text() == adapted
    pattern_alone(tmp_path / PATTERN_BAGS['trained'], foam, seed)
    pattern_alone(tmp_path / PATTERN_BAGS['after'], adapted, seed)
    before, trained, after = (
        PatternLog.from_bag(tmp_path / folder).patterns()[0].quality()
        for folder in PATTERN_BAGS.values()
    )
    assert after.angle_error <= 0.07 * before.angle_error
    assert after.max_deviation <= trained.max_deviation <= before.max_deviation
    if seed == 3:
        assert trained.angle_error > 0.2 * before.angle_error > after.angle_error

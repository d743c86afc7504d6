# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of a trial: directions, densities and order, apart on the sheet."""

from itertools import combinations

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.trial_lines import APART, trial_plan, trial_runs

SIZE = (0.2, 0.12)


@pytest.mark.parametrize('directions', [3, 6, 8, 24])
def test_a_plan_has_all_directions_other_densities_and_a_repetition(directions):
    plan = trial_plan(directions, 3e-3)
    usual = {round(float(np.degrees(line.direction)) % 180.0, 6) for line in plan}
    wanted = {round(180.0 * k / directions, 6) for k in range(directions)}
    assert usual == wanted
    assert {round(1e3 * line.step, 2) for line in plan} == {2.01, 3.0, 4.5}
    assert plan[-2:] == plan[:2]
    assert any(line.direction >= np.pi for line in plan)


def test_lines_are_50_mm_long_apart_and_amid_the_sheet():
    runs = trial_runs(trial_plan(8, 3e-3), SIZE, 16e-3)
    assert len(runs) == 14
    for run in runs:
        assert np.hypot(*(run[-1] - run[0])) == pytest.approx(0.05, abs=3e-3)
    for one, other in combinations(runs, 2):
        apart = one[:, np.newaxis] - other
        assert np.hypot(apart[..., 0], apart[..., 1]).min() > 0.8 * APART
    everything = np.concatenate(runs)
    np.testing.assert_allclose(everything.min(axis=0) + everything.max(axis=0), SIZE)
    assert (everything > 10e-3).all()


def test_a_small_sheet_is_refused():
    with pytest.raises(ValueError, match='larger sheet or fewer directions'):
        trial_runs(trial_plan(8, 3e-3), (0.1, 0.1), 16e-3)

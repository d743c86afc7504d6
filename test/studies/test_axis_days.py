# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Days of a mill with ball screws: what is left along the travel, by a model and by probes."""

import pytest

from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.studies.shift.axis_days import (
    INTERVAL,
    WORK,
    axis_line,
    axis_page,
    axis_table,
    calibrated,
    run_axis_days,
)


@pytest.mark.slow
def test_two_calibration_runs_take_most_of_the_error_off_along_the_travel():
    model = train_model(
        calibrated(11).runs, candidates=('static_ridge', 'lag_ridge'), interval=INTERVAL
    )
    assert model.prior is not None
    assert model.prior.basis.axes == ('Y', 'Z')
    (day,) = run_axis_days((WORK,), 12, model=model.to_json())
    for item in day:
        figures = item.figures()
        assert figures['uncompensated_max_um'] > 50.0
        assert figures['beyond_best_line_max_um'] < 5.0
        assert figures['in_band'] >= 0.9
    assert len(axis_table([day]).rows) == 2
    assert axis_page([day], {}).summary == axis_line([day])


@pytest.mark.slow
def test_three_places_tell_how_far_a_short_stroke_bends_the_error():
    places = (-0.5, -0.25, 0.0)
    (day,) = run_axis_days(('axis_short',), 12, places=places, cautious=False)
    figures = day[0].figures(9000.0)
    assert figures['beyond_best_line_max_um'] < 8.0
    told, true = figures['line_leaves_told_um'], figures['best_line_max_um']
    assert abs(told - true) < 0.4 * true

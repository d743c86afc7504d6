# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The classical grey model against worked textbook examples."""

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.fit import GreyModel
from fuzzycnc_ros.core.thermal.fit.grey import constant_input

GM11 = [
    (
        [2.874, 3.278, 3.337, 3.39, 3.679],
        -0.037204,
        3.065363,
        [2.874, 3.232039, 3.35455, 3.481704, 3.613679],
    ),
    (
        [71.1, 72.4, 72.4, 72.1, 71.4, 72.0, 71.6],
        0.002344,
        72.65727,
        [71.1, 72.405741, 72.236237, 72.067129, 71.898416, 71.730099, 71.562176],
    ),
]


@pytest.mark.paper
@pytest.mark.parametrize(('series', 'a', 'b', 'fit'), GM11)
def test_gm11(series, a, b, fit):
    model = GreyModel('classical').fit(None, series)
    assert model.a_ == pytest.approx(a, rel=1e-5, abs=1e-6)
    assert model.b_[0] == pytest.approx(b, rel=1e-5)
    assert np.allclose(
        model.predict(constant_input(len(series)), initial=series[0]), fit, rtol=1e-5
    )


@pytest.mark.paper
def test_gm12():
    target = [2.874, 3.278, 3.307, 3.39, 3.679]
    driver = np.array([[7.04], [7.645], [8.075], [8.53], [8.774]])
    model = GreyModel('classical').fit(driver, target)
    assert model.a_ == pytest.approx(2.227297, rel=1e-5)
    assert model.b_[0] == pytest.approx(0.906681, rel=1e-5)


@pytest.mark.paper
def test_the_growing_example_is_flagged():
    series, a, _, _ = GM11[0]
    model = GreyModel('classical').fit(None, series)
    assert a < 0.0
    assert not model.stable_
    assert 'not positive' in model.problems_[0]


def test_gm11_is_refused_where_it_has_no_meaning():
    with pytest.raises(ValueError, match=r'GM\(1,1\)'):
        GreyModel('stable').fit(None, GM11[0][0])
    with pytest.raises(ValueError, match=r'GM\(1,1\)'):
        GreyModel('classical').fit(None, GM11[0][0], runs=[0, 0, 0, 1, 1])

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermistors: both curves, either side of the divider, and what is none."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.thermal.ntc import Ntc

# Vishay NTCLE100E3103: R25 = 10 kohm, B25/85 = 3977 K; printed resistances [ohm].
PRINTED = {0.0: 32554.0, 25.0: 10000.0, 50.0: 3606.0, 85.0: 1070.0}
RAW = st.floats(allow_nan=True, allow_infinity=True)


def fitted():
    """Return the coefficients through three printed resistances, as of a data sheet."""
    rows = [(1.0, math.log(r), math.log(r) ** 3) for r in (32554.0, 10000.0, 3606.0)]
    right = [1.0 / (t + 273.15) for t in (0.0, 25.0, 50.0)]
    numpy = pytest.importorskip('numpy')
    return numpy.linalg.solve(rows, right)


def test_beta_joins_the_two_printed_points_that_it_is_of():
    ntc = Ntc.of_beta(3977.0, 10e3)
    assert ntc.temperature(10e3) == pytest.approx(25.0)
    assert ntc.temperature(PRINTED[85.0]) == pytest.approx(85.0, abs=0.05)


def test_steinhart_and_hart_goes_through_its_points():
    ntc = Ntc(*fitted())
    for at in (0.0, 25.0, 50.0):
        assert ntc.temperature(PRINTED[at]) == pytest.approx(at, abs=1e-9)
    assert ntc.temperature(PRINTED[85.0]) == pytest.approx(85.0, abs=0.1)


@given(st.floats(-40.0, 150.0), st.sampled_from([5.0, 1023.0, 4095.0]), st.booleans())
def test_a_divider_is_undone_on_either_side(at, supply, low_side):
    ntc = Ntc.of_beta(3950.0, 10e3, fixed=4700.0, supply=supply, low_side=low_side)
    ohms = 10e3 * math.exp(3950.0 * (1.0 / (at + 273.15) - 1.0 / 298.15))
    share = ohms / (ohms + 4700.0)
    raw = supply * (share if low_side else 1.0 - share)
    assert ntc.temperature(raw) == pytest.approx(at, abs=1e-6)


@given(RAW, st.sampled_from([0.0, 4700.0]), st.booleans())
def test_any_raw_value_is_a_temperature_of_a_thermistor_or_none(raw, fixed, low_side):
    found = Ntc.of_beta(3950.0, 10e3, fixed=fixed, supply=1023.0, low_side=low_side)
    value = found.temperature(raw)
    assert math.isnan(value) or -80.0 <= value <= 400.0


@pytest.mark.parametrize('raw', [0.0, 1023.0, 1022.9, -1.0, 2000.0, math.nan])
def test_broken_wire_and_short_circuit_are_none(raw):
    assert math.isnan(Ntc.of_beta(3950.0, 10e3, fixed=4700.0, supply=1023.0).temperature(raw))

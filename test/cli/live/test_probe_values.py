# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What `operate probe` reads: displacements, and the places where they were measured."""

from math import isnan

import pytest

from fuzzycnc_ros.cli.live.operate import _displacements
from fuzzycnc_ros.ros.probing import probe_record


def test_places_are_positions_in_machine_coordinates():
    found = _displacements(['X=3um@-400mm', 'X=-52um@0mm', 'Z=0.012mm'])
    assert found[:2] == [('X', pytest.approx(3e-6), -0.4), ('X', pytest.approx(-52e-6), 0.0)]
    assert found[2][:2] == ('Z', pytest.approx(12e-6))
    assert isnan(found[2][2])
    record = probe_record('mill', found, 1e-6, compensated=True)
    assert record.axis == ('X', 'X', 'Z')
    assert record.channel == ('X@-400mm', 'X@0mm', 'Z')
    assert record.position[:2].tolist() == [-0.4, 0.0]
    assert isnan(record.position[2])


def test_a_probe_without_places_is_as_before():
    record = probe_record('mill', {'Y': 1e-6}, float('nan'), compensated=False)
    assert (record.axis, record.channel) == (('Y',), ('Y',))
    assert isnan(record.position[0])


@pytest.mark.parametrize(
    ('values', 'said'),
    [
        (['X=3um@-400'], 'expected a unit'),
        (['Y=-2'], "Y: expected a unit, .* but found '-2'; such as -3um"),
        (['Y=-2,5um', 'Z=1um'], "Y: .*'-2,5um'; decimals take a point, as in -2.5um"),
        (['X=3um@-400,5mm'], "'-400,5mm'; decimals take a point"),
        (['X=3um@far'], 'expected a number with a unit'),
        (['X=3um@500m'], 'expected a position within 100 m'),
        (['X=3um@0mm', 'X=4um@0mm'], 'X twice'),
        (['X=3um', 'X=4um@0mm'], 'X twice'),
        (['X=3um@0mm', 'X=4um'], 'X twice'),
        (['X3um@0mm'], 'expected AXIS=LENGTH'),
    ],
)
def test_refusals(values, said):
    with pytest.raises(ValueError, match=said):
        _displacements(values)

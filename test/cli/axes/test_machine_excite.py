# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc machine excite`: programs that stay within their limits, and refusals."""

import re

import numpy as np
import pytest

LIMITS = ('--low', '0mm', '--high', '300mm', '--speed', '100mm/s', '--acceleration', '500mm/s^2')


def test_set_points_keep_to_travel_speed_and_acceleration(fuzzycnc, tmp_path):
    outcome = fuzzycnc('machine', 'excite', 'x.csv', *LIMITS, '--seconds', '6s')
    assert outcome.code == 0, outcome.err
    assert 'dead time and a resonance up to about 160 Hz' in outcome.out
    time, place = np.loadtxt(tmp_path / 'x.csv', delimiter=',', skiprows=1).T
    assert np.allclose(np.diff(time), 1e-3, atol=1e-6)
    assert place.min() >= 0.0
    assert place.max() <= 300.0
    speed = np.diff(place) / 1e-3
    assert np.abs(speed).max() <= 101.0
    # digits of the file aside
    rise = np.diff(speed) / 1e-3
    assert np.percentile(np.abs(rise), 99.9) <= 540.0
    # the chirp is there: the last third moves far above the carrier
    spectrum = np.abs(np.fft.rfft(rise[len(rise) // 2 :]))
    frequency = np.fft.rfftfreq(len(rise) - len(rise) // 2, 1e-3)
    assert spectrum[(frequency > 20.0) & (frequency < 150.0)].max() > 100.0


def test_duties_stay_within_their_share(fuzzycnc, tmp_path):
    outcome = fuzzycnc('machine', 'excite', 'd.csv', *LIMITS, '--duty', '30%', '--seconds', '4s')
    assert outcome.code == 0, outcome.err
    _, duty = np.loadtxt(tmp_path / 'd.csv', delimiter=',', skiprows=1).T
    assert 0.25 < np.abs(duty).max() <= 0.3


def test_a_program_moves_its_axis_alone(fuzzycnc, tmp_path):
    outcome = fuzzycnc('machine', 'excite', 'y.ngc', *LIMITS, '--axis', 'Y', '--seconds', '3s')
    assert outcome.code == 0, outcome.err
    assert 'up to about 40 Hz' in outcome.out
    text = (tmp_path / 'y.ngc').read_text()
    assert text.rstrip().endswith('M2')
    assert 'X' not in text.partition('G21')[2]
    places = [float(one) for one in re.findall(r'Y(-?[\d.]+)', text)]
    assert 0.0 <= min(places) < max(places) <= 300.0


def test_limits_of_a_machine_file_count(fuzzycnc, tmp_path):
    outcome = fuzzycnc(
        'machine', 'excite', 'x.csv', '--machine-file', 'ballscrew', '--seconds', '2s'
    )
    assert outcome.code == 0, outcome.err
    assert (tmp_path / 'x.csv').stat().st_size > 10000


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['x.txt', *LIMITS], ['x.txt', '.ngc or .csv']),
        (['x.ngc', *LIMITS, '--duty', '30%'], ['--duty', 'commands positions']),
        (['x.csv'], ['--low', '-100mm', '--machine-file']),
        (['x.csv', *LIMITS, '--high', '-5mm'], ['--high', '-5']),
        (['x.csv', *LIMITS, '--speed', '-5mm/s'], ['velocity', '-0.005']),
        (['x.csv', *LIMITS, '--to', '900Hz'], ['--to', '400 Hz', '900Hz']),
        (['x.csv', '--machine-file', 'mill', '--axis', 'Q'], ['--axis', "'Q'"]),
    ],
)
def test_refusals_name_the_thing(fuzzycnc, arguments, said):
    outcome = fuzzycnc('machine', 'excite', *arguments)
    assert outcome.code == 2
    for word in said:
        assert word in outcome.err

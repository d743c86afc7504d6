# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Runs with the other sign are found, whole or in one channel, and sound ones are not accused."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.cli.models.recorded_runs import doubt_lines
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.core.thermal.turned import turned_channels
from fuzzycnc_ros.simulation.thermal.duties import record_runs
from fuzzycnc_ros.simulation.thermal.grinder_runs import record_grinder

TIME = 60.0 * np.arange(240)
SOURCES = {'spindle': (1.0, 0.1), 'hall': (0.1, 1.0), 'both': (0.7, 0.6)}


def lathe_run(name, share, seed=0):
    """Return a run of a lathe: X falls with the spindle's warmth and grows with the hall's."""
    rng = np.random.default_rng(seed)
    spindle = share[0] * 12.0 * (1.0 - np.exp(-TIME / 1800.0))
    hall = share[1] * 6.0 * np.sin(TIME / 9000.0)
    rises = np.column_stack([spindle, hall, 0.5 * spindle + 0.5 * hall])
    moved = 1e-6 * np.column_stack([-3.0 * spindle + 6.0 * hall, 2.0 * spindle + hall])
    return ThermalRun(
        name,
        TIME,
        ('head', 'bed', 'post'),
        20.0 + rises + 0.03 * rng.standard_normal(rises.shape),
        ('x', 'z'),
        ('X', 'Z'),
        moved + 0.1e-6 * rng.standard_normal(moved.shape),
    )


def turned(runs, row, channel=slice(None)):
    moved = runs[row].displacement.copy()
    moved[:, channel] *= -1.0
    return [*runs[:row], replace(runs[row], displacement=moved), *runs[row + 1 :]]


LATHE = [lathe_run(name, share, seed) for seed, (name, share) in enumerate(SOURCES.items())]
SIX = LATHE + [lathe_run(f'{name} 2', share, 9) for name, share in SOURCES.items()]


def test_runs_of_other_duties_are_not_accused():
    rise = [run.rise().mean(axis=1) for run in LATHE]
    signs = [
        np.sign(np.corrcoef(r, run.displacement[:, 0])[0, 1])
        for r, run in zip(rise, LATHE, strict=True)
    ]
    assert set(signs) == {-1.0, 1.0}  # against the mean rise, which says nothing
    assert turned_channels(LATHE) == turned_channels(SIX) == []


@pytest.mark.parametrize('row', range(6))
def test_a_whole_run_with_the_other_sign_is_found(row):
    (found,) = turned_channels(turned(SIX, row))
    assert (found.channel, found.run) == (('x', 'z'), (SIX[row].name,))
    assert found.correlation < -0.9
    assert found.left < 0.05 < 0.2 < found.unexplained


@pytest.mark.parametrize('row', range(6))
@pytest.mark.parametrize('channel', [0, 1])
def test_one_channel_with_the_other_sign_is_found(row, channel):
    (found,) = turned_channels(turned(SIX, row, channel))
    assert (found.channel, found.run) == (('xz'[channel],), (SIX[row].name,))


def test_two_of_six_runs_are_found_and_of_two_either():
    (found,) = turned_channels(turned(turned(SIX, 1), 4))
    assert found.run == ('hall', 'hall 2')
    pair = [SIX[2], SIX[5]]
    (line,) = doubt_lines(turned(pair, 1))
    assert line.startswith('both 2 or both: all channels move against what the other runs predict')
    assert 'import both 2 or both anew with the other sign of the axis' in line


@pytest.mark.parametrize('seed', [0, pytest.param(5, marks=pytest.mark.slow)])
@pytest.mark.parametrize('record', [record_runs, record_grinder])
def test_simulated_machines(record, seed):
    runs = list(record(seed=seed).values())
    assert turned_channels(runs) == []
    for row, run in enumerate(runs):
        (found,) = turned_channels(turned(runs, row))
        assert found.run == (run.name,)


def test_runs_that_tell_nothing_are_not_asked():
    still = replace(LATHE[0], name='still', displacement=np.zeros((240, 2)))
    cold = replace(LATHE[1], name='cold', temperature=20.0 + 0.01 * LATHE[1].rise())
    few = turned(LATHE, 2)[2]
    measured = np.where(np.arange(240)[:, np.newaxis] < 7, few.displacement, np.nan)
    runs = [SIX[3], still, cold, replace(few, name='few', displacement=measured)]
    assert turned_channels(runs) == []


def test_sensors_that_tell_little_of_the_motion_tell_no_sign():
    rng = np.random.default_rng(3)
    blind = [
        replace(run, displacement=1e-5 * rng.standard_normal((240, 2)).cumsum(0) / 10)
        for run in SIX
    ]
    assert turned_channels(turned(blind, 0)) == []
    lame = [replace(run, sensor=('head',), temperature=run.temperature[:, :1]) for run in SIX]
    lame[0] = replace(lame[0], temperature=np.full((240, 1), np.nan))
    assert turned_channels(lame) == []

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Days without a model in one process: what is learnt, and that the bag gives the same again."""

from pathlib import Path

import numpy as np
import pytest

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.learnt_days import (
    DAYS,
    EVERY,
    NOISE,
    days_line,
    days_page,
    days_table,
    joined,
    learn_days,
    learnt_days,
)
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog


@pytest.fixture(scope='module')
def learnt(tmp_path_factory):
    """Two days with their bag."""
    path = tmp_path_factory.mktemp('learnt') / 'bag'
    with PublishedBag(path) as bag:
        days = learn_days(DAYS[:2], sink=bag)
    return days, path


def test_the_replay_of_the_bag_is_identical(learnt):
    _, path = learnt
    with BagReader(path) as reader:
        assert '/mill/thermal_posterior' in reader.connections
    found = replay(path)
    assert found.identical
    assert not found.notes


def test_a_bag_is_judged_as_the_run_was(learnt):
    days, path = learnt
    again = learnt_days(ShiftLog.from_bag(path), DAYS[:2])
    for one, other in zip(days, again, strict=True):
        assert one.figures() == other.figures()
        np.testing.assert_array_equal(one.probed, other.probed)


def test_a_machine_is_probed_as_it_is_and_the_bare_error_is_learnt(learnt):
    days, path = learnt
    log = ShiftLog.from_bag(path)
    assert all(item.includes_compensation for item in log.records('displacement'))
    for day in days:
        taken = ~np.isnan(day.probed[:, 0])
        assert day.time[taken] == pytest.approx(np.arange(1, 4) * EVERY)
        off = day.probed[taken] - day.error[taken]
        assert np.abs(off).max() < 4.0 * NOISE
        assert np.abs(off).max() > 0.0
    assert np.abs(days[1].applied).max() > 10e-6  # offsets were in force that had to be taken off


def test_the_second_day_keeps_what_the_first_has_taught(learnt):
    first, second = (day.figures() for day in learnt[0])
    for axis in MILL_AXES:
        assert second[axis]['learnt_rms_um'] < 0.5 * second[axis]['last_probe_held_rms_um']
        assert second[axis]['learnt_rms_um'] < 0.5 * first[axis]['learnt_rms_um']
        assert second[axis]['in_band'] > 0.9


def test_a_held_probe_acts_after_its_sample_and_not_on_the_next_day(learnt):
    (day, second), _ = learnt
    row = np.flatnonzero(~np.isnan(day.probed[:, 0]))[0]
    assert not day.held[: row + 1].any()
    np.testing.assert_array_equal(day.held[row + 1], day.probed[row])
    assert not second.held[0].any()


def test_days_are_joined_with_a_gap_between_them(learnt):
    days, _ = learnt
    whole = joined(days)
    assert (np.diff(whole.time) >= 0.0).all()
    gaps = np.flatnonzero(np.isnan(whole.error[:, 0]))
    assert gaps.tolist() == [0, len(days[0].time) + 1]
    assert whole.time[-1] == days[0].time[-1] + days[1].time[-1]


def test_table_sentence_and_page_tell_the_same(learnt):
    days, _ = learnt
    table = days_table(days)
    assert [row[:2] for row in table.rows] == [
        (f'{number} ({name})', axis) for number, name in enumerate(DAYS[:2], 1) for axis in 'YZ'
    ]
    worst = max(figures['applied_rms_um'] for figures in days[1].figures().values())
    assert f'at most {worst:.1f} of' in days_line(days)
    page = days_page(days, {'Model': 'none'})
    assert page.summary == days_line(days)
    rules = page.sections[0].figures[0].plot.panels[0].rules
    assert [rule.at for rule in rules if rule.name] == [0.0, days[0].time[-1] / 3600.0]


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(4))
def test_from_the_second_day_on_little_is_left(seed):
    days = learn_days(seed=seed)
    for day in days[1:]:
        for figures in day.figures().values():
            assert figures['learnt_rms_um'] < 3.0
            assert figures['in_band'] > 0.85
    # Each axis is tried in part before all of it is followed.
    last = days[-1].figures().values()
    assert np.median([figures['applied_rms_um'] for figures in last]) < 5.0
    if not seed:
        page = Path(__file__).parents[2] / 'docs' / 'tutorials' / 'try-it.md'
        assert days_table(days).to_text() in page.read_text(encoding='utf-8')

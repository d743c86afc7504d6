# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The first hour of the scenario `learn`, live over DDS: as in one process."""

import pytest
from rich.console import Console

from fuzzycnc_ros.cli.demo.learn import learn
from fuzzycnc_ros.cli.demo.steps import progress_of
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift import learnt_days

pytestmark = pytest.mark.ros

FIRST_PROBE = 3900.0
"""Time of a day in which the machine is probed once [s]."""


def test_a_first_probe_teaches_the_same_as_in_one_process(monkeypatch, domain, tmp_path):
    whole = learnt_days.learning_parameters

    def short(days, seed):
        given = whole(days, seed)
        given['simulated_machine'] |= {'duty_duration': FIRST_PROBE, 'tick_period': 60.0}
        return given

    monkeypatch.setattr(learnt_days, 'learning_parameters', short)
    monkeypatch.setattr(learnt_days, 'DAYS', ('T1',))
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    with progress_of(Console(quiet=True)) as progress:
        found = learn(tmp_path, 0, progress)
    assert not found.problem
    result = found.result
    assert result['replay_identical']
    assert not result['degraded']
    with PublishedBag(tmp_path / 'alone') as bag:
        alone = learnt_days.learn_days(('T1',), sink=bag)
    assert replay(tmp_path / 'alone').hash == result['hash']
    assert {day.name: day.figures() for day in alone} == result['days']
    for figures in result['days']['T1'].values():
        assert figures['half_width_at_end_um'] < 15.0 < figures['uncompensated_rms_um']
    (table,) = found.tables
    assert len(table.rows) == 2
    assert found.page().summary == found.lines[0]

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`make faults`: its scenarios, what it refuses and writes."""

import itertools
import json

import pytest

pytest.importorskip('rclpy')

from campaign.corrupted_values import DRIVE_FIELDS, FIELDS, KINDS, PATH_FIELDS, PATTERN_FIELDS
from campaign.scenarios import STAGES, chosen, scenarios
from campaign.truncated_bags import CUTS, cut_and_repair
from fault_records import judged


def test_cut_bags_keep_what_lies_before_the_cut(tmp_path, qualification, bag):
    recorded = bag('log', rows=400)
    lost, wrong = cut_and_repair(recorded, tmp_path / 'cuts', 3)
    assert (lost, wrong) == (0, [])
    assert not (tmp_path / 'cuts').exists()
    assert CUTS >= 10


def test_what_is_broken_covers_all_that_is_asked_for():
    names = {scenario.name for scenario in scenarios()}
    assert len(names) == sum(len(stage.scenarios) for stage in STAGES)
    for node in (
        'temperature_acquisition',
        'sensor_selector',
        'thermal_predictor',
        'compensator',
        'recorder',
        'simulated_machine',
    ):
        assert {f'kill_{node}', f'stop_{node}'} <= names
    labels = (*FIELDS, *PATH_FIELDS, *DRIVE_FIELDS, *PATTERN_FIELDS)
    for label, kind in itertools.product(labels, KINDS):
        assert f'{kind}_{label}' in names
    for node in ('feedrate_scheduler', 'servo_controller', 'deformation_compensator'):
        assert {f'kill_{node}', f'stop_{node}'} <= names
    for topic in ('trajectory', 'axis_state', 'axis_command'):
        assert {f'drop_{topic}', f'delay_{topic}', f'reorder_{topic}'} <= names
    assert {
        'drop',
        'delay',
        'duplicate',
        'reorder',
        'clock_ahead',
        'clock_back',
        'disk_full',
        'bag_cut',
        'model_damaged',
        'parameter_out_of_range',
        'two_compensators',
        'foreign_compensation',
        'foreign_axis_command',
    } <= names


def test_chosen_scenarios_keep_their_stages():
    stages = chosen(['kill_recorder', 'nan_compensation'])
    assert [stage.name for stage in stages] == ['kills', 'compensation']
    assert [len(stage.scenarios) for stage in stages] == [1, 1]


def test_unknown_scenario_is_refused(refused):
    refused('faults', '--only', 'kill_operator', naming=['kill_recorder', 'kill_operator'])
    refused('faults', '--list', '--only', 'kill_operator', naming=['kill_operator'])


def test_folder_that_exists_is_refused(refused, tmp_path):
    (tmp_path / 'there').mkdir()
    refused('faults', '--out', 'there', naming=['there', 'exists'])


def test_scenarios_are_listed(qualification):
    outcome = qualification('faults', '--list')
    assert outcome.code == 0
    for scenario in scenarios():
        assert scenario.name in outcome.out


def test_figures_are_written(qualification, monkeypatch, tmp_path):
    from campaign import command as faults

    found = [judged(), judged(unrecorded=3)]
    monkeypatch.setattr(faults, 'campaign', lambda *given: found)
    outcome = qualification('faults', '--json', 'faults.json')
    assert outcome.code == 1
    assert '1 of 2 scenarios are safe' in outcome.out
    assert '3 messages are missing' in outcome.out
    (first, second) = json.loads((tmp_path / 'faults.json').read_text())['scenarios']
    wanted = {'name', 'safe', 'worst_offset_um', 'worst_step_um', 'time_to_safe_s'}
    assert wanted | {'lost_messages', 'diagnostics'} <= set(first)
    assert (first['safe'], second['safe'], second['lost_messages']) == (True, False, 3)
    found.pop()
    assert qualification('faults').code == 0

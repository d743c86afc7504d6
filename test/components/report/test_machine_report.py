# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a report says of a machine, and what it says where nothing is known."""

import json
import math

import numpy as np

from fuzzycnc_ros.components.dashboard.node_report import NODE_SILENT
from fuzzycnc_ros.components.report.machine_report import MachineReport
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import SpeedStatus, Status
from fuzzycnc_ros.runtime.records import (
    SECOND,
    CompensationApplied,
    SpindleSpeed,
    Temperatures,
    ThermalError,
)

TIME = '2026-01-02T03:04:05.000+00:00'


def filled():
    """Return a report that has everything, taken at 100 s."""
    report = MachineReport('mill')
    report.take(
        'temperatures',
        Temperatures(
            stamp=7 * SECOND,
            sensor=('T1', 'T2'),
            temperature=np.array([21.5, math.nan]),
            status=np.array([Status.OK, Status.MISSING], np.uint8),
        ),
        100.0,
    )
    report.take(
        'thermal_error',
        ThermalError(
            stamp=7 * SECOND,
            axis=('Z',),
            channel=('Z',),
            error=np.array([12.5e-6]),
            standard_deviation=np.array([1e-6]),
            valid=True,
            reason=0,
            in_domain=False,
            model='mill',
            substituted=(),
            substitute=(),
        ),
        100.0,
    )
    report.take(
        'compensation_applied',
        CompensationApplied(
            stamp=6 * SECOND,
            epoch=1,
            status=OffsetStatus.REFUSED,
            reason='',
            axis=('X', 'Z'),
            offset=np.array([0.0, -12.5e-6]),
            at_limit=np.array([False, False]),
        ),
        99.0,
    )
    speed = SpindleSpeed(stamp=7 * SECOND, speed=100.0 * math.pi, status=SpeedStatus.OK)
    report.take('spindle_speed', speed, 100.0)
    return report


def test_everything_in_the_units_of_its_name():
    document = filled().document(TIME, 100.5)
    assert document == {
        'machine': 'mill',
        'sequence': 1,
        'time': TIME,
        'offsets': {
            'stamp_s': 6.0,
            'age_s': 1.5,
            'offset_um': {'X': 0.0, 'Z': -12.5},
            'status': 'refused',
        },
        'errors': {
            'stamp_s': 7.0,
            'age_s': 0.5,
            'error_um': {'Z': 12.5},
            'standard_deviation_um': {'Z': 1.0},
            'valid': True,
            'in_domain': False,
        },
        'temperatures': {
            'stamp_s': 7.0,
            'age_s': 0.5,
            'temperature_degC': {'T1': 21.5, 'T2': None},
            'status': {'T1': 'ok', 'T2': 'missing'},
        },
        'spindle': {'stamp_s': 7.0, 'age_s': 0.5, 'speed_rpm': 3000.0, 'status': 'ok'},
        'alarms': [],
    }
    json.dumps(document, allow_nan=False)


def test_what_came_after_the_look_at_the_clock_is_not_of_the_future():
    assert filled().document(TIME, 99.9)['temperatures']['age_s'] == 0.0


def test_the_page_shows_a_report_as_it_is(root):
    text = (root / 'docs' / 'how-to' / 'mqtt.md').read_text()
    shown = json.loads(text.partition('```json\n')[2].partition('```')[0])
    document = filled().document(TIME, 100.5)
    assert list(shown) == list(document)
    for name in ('offsets', 'errors', 'temperatures', 'spindle'):
        assert list(shown[name]) == list(document[name]), name


def test_nothing_known_is_told_as_such():
    report = MachineReport('mill')
    document = report.document(TIME, 5.0)
    parts = ('offsets', 'errors', 'temperatures', 'spindle')
    assert [document[part] for part in parts] == [None] * 4
    assert report.document(TIME, 6.0)['sequence'] == 2


def test_alarms_are_what_nodes_say_and_their_silence():
    report = MachineReport('mill')
    items = (Health('fine', Level.OK, ''), Health('offset', Level.WARN, 'at its limit'))
    report.take_health('compensator', items, 10.0)
    report.take_health('thermal_predictor', (Health('model', Level.ERROR, 'bad\x1b[2J'),), 10.0)
    first, second = report.document(TIME, 11.0)['alarms']
    assert first['level'] == 'error'
    assert '\x1b' not in first['text']
    assert second == {
        'level': 'warning',
        'node': 'compensator',
        'name': 'offset',
        'text': 'at its limit',
    }
    alarms = report.document(TIME, 10.1 + NODE_SILENT)['alarms']
    assert [alarm['name'] for alarm in alarms] == ['report', 'report']
    assert alarms[0]['text'] == 'does not report for 5 s; look whether it still runs'
    report.take_health('compensator', (Health('offset', Level.OK, ''),), 16.0)
    assert [alarm['node'] for alarm in report.document(TIME, 16.0)['alarms']] == [
        'thermal_predictor'
    ]

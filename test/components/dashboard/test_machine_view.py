# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The view of a machine: what records and nodes say, no more and no less."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.components.dashboard.machine_view import SILENT, MachineView
from fuzzycnc_ros.components.dashboard.node_report import NODE_SILENT, split_advice
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import CompensationState, MachineMode, ServoStatus, Status
from fuzzycnc_ros.runtime.host import NodeConfiguration
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    CompensatedPath,
    Compensation,
    CompensationApplied,
    Displacement,
    FeedSchedule,
    MachineState,
    ProbeCycleState,
    ProbeStatus,
    SensorCluster,
    SensorSelection,
    ServoState,
    SpindleSpeed,
    Temperatures,
    ThermalError,
    TrajectoryState,
)

START = 1_000_000 * SECOND


def temperatures(at=0, names=('t1', 't2'), values=(20.0, 21.0), status=None):
    return Temperatures(
        stamp=START + at * SECOND,
        sensor=tuple(names),
        temperature=np.array(values, float),
        status=np.array(status or [0] * len(names), np.uint8),
        readings=5,
    )


def error(at=0, value=3e-6, axes=('Y',), **more):
    given = {
        'channel': axes,
        'error': np.full(len(axes), value),
        'standard_deviation': np.full(len(axes), 1e-6),
        'valid': True,
        'reason': 0,
        'in_domain': True,
        'model': 'lag_ridge 0123456789ab',
        'substituted': (),
        'substitute': (),
    }
    return ThermalError(stamp=START + at * SECOND, axis=axes, **{**given, **more})


def compensation(at=0, value=-3e-6, state=CompensationState.ACTIVE, limit=False):
    return Compensation(
        stamp=START + at * SECOND,
        epoch=1,
        state=int(state),
        axis=('Y',),
        offset=np.array([value]),
        slope=np.array([1e-7]),
        reference_position=np.array([0.2]),
        at_limit=np.array([limit]),
        slewing=np.array([False]),
        valid_until=START + (at + 180) * SECOND,
        source=('thermal_error',),
    )


def applied(at=0, value=-2.9e-6, status=OffsetStatus.FOLLOWING, reason=''):
    return CompensationApplied(
        stamp=START + at * SECOND,
        epoch=1,
        status=int(status),
        reason=reason,
        axis=('Y',),
        offset=np.array([value]),
        at_limit=np.array([False]),
    )


def machine_state(at=0, mode=MachineMode.RUNNING, homed=True, speed=100.0):
    return MachineState(
        stamp=START + at * SECOND,
        state=int(mode),
        homed=homed,
        offsets_allowed=True,
        cold_since=0,
        spindle_speed=speed,
        axis=(),
        position=np.zeros(0),
    )


def configuration(node='compensator', **more):
    given = {
        'version': '0',
        'message_set': 1,
        'lifecycle_state': 'active',
        'parameters': '{"offset_max": 5e-05}',
        'model': '',
        'model_hash': '',
    }
    return NodeConfiguration(stamp=0, node=node, **{**given, **more})


def running(now=0.0):
    """Return the view of a machine on which all is well."""
    view = MachineView('mill')
    view.take_configuration(configuration())
    for name in ('compensator', 'thermal_predictor', 'temperature_acquisition'):
        view.take_health(name, [Health('state', Level.OK, 'active')], now)
    for topic, record in (
        ('temperatures', temperatures()),
        ('thermal_error', error()),
        ('compensation', compensation()),
        ('compensation_applied', applied()),
        ('machine_state', machine_state()),
    ):
        view.take(topic, record, now)
    return view


def document(view, now=0.1):
    """Return the view as a page gets it: through JSON that knows neither NaN nor infinity."""
    return json.loads(json.dumps(view.document(now), allow_nan=False))


def test_values_are_those_of_the_records():
    view = running()
    view.take('displacement', probe(2.0e-7), 0.05)
    shown = document(view)
    assert shown['machine'] == 'mill'
    assert shown['silent'] == ''
    assert shown['stamp'] == START / SECOND
    assert shown['age'] == pytest.approx(0.1)
    assert shown['state'] == {
        'compensation': 'active',
        'why': 'offsets follow the predicted error',
        'machine': 'running',
        'offsets_allowed': True,
    }
    (axis,) = shown['axes']
    assert axis['offset'] == -2.9e-6
    assert axis['requested'] == -3e-6
    assert axis['slope'] == 1e-7
    assert axis['reference_position'] == 0.2
    assert axis['limit'] == 5e-5
    assert axis['share'] == pytest.approx(0.058)
    assert axis['predicted'] == 3e-6
    assert axis['band'] == 2e-6
    assert axis['limited'] == []
    assert axis['probe'] == {
        'measured': 2.0e-7,
        'predicted': pytest.approx(1e-7),  # offsets were in force
        'age': 0.0,
    }
    assert shown['spindle'] == 100.0
    assert shown['sensors']['values'] == {'t1': 20.0, 't2': 21.0}
    assert shown['sensors']['ok'] == 2
    assert [node['lifecycle'] for node in shown['nodes']] == ['active', 'running', 'running']
    assert shown['alarms'] == []
    assert shown['recording'] is None
    assert shown['feeds'] is None
    assert shown['servo'] is None
    assert shown['soft'] is None


def probe(value, at=0, compensated=True):
    return Displacement(
        stamp=START + at * SECOND,
        axis=('Y',),
        channel=('Y',),
        displacement=np.array([value]),
        standard_deviation=np.array([1e-7]),
        includes_compensation=compensated,
    )


def test_a_probe_is_compared_also_before_an_offset_is_known():
    view = MachineView('mill')
    view.take('thermal_error', error(), 0.0)
    view.take('displacement', probe(2.0e-7), 0.05)
    history = view.history['error']
    probed = history.rows(0.0, 1e12, 10).mean[-1, history.names.index('Y residual')]
    assert probed == pytest.approx(-2.8e-6)


def test_a_probe_is_drawn_beside_the_error_without_the_offset_that_it_includes():
    view = running()
    view.take('displacement', probe(2.0e-7), 0.05)
    history = view.history['error']
    newest = dict(zip(history.names, history.rows(0.0, 1e12, 10).mean[-1], strict=True))
    assert newest['Y probed'] == pytest.approx(3.1e-6)  # 0.2 with -2.9 in force
    assert newest['Y residual'] == pytest.approx(1e-7)


def test_bad_and_substituted_sensors_are_named_with_their_cause():
    view = running()
    poor = temperatures(1, ('t1', 't2', 't3'), (20.0, np.nan, 90.0), [0, 1, Status.DRIFT])
    view.take('temperatures', poor, 1.0)
    view.take('thermal_error', error(1, substituted=('t2',), substitute=('t1',)), 1.0)
    chosen = SensorCluster(
        member=('t1', 't2'),
        score=np.zeros(2),
        chosen='t2',
        substitute=('t1',),
        gain=np.ones(1),
        correlation=np.ones(1),
    )
    selection = SensorSelection(
        stamp=START,
        method='',
        cluster=(chosen,),
        partition_coefficient=1.0,
        xie_beni=1.0,
        dropped=(),
        calibration=(),
    )
    view.take('sensor_selection', selection, 1.0)
    sensors = document(view, 1.0)['sensors']
    assert sensors['ok'] == 1
    assert sensors['values']['t2'] is None
    assert sensors['substituted'] == [{'name': 't2', 'by': 't1'}]
    assert [item['why'] for item in sensors['missing']] == [
        'no reading',
        'drifts away from its mates',
    ]
    assert sensors['clusters'] == [{'chosen': 't2', 'members': ['t2', 't1']}]
    view.take('temperatures', poor, 2.0)
    flagged = view.history['temperatures'].rows(0.0, 1e12, 10)
    assert flagged.flag.any(axis=0).tolist() == [False, True, True]


def test_clusters_are_those_of_the_model_in_use_though_no_selection_is_published():
    """A graph that starts with a model file selects nothing."""
    view = running()
    clusters = [{'chosen': 't2', 'member': ['t1', 't2']}, {'chosen': 't3', 'member': ['t3']}]
    model = json.dumps({'selection': {'clusters': clusters}})
    view.take_configuration(configuration('thermal_predictor', model_hash='h', model=model))
    assert document(view)['sensors']['clusters'] == [
        {'chosen': 't2', 'members': ['t2', 't1']},
        {'chosen': 't3', 'members': ['t3']},
    ]


@pytest.mark.parametrize(
    'selection', [None, [], {'clusters': None}, {'clusters': [1]}, {'clusters': [{'chosen': 1}]}]
)
def test_model_without_readable_clusters_shows_none(selection):
    view = running()
    model = json.dumps({'selection': selection})
    view.take_configuration(configuration('thermal_predictor', model_hash='h', model=model))
    assert document(view)['sensors']['clusters'] == []


@pytest.mark.parametrize(
    ('state', 'word'),
    [
        (CompensationState.INACTIVE, 'inactive'),
        (CompensationState.HOLDING, 'holding'),
        (CompensationState.RAMPING, 'ramping'),
        (CompensationState.EXPIRED, 'expired'),
        (99, 'state 99'),
    ],
)
def test_each_state_has_its_word_and_its_reason(state, word):
    view = running()
    view.take('compensation', compensation(1, state=state), 1.0)
    shown = document(view, 1.0)['state']
    assert shown['compensation'] == word
    assert shown['why']
    name = word if state != 99 else 'other'
    view.take_health('compensator', [Health('state', Level.WARN, f'{name}: because of X')], 1.0)
    why = document(view, 1.0)['state']['why']
    assert (why == 'because of X') == (state != 99)


def test_without_a_compensator_none_is_shown():
    view = MachineView('mill')
    view.take('machine_state', machine_state(mode=MachineMode.ESTOP), 0.0)
    state = document(view)['state']
    assert state['compensation'] == 'absent'
    assert state['machine'] == 'e-stop'


def test_what_the_machine_refuses_is_told():
    view = running()
    view.take('compensation_applied', applied(1, 0.0, OffsetStatus.REFUSED, 'epoch'), 1.0)
    state = document(view, 1.0)['state']
    assert state['compensation'] == 'refused'
    assert 'refuses offsets: epoch' in state['why']
    view.take('compensation', compensation(2, state=CompensationState.INACTIVE), 2.0)
    state = document(view, 2.0)['state']
    assert state['compensation'] == 'inactive'
    assert 'not activated; the machine refuses offsets: epoch' in state['why']


def test_a_compensator_that_hangs_is_not_active():
    """What it told last was that it is; the machine side knows better."""
    view = running()
    assert document(view, 1.0)['state']['compensation'] == 'active'
    view.take('compensation_applied', applied(1, -1e-6, OffsetStatus.EXPIRED), 1.0)
    assert document(view, 1.0)['state']['compensation'] == 'expired'
    view.take('compensation', compensation(2), 2.0)
    view.take('compensation_applied', applied(2), 2.0)
    assert document(view, 2.0)['state']['compensation'] == 'active'


def test_a_command_out_of_date_is_not_in_force_where_no_machine_tells():
    view = MachineView('mill')
    view.take_health('compensator', [], 0.0)
    view.take('compensation', compensation(0), 0.0)
    view.take('machine_state', machine_state(180), 180.0)
    assert document(view, 180.0)['state']['compensation'] == 'active'
    view.take('machine_state', machine_state(181), 181.0)
    assert document(view, 181.0)['state']['compensation'] == 'expired'


def test_a_reached_limit_is_shown():
    view = running()
    before = view.key(1.0)
    view.take('compensation', compensation(1, -5e-5, limit=True), 1.0)
    assert view.key(1.0) != before
    assert document(view, 1.0)['axes'][0]['limited'] == ['clamp']


@pytest.mark.parametrize(('rate', 'stable_in'), [(0.0, 0.0), (4e-9, None)])
def test_what_moves_is_not_called_stable(rate, stable_in):
    """For an hour all of it lies within a micrometre of where it will end."""
    view = running()
    for second in range(0, 3600, 10):
        view.take('thermal_error', error(second), 0.0)
        moved = -3e-6 - rate * max(0, second - 3400)
        view.take('compensation_applied', applied(second, moved), 0.0)
    (axis,) = document(view)['axes']
    assert (axis['arrow'] == 'steady') == (rate == 0.0)
    assert axis['stable_in'] == stable_in


def test_alarms_have_cause_remedy_and_since():
    view = running()
    view.take_health(
        'thermal_predictor',
        [
            Health('prediction', Level.ERROR, 'no model; set the parameter model'),
            Health('domain', Level.WARN, 'far away'),
            Health('activity', Level.OK, '', {'rate [1/s]': '2.0', 'latency [ms]': '4.5'}),
        ],
        0.2,
    )
    first, second = document(view, 0.2)['alarms']
    assert first == {
        'level': 'error',
        'node': 'thermal_predictor',
        'name': 'prediction',
        'cause': 'no model',
        'remedy': 'set the parameter model',
        'since': START / SECOND,
    }
    assert (second['level'], second['cause'], second['remedy']) == ('warn', 'far away', '')
    view.take('temperatures', temperatures(50), 0.3)
    assert document(view, 0.3)['alarms'][0]['since'] == START / SECOND
    node = next(n for n in document(view, 0.3)['nodes'] if n['name'] == 'thermal_predictor')
    assert node['rate'] == 2.0
    assert node['latency'] == pytest.approx(0.0045)
    assert node['level'] == 'error'
    assert len(node['trouble']) == 2
    view.take_health('thermal_predictor', [], 0.4)
    assert document(view, 0.4)['alarms'] == []


def test_advice_begins_with_a_verb():
    assert split_advice('a; b is so; see the log; and more') == (
        'a; b is so',
        'see the log; and more',
    )
    assert split_advice('late: newest is 3 s old') == ('late: newest is 3 s old', '')


def test_a_node_that_ended_is_an_alarm_and_all_of_them_are_silence():
    view = running()
    view.set_nodes(['compensator'], ['thermal_predictor'])
    shown = document(view)
    (alarm,) = shown['alarms']
    assert alarm['node'] == 'thermal_predictor'
    assert 'has ended' in alarm['cause']
    assert alarm['remedy']
    assert shown['silent'] == ''
    view.set_nodes([], view.nodes)
    shown = document(view)
    assert 'have ended' in shown['silent']
    assert '/mill' in shown['silent']
    assert shown['state']['compensation'] == 'absent'
    view.set_nodes(view.nodes, [])
    assert document(view)['silent'] == ''


def test_silence_has_its_duration_and_its_cause():
    view = running()
    assert document(view, SILENT - 0.1)['silent'] == ''
    silent = document(view, 12.0)['silent']
    assert silent.startswith('no data for 12 s: no node of /mill reports')
    trouble = Health('sensor_readings', Level.WARN, 'late: newest is 11.0 s old')
    view.take_health('temperature_acquisition', [trouble], 12.0)
    silent = document(view, 12.0)['silent']
    assert 'temperature_acquisition: late: newest is 11.0 s old' in silent
    hung = document(view, 12.0 + NODE_SILENT - SILENT)
    assert {alarm['name'] for alarm in hung['alarms']} == {'silent', 'sensor_readings'}


def test_a_slow_machine_is_not_silent_between_its_samples():
    view = running()
    for minute in range(1, 8):
        now = 60.0 * minute
        for topic, record in (
            ('temperatures', temperatures(60 * minute)),
            ('thermal_error', error(60 * minute)),
            ('compensation_applied', applied(60 * minute)),
            ('machine_state', machine_state(60 * minute)),
        ):
            view.take(topic, record, now)
    view.take_health('compensator', [], now + 59.0)
    assert document(view, now + 59.0)['silent'] == ''
    view.take_health('compensator', [], now + 200.0)
    assert document(view, now + 200.0)['silent'].startswith('no data for 200 s')


def test_a_clock_that_begins_anew_begins_a_new_view():
    view = running()
    for second in range(1, 100):
        view.take('temperatures', temperatures(second), second)
    view.take('displacement', probe(1e-6, at=99), 99.0)
    view.take('temperatures', temperatures(-50_000), 100.0)
    shown = document(view, 100.0)
    assert shown['stamp'] == START / SECOND - 50_000
    assert len(view.history['temperatures'].rows(0.0, 1e12, 1000).time) == 1
    assert all(axis['probe'] is None for axis in shown['axes'])


def test_hostile_names_and_numbers_do_no_harm():
    view = MachineView('mill')
    names = ('<script>alert(1)</script>', '\x1b[2J\x1b]0;x\x07', '\u202egnp.exe', '', '\ud800')
    wild = (np.inf, -np.inf, np.nan, 1e308, -1e308)
    view.take('temperatures', temperatures(0, names, wild), 0.0)
    view.take('thermal_error', error(0, np.nan, axes=names), 0.0)
    view.take_health('\x1b[31mnode', [Health('a\nb', Level.ERROR, '\x9b31m; set\x00 it')], 0.0)
    view.take_configuration(configuration('thermal_predictor', parameters='[', model='{"a": 1}'))
    view.take_configuration(configuration('x', model_hash='h', model='{"channels": [1, "é"]}'))
    shown = document(view)
    text = json.dumps(shown, ensure_ascii=False)
    assert not any(ord(character) < 0x20 or 0x7F <= ord(character) < 0xA0 for character in text)
    assert '\u202e' not in text
    assert '\ud800' not in text
    assert '<script>alert(1)</script>' in shown['sensors']['values']  # a name is a name
    rows = view.history['temperatures'].rows(0.0, 1e12, 10)
    assert np.isnan(rows.mean).all()


def test_arrays_that_do_not_match_lose_what_has_no_partner():
    view = MachineView('mill')
    record = temperatures(0, ('t1', 't2', 't3'), (20.0,), [0])
    view.take('temperatures', record, 0.0)
    assert document(view)['sensors']['values'] == {'t1': 20.0}


def test_a_thousand_sensors_are_all_shown():
    view = MachineView('mill')
    names = tuple(f't{number:04d}' for number in range(1000))
    for second in range(3):
        view.take('temperatures', temperatures(second, names, range(1000)), second)
    shown = document(view, 2.0)
    assert shown['sensors']['ok'] == 1000
    assert shown['sensors']['values']['t0999'] == 999.0
    assert view.history['temperatures'].names == names


def test_own_spindle_speed_counts_before_that_of_the_controller():
    view = running()
    view.take('spindle_speed', SpindleSpeed(stamp=START, speed=50.0, status=0), 0.0)
    assert document(view)['spindle'] == 50.0
    view.take('spindle_speed', SpindleSpeed(stamp=START, speed=np.nan, status=1), 0.0)
    assert document(view)['spindle'] == 100.0


def test_feeds_axes_and_soft_material_are_shown_where_they_run():
    view = running()
    line = np.array([0.0, 0.01, 0.02])
    view.take(
        'feed_schedule',
        FeedSchedule(
            stamp=START,
            path_id='part',
            part=0,
            last=True,
            method='tolerance',
            tolerance=np.nan,
            feed_override=1.0,
            arc_length=line,
            curvature=0.0 * line,
            feed=line + 1.0,
            speed=line + 0.5,
            block=np.arange(3),
        ),
        0.0,
    )
    view.take(
        'trajectory_state',
        TrajectoryState(
            stamp=START,
            path_id='part',
            epoch=1,
            part=0,
            status=int(TrajectoryStatus.FOLLOWING),
            reason='',
            arc_length=0.01,
        ),
        0.0,
    )
    axes = AxisState(
        stamp=START,
        axis=('X',),
        reference=np.array([0.1]),
        position=np.array([0.0999]),
        velocity=np.array([0.02]),
    )
    view.take('axis_state', axes, 0.0)
    view.take(
        'servo_state',
        ServoState(
            stamp=START,
            epoch=1,
            status=int(ServoStatus.FOLLOWING),
            reason='',
            axis=('X',),
            reference=np.array([0.1]),
            error=np.array([1e-4]),
            disturbance=np.zeros(1),
            saturated=np.array([True]),
            missed=2,
        ),
        0.0,
    )
    points = np.array([0.0, 1e-4, np.nan, 2e-4])
    view.take(
        'compensated_path',
        CompensatedPath(
            stamp=START,
            path_id='quilt',
            material='foam',
            thickness=0.03,
            model='m',
            nominal=points,
            offset=points,
            primitive=np.zeros(2, np.uint32),
            kind=np.zeros(1, np.uint8),
            turn=np.zeros(1),
            depth=np.zeros(1),
            step=np.zeros(1),
            compensation=np.zeros(2),
            support=np.zeros(2),
            flag=np.array([0, 1], np.uint8),
        ),
        0.0,
    )
    shown = document(view)
    assert shown['feeds']['status'] == 'following'
    assert shown['feeds']['feed'] == 0.51
    assert shown['feeds']['tolerance'] is None
    (axis,) = shown['servo']['axes']
    assert axis == {
        'axis': 'X',
        'position': 0.0999,
        'velocity': 0.02,
        'error': 1e-4,
        'saturated': True,
    }
    assert shown['servo']['missed'] == 2
    assert shown['soft']['offset_max'] == 2e-4
    assert shown['soft']['flagged'] == 1
    following = view.history['axes'].rows(0.0, 1e12, 10)
    assert following.mean[0].tolist() == pytest.approx([0.0999, 1e-4], rel=1e-3)


def test_the_model_tells_where_it_comes_from():
    view = running()
    candidates = {'lag_ridge': {'held_out_rms': [1.6e-6]}}
    model = {
        'training_runs': ['monday'],
        'channels': [{'name': 'Y', 'default': 'lag_ridge'}],
        'candidates': candidates,
    }
    told = configuration(
        'thermal_predictor',
        parameters='{"model": "mill.json"}',
        model=json.dumps(model),
        model_hash='0123456789abcdef',
    )
    view.take_configuration(told)
    values = {'distance [-]': '0.4'}
    view.take_health(
        'thermal_predictor', [Health('prediction', Level.OK, 'predicting', values)], 0.0
    )
    shown = document(view)['model']
    assert shown['file'] == 'mill.json'
    assert shown['hash'] == '0123456789ab'
    assert shown['runs'] == ['monday']
    assert shown['held_out'] == {'Y': 1.6e-6}
    assert shown['distance'] == 0.4
    assert shown['in_domain']
    assert shown['valid']
    view.take('thermal_error', error(1, np.nan, valid=False, reason=1), 1.0)
    assert document(view, 1.0)['model']['why'] == 'no reference'
    assert document(view, 1.0)['axes'][0]['predicted'] is None


def test_recordings_of_here_and_of_elsewhere_are_told():
    view = running()
    view.take_health('recorder', [Health('bag', Level.OK, '5', {'bag': 'run_1'})], 0.0)
    assert document(view)['recording'] == {'active': True, 'bag': 'run_1'}
    view.set_nodes(['compensator'], ['recorder'])
    assert document(view)['recording'] is None
    view.set_recording('own')
    assert document(view)['recording'] == {'active': True, 'bag': 'own'}


def test_a_compensator_that_was_shut_down_for_good_is_told_so():
    view = running()
    view.take_configuration(configuration(lifecycle_state='finalized'))
    shown = document(view)
    assert 'was shut down for good; end its process' in shown['state']['why']
    assert shown['nodes'][0]['lifecycle'] == 'finalized'


def status(**more):
    given = {
        'due': False,
        'reason': 'the band is narrow enough',
        'due_at': START + 5400 * SECOND,
        'probed_at': START - 600 * SECOND,
        'axis': ('Y', 'Z'),
        'channel': ('Y', 'Z'),
        'band': np.array([2e-6, 3e-6]),
        'change': np.array([1.5e-6, np.nan]),
    }
    return ProbeStatus(stamp=START, **{**given, **more})


def cycle_state(**more):
    given = {
        'due': True,
        'reason': 'wide',
        'outcome': '',
        'accepted': True,
        'failures': 0,
        'signature': 1,
        'reference_stamp': START,
        'zero': np.zeros(1),
        'size': np.zeros(1),
        'noise': np.zeros(1),
    }
    return ProbeCycleState(stamp=START, **{**given, **more})


def test_probing_tells_what_the_last_changed_and_when_the_next_is_due():
    view = running()
    assert view.document(0.0)['probing'] is None
    view.take('probe_status', status(), 0.0)
    now = view.document(0.0)['stamp'] * SECOND
    told = view.document(0.0)['probing']
    assert told['age'] == pytest.approx((now - START) / SECOND + 600.0)
    assert told['due_in'] == pytest.approx(5400.0 - (now - START) / SECOND)
    assert told['changes'] == [{'channel': 'Y', 'change': 1.5e-6}]
    assert told['cycle'] is None
    view.take('probe_status', status(due=True, reason='Z to 9 µm'), 0.0)
    view.take('probe_cycle_state', cycle_state(outcome='a chip', accepted=False), 0.0)
    told = view.document(0.0)['probing']
    assert (told['due'], told['reason'], told['due_in']) == (True, 'Z to 9 µm', None)
    assert told['cycle']['outcome'] == 'a chip'


def test_the_first_place_of_an_axis_is_its_probe():
    view = running()
    record = replace(
        probe(1e-6),
        axis=('Y', 'Y'),
        channel=('Y', 'Y right'),
        displacement=np.array([1e-6, 9e-6]),
        standard_deviation=np.full(2, 1e-7),
        position=np.zeros(2),
    )
    view.take('displacement', record, 0.0)
    (axis,) = (item for item in view.document(0.0)['axes'] if item['axis'] == 'Y')
    assert axis['probe']['measured'] == 1e-6


def sloping(travel='["Y:-0.4:0.0"]', **more):
    """Return the axis Y of a machine whose error slopes along it."""
    view = running()
    view.take_configuration(configuration(parameters=f'{{"travel": {travel}}}'))
    along = {
        'slope': np.array([-100e-6]),
        'slope_deviation': np.array([4e-6]),
        'reference_position': np.array([-0.2]),
    }
    view.take('thermal_error', error(1, axes=('Y',), **{**along, **more}), 0.0)
    view.take('compensation', compensation(1), 0.0)
    return next(axis for axis in view.document(0.1)['axes'] if axis['axis'] == 'Y')


def test_an_error_that_slopes_is_shown_at_both_ends_and_the_middle():
    axis = sloping()
    along = axis['along']
    assert along['position'] == [-0.4, -0.2, 0.0]
    middle = axis['predicted']
    assert along['error'] == pytest.approx([middle + 20e-6, middle, middle - 20e-6])
    ends = 2.0 * np.hypot(1e-6, 0.8e-6)
    assert along['band'] == pytest.approx([ends, 2e-6, ends])
    assert along['offset'] == pytest.approx([-3.06e-6, -3.04e-6, -3.02e-6])


@pytest.mark.parametrize(
    ('travel', 'more'),
    [
        ('[]', {}),
        ('"Y"', {}),
        ('["Y:a:b"]', {}),
        ('["Y:-0.4:0.0"]', {'slope': np.array([np.nan])}),
    ],
)
def test_nothing_is_shown_along_an_axis_of_which_nothing_is_known(travel, more):
    assert sloping(travel, **more)['along'] is None

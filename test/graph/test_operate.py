# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc operate` on running nodes: what it shows and changes, and what it refuses."""

import itertools
import json
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from processes import HANG, wait_for

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.cli.live import operate, operator_client, supervision_monitor
from fuzzycnc_ros.cli.main import run
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.ros.recording import is_recorded
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode, stamp_of
from fuzzycnc_ros.runtime.records import (
    SECOND,
    CompensationApplied,
    Displacement,
    Temperatures,
)

pytestmark = pytest.mark.ros

HARDLY, LONG = 0.2, 3.0
"""How long to listen where nothing is to be heard, and where something is, for sure [s]."""


@pytest.fixture
def command(domain, monkeypatch, capsys):
    """Carry out `fuzzycnc operate ...` in the domain of the test; return code, out and err."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    # Who is there may be slow; who is not is waited for in tests that say how long.
    monkeypatch.setattr(operate, 'PATIENCE', HANG)

    def carry_out(*words):
        capsys.readouterr()
        code = run(['operate', *words])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return carry_out


@contextmanager
def working(observer):
    """Let the node of the test work in a thread while a command runs."""
    over = threading.Event()

    def work():
        while not over.is_set():
            observer.spin()

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def read_back(offset, status=OffsetStatus.FOLLOWING, reason=''):
    """Return an offset [m] that a machine reads back."""
    return CompensationApplied(
        stamp=SECOND,
        epoch=1,
        status=int(status),
        reason=reason,
        axis=('Y',),
        offset=np.array([offset]),
        at_limit=np.zeros(1, bool),
    )


def applied(observer, offset):
    """Read an offset [m] back ten times a second, as a machine does."""
    publisher = observer.node.create_publisher(
        message_class(CompensationApplied.TYPE),
        'compensation_applied',
        publisher_qos(Durability.STREAM),
    )
    message = encode(read_back(offset), RCLPY)
    observer.node.create_timer(0.1, lambda: publisher.publish(message))


def warm(observer):
    """Tell one temperature ten times a second, from a machine time on that is past the first."""
    publisher = observer.node.create_publisher(
        message_class(Temperatures.TYPE), 'sensor_readings', publisher_qos(Durability.STREAM)
    )
    stamps = itertools.count(2 * SECOND, SECOND // 10)

    def tell():
        record = Temperatures(
            stamp=next(stamps),
            frame_id='mill/machine',
            sensor=('T1',),
            temperature=np.array([30.0]),
            status=np.zeros(1, np.uint8),
            readings=1,
        )
        publisher.publish(encode(record, RCLPY))

    observer.node.create_timer(0.1, tell)


def test_offsets_of_a_control_that_is_lost_are_not_told_as_in_force():
    assert operate.offset_line(read_back(-13.7e-6)) == 'offsets in force: Y -13.70 µm'
    lost = read_back(-13.7e-6, OffsetStatus.REFUSED, 'no answer within 2 s')
    assert operate.offset_line(lost) == (
        'offsets read back last: Y -13.70 µm; refused: no answer within 2 s'
    )


def test_a_compensator_is_looked_at_limited_activated_and_put_to_rest(
    graph, observer, command, tmp_path, monkeypatch
):
    graph.start('compensator')
    observer.until(
        lambda: observer.node.count_subscribers('/mill/thermal_error'), 'the compensator is there'
    )
    assert command('set', 'compensator.offset_max=5e-6') == (
        0,
        'mill/compensator.offset_max = 5e-06 m\n',
        '',
    )
    assert command('activate') == (0, 'mill/compensator is active\n', '')
    assert command('activate') == (0, 'mill/compensator is active already\n', '')
    file = tmp_path / 'status.json'
    monkeypatch.setattr(supervision_monitor, 'FIRST_HEARD', HANG)
    shown = []

    def status():
        code, out, err = command('status', '--json', str(file))
        assert (code, err) == (0, '')
        shown.append(' '.join(out.split()))
        return '"state": "active"' in file.read_text()

    # What a node is may be heard after that it is there.
    wait_for(status, 'the state')
    assert 'compensator' in shown[-1]
    assert 'waiting for the read-back' in shown[-1]
    code, out, err = command('deactivate')
    assert (code, err) == (0, '')
    assert out.startswith('mill/compensator is inactive')
    assert command('deactivate')[1] == 'mill/compensator is not active\n'


@pytest.mark.parametrize(
    ('words', 'named'),
    [
        (('set', 'compensator.offset_max=5'), 'offset_max = 5.0 is outside [0.0, 0.001] m'),
        (('set', 'compensator.period=5'), 'compensator.period: expected a parameter that may'),
        (('set', 'compensator.ofset_max=1e-6'), 'unknown parameter ofset_max of compensator'),
        (('set', 'offset_max=1e-6'), 'expected NODE.NAME=VALUE'),
        (('activate', 'thermal_predictor'), 'expected a node of'),
        (('activate', 'compensator'), 'expected compensator of /mill but none reports'),
        (('reference',), 'expected temperature_acquisition of /mill but none reports'),
        (('status', '--machine', 'lathe'), 'expected nodes of /lathe but none reports'),
        (('mark', ' '), 'PHASE: expected a text of 1 to 80 characters but found 0'),
        (
            ('mark', 'cooling'),
            'mill: expected a recorder that writes the mark down',
        ),
        (('probe', 'Y'), 'expected AXIS=LENGTH such as Z=12um'),
        (('probe', 'Y=3'), 'Y: expected a unit'),
        (('probe', 'Y=1um,Y=2um'), 'expected each axis once'),
        (('probe', 'Y=1um', '--deviation', 'much'), '--deviation: expected a number'),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(words, named, command, monkeypatch):
    monkeypatch.setattr(operate, 'PATIENCE', 1.0)
    code, out, err = command(*words)
    assert (code, out) == (2, '')
    assert named in err
    assert len(err.splitlines()) == 1


def test_a_compensator_that_was_shut_down_is_told_alike(
    graph, observer, command, tmp_path, monkeypatch
):
    """Status, activate and deactivate tell the same truth, and what to do."""
    monkeypatch.setattr(supervision_monitor, 'FIRST_HEARD', HANG)
    graph.start('compensator')
    observer.until(
        lambda: observer.node.count_subscribers('/mill/thermal_error'), 'the compensator is there'
    )
    assert command('activate')[0] == 0
    with operator_client.OperatorClient('mill', patience=HANG) as operator:
        assert operator.transition('compensator', 'shutdown')
    file = tmp_path / 'status.json'

    def told():
        assert command('status', '--json', str(file))[0] == 0
        (node,) = json.loads(file.read_text())['nodes']
        return node['state'] == 'finalized' and 'shut down for good' in node['trouble'] and node

    wait_for(told, 'the node reports it')
    assert told()['health'] == 'error'
    code, _, err = command('activate')
    assert code == 2
    assert 'mill/compensator was shut down for good; end its process to activate it again' in err
    assert command('deactivate') == (0, 'mill/compensator is not active\n', '')


def test_a_node_that_refuses_is_quoted(graph, observer, command, tmp_path):
    model = tmp_path / 'model.json'
    model.write_text('{"schema"', encoding='utf-8')
    graph.start('thermal_predictor')
    observer.until(
        lambda: observer.node.count_subscribers('/mill/temperatures'), 'the predictor is there'
    )
    code, _, err = command('set', f'thermal_predictor.model={model}')
    assert code == 2
    assert f'mill/thermal_predictor: model: {model}: model file: expected JSON' in err


def test_what_was_learnt_is_forgotten_for_a_reason(graph, observer, command):
    graph.start('thermal_predictor', {'learn': True})
    observer.until(
        lambda: observer.node.count_subscribers('/mill/temperatures'), 'the predictor is there'
    )
    code, _, err = command('forget', '--why', 'new spindle')
    assert code == 2
    assert 'forget: no model' in err
    code, _, err = command('forget', '--why', 'x', '--all', '--undo')
    assert code == 2
    assert 'expected --undo or --all, but found both' in err
    code, _, err = command('forget', '--why', ' ')
    assert code == 2
    assert '--why: expected a reason but found none' in err


def test_a_reference_and_a_phase_are_asked_for_and_written_down(
    graph, observer, command, tmp_path
):
    bag = tmp_path / 'bag'
    recorder = graph.start('recorder', {'output': str(bag)})
    graph.start('temperature_acquisition')
    observer.until(lambda: is_recorded(observer.node, 'mill'), 'the recorder listens')
    code, out, err = command('reference', '--by', 'anna')
    assert (code, err) == (0, '')
    assert 'thermal reference' in out
    before = time.time_ns()
    code, out, err = command('mark', 'spindle  6000\x1b', '--by', 'anna')
    assert (code, err) == (0, '')
    assert out == 'mill: spindle 6000\\x1b has begun, as the recorder has noted\n'
    graph.stop()
    assert recorder.process.returncode == 0
    with BagReader(bag) as reader:
        events = [item.message for item in reader.messages(['/mill/node_event'])]
    (mark,) = [event for event in events if event.name == 'mark']
    assert json.loads(mark.request) == {'by': 'anna', 'phase': 'spindle 6000\\x1b'}
    assert before <= stamp_of(mark.header.stamp) <= time.time_ns()
    assert (mark.node, mark.header.frame_id) == ('operator', 'mill/machine')


def test_a_reference_over_offsets_is_asked_for_with_force(graph, observer, command):
    graph.start('temperature_acquisition', {'interval': 1.0})
    observer.watch_diagnostics()
    applied(observer, -13.7e-6)
    item = 'mill/temperature_acquisition: compensation_applied'
    observer.until(
        lambda: any(text != 'nothing received yet' for _, text in observer.statuses.get(item, ())),
        'the read-back is heard',
    )
    sampled = observer.records('temperatures', Temperatures)
    warm(observer)
    observer.until(lambda: sampled, 'machine time has passed the read-back')
    with working(observer):
        code, _, err = command('reference', '--by', 'anna')
        assert code == 2
        assert 'set_thermal_reference: expected a machine without offsets but Y -13.70 um' in err
        assert len(err.splitlines()) == 1
        code, out, _ = command('reference', '--by', 'anna', '--force')
        assert code == 0
        assert 'although Y -13.70 um are in force' in out


@pytest.mark.parametrize(('offset', 'includes'), [(None, False), (0.0, False), (4e-6, True)])
def test_a_probe_says_what_was_measured_and_whether_compensated(
    observer, command, offset, includes, monkeypatch
):
    monkeypatch.setattr(operate, 'LISTENING', LONG if includes else HARDLY)
    heard = observer.records('displacement', Displacement)
    if offset is not None:
        applied(observer, offset)
    with working(observer):
        code, out, err = command('probe', 'Y=-3um', 'Z=0.012mm', '--deviation', '1um')
    assert (code, err) == (0, '')
    assert out.startswith('sent to 1 node of /mill, ' + ('with ' if includes else 'without '))
    observer.until(lambda: heard, 'the probe is heard')
    record = heard[0]
    assert record.axis == record.channel == ('Y', 'Z')
    assert record.displacement == pytest.approx([-3e-6, 12e-6])
    assert record.standard_deviation == pytest.approx([1e-6, 1e-6])
    assert record.includes_compensation is includes


def test_a_probe_that_nobody_hears_or_somebody_else_makes(observer, command, monkeypatch):
    monkeypatch.setattr(operate, 'PATIENCE', 1.0)
    monkeypatch.setattr(operate, 'LISTENING', HARDLY)
    code, _, err = command('probe', 'Y=-3um')
    assert code == 2
    assert 'a recorder or the predictor of mill must be running' in err
    observer.node.create_publisher(
        message_class(Displacement.TYPE), '/mill/displacement', publisher_qos(Durability.STREAM)
    )
    monkeypatch.setattr(operate, 'LISTENING', LONG)
    code, _, err = command('probe', 'Y=-3um')
    assert code == 2
    assert 'expected a machine whose displacement nobody else publishes' in err

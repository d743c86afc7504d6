# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The live page on a real graph: what it shows, what it does, and that nobody depends on it."""

import io
import json
import re
import signal
import ssl
import time
import urllib.error
import urllib.request
from contextlib import ExitStack

import numpy as np
import pytest
from rclpy.parameter import Parameter

pytest.importorskip('starlette', reason="the page needs pip install 'fuzzycnc_ros[page]'")

from live_graph import AGAIN
from processes import wait_for
from rcl_interfaces.srv import SetParameters
from rich.console import Console
from websockets.sync.client import connect

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.cli.live.page_process import page_process
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.host import NodeEvent
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    Displacement,
    Temperatures,
    ThermalError,
)

pytestmark = pytest.mark.ros

PATIENCE = 120.0


class Page:
    """A page that is open, without a browser."""

    def __init__(self, observer, running):
        observer.until(lambda: 'live page: ' in running.output, running.output)
        self.running, self.observer = running, observer
        self.url = re.findall(r'live page: (\S+)', running.output)[0]
        self.live = self.url.replace('http', 'ws', 1) + 'live'
        self._open = ExitStack()
        self._socket = self._open.enter_context(
            connect(self.live, max_size=None, max_queue=None, ping_interval=None)
        )
        self.hello = {}
        self.views = []

    def close(self):
        """Close it."""
        self._open.close()

    def view_until(self, condition, what):
        """Wait for a view; return it."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            self.observer.drain()
            try:
                frame = json.loads(self._socket.recv(timeout=0.05))
            except TimeoutError:
                continue
            if frame['type'] == 'hello':
                self.hello = frame
                continue
            self.views.append(frame['view'])
            if condition(frame['view']):
                return frame['view']
        raise AssertionError(f'expected {what} but the newest view is {self.views[-1:]}')

    def get(self, path):
        """Return what is at a path."""
        with urllib.request.urlopen(f'{self.url}{path}', timeout=PATIENCE) as answer:
            return json.load(answer)

    def act(self, action, body, machine='mill'):
        """Ask for an action; return status and answer."""
        request = urllib.request.Request(
            f'{self.url}act/{machine}/{action}',
            json.dumps(body).encode(),
            {'Content-Type': 'application/json'},
        )
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as error:
            with error:
                return error.code, json.load(error)


@pytest.fixture
def open_page(graph, observer):
    """Start the page with parameters, and open it."""
    opened = []

    def start(**parameters):
        running = graph.start('dashboard', {'port': 0, **parameters}, namespace='/')
        opened.append(Page(observer, running))
        return opened[-1]

    yield start
    for page in opened:
        page.close()


def axis_of(view):
    """Return axis Y of a view, None before there is one."""
    return next((axis for axis in view['axes'] if axis['axis'] == 'Y'), None)


def compensates(view):
    """Whether offsets are in force and follow the error."""
    axis = axis_of(view)
    active = view['state']['compensation'] == 'active'
    return active and axis is not None and bool(axis['offset'])


def alarms(view, node):
    """Return the alarms of a node by name."""
    return {alarm['name']: alarm for alarm in view['alarms'] if alarm['node'] == node}


def test_a_shift_is_shown_as_it_is_and_acted_at(graph, observer, model_file, open_page, tmp_path):
    """One graph, from its start to its end and beyond, since each costs seconds to start."""
    page = open_page(bags=str(tmp_path / 'bags'))
    applied = observer.records('compensation_applied', CompensationApplied)
    told = observer.records('compensation', Compensation)
    errors = observer.records('thermal_error', ThermalError)
    samples = observer.records('temperatures', Temperatures)
    events = observer.records('node_event', NodeEvent)
    nodes = graph.start_shift(model_file, lockstep=False, rate=60.0, start_timeout=300.0)
    observer.until(lambda: applied and told and errors and samples, 'all is heard here')
    view = page.view_until(compensates, 'offsets in force')

    # Values are those of the topics.
    assert page.hello['machines'] == ['mill']
    assert view['simulated']
    assert view['silent'] == ''
    observer.until(lambda: applied[-1].stamp >= view['stamp'] * SECOND, 'the same is heard here')
    axis = axis_of(view)
    for key, records, field in (
        ('offset', applied, 'offset'),
        ('requested', told, 'offset'),
        ('predicted', errors, 'error'),
    ):
        values = {
            float(getattr(record, field)[record.axis.index('Y')])
            for record in records
            if 'Y' in record.axis
        }
        assert axis[key] in values, key
    assert list(view['sensors']['values'].values()) in [
        record.temperature.tolist() for record in samples
    ]
    assert axis['limit'] == 50e-6
    assert view['model']['runs'] == ['D0', 'D0b', 'T1']
    assert {node['lifecycle'] for node in view['nodes']} <= {'active', 'running'}

    # What was is kept.
    kept = page.get('history/mill?series=temperatures&points=50')
    assert set(kept['columns']) == set(view['sensors']['values'])
    assert page.get('history/mill?series=compensation')['columns']['Y limit']['max'][-1] > 4e-5

    # A reached limit.
    request = SetParameters.Request(
        parameters=[Parameter('offset_max', value=5e-8).to_parameter_msg()]
    )
    observer.call(SetParameters, '/mill/compensator/set_parameters', request, again=AGAIN)
    limited = page.view_until(
        lambda view: compensates(view) and 'clamp' in axis_of(view)['limited'], 'a reached limit'
    )
    assert axis_of(limited)['limit'] == 5e-8
    page.view_until(lambda view: 'size limit' in alarms(view, 'compensator'), 'its alarm')

    # What is done is done, and written down.
    status, says = page.act('reference', {'by': 'anna'})
    assert (status, says.get('needs')) == (409, 'force'), says
    assert 'in force' in says['says']
    assert page.act('probe', {'by': 'anna', 'values': {'Y': 1e-6}})[0] == 409  # simulated time
    assert page.act('activate', {'node': 'servo_controller'})[0] == 409
    status, says = page.act('record', {'by': 'anna', 'start': True})
    assert status == 200, says
    recording = page.view_until(lambda view: view['recording'], 'a recording')['recording']
    assert page.act('record', {'by': 'anna', 'start': True})[0] == 409
    assert page.act('deactivate', {'by': 'anna'})[0] == 200
    page.view_until(
        lambda view: (
            view['state']['compensation'] == 'inactive'
            and all(axis['offset'] == 0.0 for axis in view['axes'])
        ),
        'offsets at zero',
    )
    # The node that keeps the reference hears of the offsets by itself, perhaps a little later.
    observer.until(lambda: page.act('reference', {'by': 'anna'})[0] == 200, 'a reference')
    assert page.act('activate', {'by': 'anna', 'node': 'compensator'})[0] == 200
    mine = {'record', 'deactivate', 'reference', 'activate'}
    observer.until(
        lambda: mine <= {event.name for event in events if event.node == 'dashboard'}, 'events'
    )
    assert all(
        json.loads(event.request)['by'] == 'anna' for event in events if event.node == 'dashboard'
    )
    status, says = page.act('record', {'by': 'anna', 'start': False})
    assert status == 200, says
    with BagReader(tmp_path / 'bags' / recording['bag']) as bag:
        recorded = [
            item.message.name
            for item in bag.messages(['/mill/node_event'])
            if item.message.node == 'dashboard'
        ]
    assert {'deactivate', 'reference', 'activate'} <= set(recorded)
    assert [item['name'] for item in page.get('bags/')] == [recording['bag']]

    # A node that is killed, one that hangs, all of them.
    graph.kill(nodes['thermal_predictor'])
    view = page.view_until(
        lambda view: 'ended' in alarms(view, 'thermal_predictor'), 'a killed predictor'
    )
    assert 'has ended' in alarms(view, 'thermal_predictor')['ended']['cause']
    nodes['sensor_selector'].send(signal.SIGSTOP)
    page.view_until(lambda view: 'silent' in alarms(view, 'sensor_selector'), 'one that hangs')
    nodes['sensor_selector'].send(signal.SIGCONT)
    page.view_until(lambda view: not alarms(view, 'sensor_selector'), 'one that goes on')
    for name in nodes.keys() - {'thermal_predictor'}:
        graph.kill(nodes[name])
    view = page.view_until(lambda view: 'have ended' in view['silent'], 'a graph that is gone')
    assert view['silent'].startswith('no data for ')
    assert page.running.process.poll() is None
    assert page.get('history/mill?series=error')['time']


@pytest.mark.slow
def test_who_kills_the_page_touches_nothing(graph, observer, model_file, open_page):
    page = open_page()
    told = observer.records('compensation', Compensation)
    graph.start_shift(model_file, lockstep=False, rate=60.0)
    page.view_until(compensates, 'offsets in force')
    graph.kill(page.running)
    heard = len(told)
    observer.until(lambda: len(told) > heard + 5, 'it compensates on')
    assert {record.state for record in told[heard:]} == {CompensationState.ACTIVE}
    again = open_page()
    again.view_until(compensates, 'the same')
    for topic in ('temperatures', 'thermal_error', 'compensation'):
        readers = observer.node.get_subscriptions_info_by_topic(f'/mill/{topic}')
        # The one that was killed may linger.
        assert [item.node_name for item in readers].count('dashboard') in (1, 2), topic


@pytest.mark.slow
def test_a_lock_step_run_does_not_know_of_a_hundred_pages(
    graph, model_file, open_page, tmp_path, in_process, bag_hashes
):
    machine = {'duties': ('T2',), 'tick_period': 30.0, 'seed': 3}
    page = open_page()
    with ExitStack() as others:
        for _ in range(99):  # they take a few frames, and then no more
            others.enter_context(
                connect(page.live, max_queue=4, ping_interval=None, close_timeout=0)
            )
        nodes = graph.start_shift(model_file, bag=tmp_path / 'bag', **machine)
        assert nodes['simulated_machine'].wait() == 0
        assert nodes['simulated_machine'].outcome['degraded'] is False
        page.view_until(lambda view: axis_of(view), 'it was seen')
        graph.stop()
    assert bag_hashes(tmp_path / 'bag') == in_process.hashes(**machine)


def publish_readings(observer, broken):
    """Tell two temperatures ten times a second; the names in `broken` have none."""
    publisher = observer.node.create_publisher(
        message_class(Temperatures.TYPE), 'sensor_readings', publisher_qos(Durability.STREAM)
    )

    def tell():
        names = ('t1', '<b>t2</b>\x1b[2J')
        record = Temperatures(
            stamp=time.time_ns(),
            sensor=names,
            temperature=np.array([np.nan if name in broken else 20.0 for name in names]),
            status=np.array([int(name in broken) for name in names], np.uint8),
            readings=1,
        )
        publisher.publish(encode(record, RCLPY))

    observer.node.create_timer(0.1, tell)


def test_a_pulled_sensor_is_named_and_a_probe_is_told(graph, observer, open_page):
    graph.start('temperature_acquisition', {'interval': 0.2})
    broken = set()
    publish_readings(observer, broken)
    probes = observer.records('displacement', Displacement)
    page = open_page()
    view = page.view_until(lambda view: view['sensors']['ok'] == 2, 'two sensors')
    odd = '<b>t2</b>\\x1b[2J'
    assert view['sensors']['values'] == {'t1': 20.0, odd: 20.0}
    assert not view['simulated']
    broken.add('<b>t2</b>\x1b[2J')
    view = page.view_until(lambda view: view['sensors']['missing'], 'a bad sensor')
    assert view['sensors']['missing'] == [{'name': odd, 'why': 'no reading'}]
    view = page.view_until(lambda view: 'sensors' in alarms(view, 'temperature_acquisition'), 'it')

    status, says = page.act('probe', {'by': 'anna', 'values': {'Y': -3e-6}, 'deviation': 1e-6})
    assert status == 200, says
    assert 'Y -3.00 µm' in says['says']
    observer.until(lambda: probes, 'the probe')
    (heard,) = probes
    assert (heard.axis, heard.displacement.tolist()) == (('Y',), [-3e-6])
    assert heard.standard_deviation.tolist() == [1e-6]
    assert not heard.includes_compensation
    for values in ({}, {'Q': 1e-6}, {'Y': 1.0}, {'Y': 'x'}, {'Y': True}, 5, {'Y': None}):
        status, says = page.act('probe', {'values': values})
        assert (status, says['done']) == (409, False), values
    assert page.act('probe', {'values': {'Y': 1e-6}, 'deviation': -1})[0] == 409
    assert page.act('reference', {'by': 7})[0] == 409
    assert page.act('reference', {'by': 'x' * 100})[0] == 409
    assert page.act('deactivate', {'node': '../x'})[0] == 409
    assert page.act('record', {'start': True})[0] == 409  # no folder for bags
    assert len(probes) == 1


def test_others_reach_it_encrypted_and_with_a_token_only(graph, observer, tmp_path):
    pytest.importorskip('cryptography')
    state = tmp_path / 'state'
    settings = {'listen': '0.0.0.0', 'port': 0, 'state_directory': str(state)}
    running = graph.start('dashboard', settings, namespace='/')
    observer.until(lambda: 'live page: ' in running.output, running.output)
    secret = (state / 'token').read_text().strip()
    assert running.output.count(secret) == 1
    assert 'certificate SHA-256 ' in running.output
    assert {file.stat().st_mode & 0o777 for file in (state / 'token', state / 'key.pem')} == {
        0o600
    }
    port = re.findall(r'live page: https://0\.0\.0\.0:(\d+)/', running.output)[0]
    context = ssl.create_default_context(cafile=str(state / 'certificate.pem'))
    with connect(f'wss://localhost:{port}/live', ssl=context) as client:
        hello = json.loads(client.recv(timeout=PATIENCE))
    assert (hello['needs_token'], hello['writable']) == (True, True)
    assert running.interrupt() == 0
    again = graph.start('dashboard', settings, namespace='/')
    observer.until(lambda: 'live page: ' in again.output, again.output)
    assert secret not in again.output


@pytest.fixture
def beside(domain, monkeypatch, tmp_path):
    """Return what `up --page --params` makes of a file: its greeting, and the page itself."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.chdir(tmp_path)
    with ExitStack() as stack:

        def make(text):
            (tmp_path / 'dashboard.yaml').write_text(text)
            console = Console(file=io.StringIO(), width=200)
            files = [tmp_path / 'dashboard.yaml']
            page, spec = stack.enter_context(page_process(console, 0, params=files))
            return console.file.getvalue(), page, spec

        yield make


def test_a_page_beside_a_graph_keeps_to_its_file(beside, tmp_path):
    """Its port, its token and its folder of bags; a token that is ignored lets everybody act."""
    text = '/**/dashboard:\n  ros__parameters: {port: 0, token_file: tok, bags: bags}\n'
    (tmp_path / 'tok').write_text(16 * 'x')
    with pytest.raises(GraphError, match=r'token tok: .* mode 644; run chmod 600 tok'):
        beside(text)
    (tmp_path / 'tok').chmod(0o600)
    greeting, page, spec = beside(text)
    assert 'live page: a free port, see ' in greeting
    assert 'acting there needs the token in tok' in greeting
    assert 'needs a folder' not in greeting
    page.start(spec)
    log = page.log('dashboard')
    wait_for(lambda: 'live page: ' in log.read_text(), 'the page is served')
    (url,) = re.findall(r'live page: (\S+)', log.read_text())
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(urllib.request.Request(f'{url}act/mill/deactivate', b'{}'))
    with refused.value as answer:
        assert answer.code == 401
    with connect(url.replace('http', 'ws', 1) + 'live') as client:
        hello = json.loads(client.recv(timeout=PATIENCE))
    assert (hello['needs_token'], hello['recordable']) == (True, True)


def test_a_page_without_a_folder_says_how_to_record(beside):
    greeting, _, _ = beside('/**/dashboard:\n  ros__parameters: {port: 0}\n')
    assert 'Start recording there needs a folder for bags: the parameter bags' in greeting


def test_what_cannot_be_served_is_refused(refusal, graph, observer, tmp_path):
    running = graph.start('dashboard', {'port': 0}, namespace='/')
    observer.until(lambda: 'live page: ' in running.output, running.output)
    port = int(re.findall(r':(\d+)/', running.output)[0])
    assert f'found {port}' in refusal('dashboard', {'port': port})
    assert 'token' in refusal('dashboard', {'port': 0, 'token_file': str(tmp_path / 'none')})
    assert 'interval' in refusal('dashboard', {'interval': 0.0})
    short = {'certificate': str(tmp_path / 'none.pem'), 'private_key': str(tmp_path / 'key.pem')}
    assert 'none.pem' in refusal('dashboard', {'port': 0, **short})

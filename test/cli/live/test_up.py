# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up`: which nodes, with which parameters; back-off, giving up, what is shown."""

import io
import math
import os
import signal
import threading
from pathlib import Path

import pytest
from processes import HANG, wait_for
from rich.console import Console

from fuzzycnc_ros.cli.live import graph_processes
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.cli.live.supervision import ProcessState, Supervisor
from fuzzycnc_ros.cli.live.supervision_run import _end
from fuzzycnc_ros.cli.live.supervision_view import ProcessView, row, table
from fuzzycnc_ros.graph import bring_up
from fuzzycnc_ros.graph.bring_up import (
    RECORDER_STOP,
    THERMAL,
    NodeSpec,
    RestartPolicy,
    node_specs,
)
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.ros import processes
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.runtime.component import Level

POLICY = RestartPolicy(delay=0.5, delay_max=4.0, restarts_max=5, window=100.0, silence_max=60.0)


class Processes:
    """Stands for processes: what was started, and what has ended with which code."""

    def __init__(self, machine='mill'):
        self.machine = machine
        self.started = []
        self.codes = {}
        self.signals = []
        self.time = 0.0

    def worked(self, name):
        return self.time

    def signal(self, name, number):
        self.signals.append((name, number))

    def start(self, *specs):
        self.started.append(specs)
        self.codes.pop(specs[0].name, None)

    def poll(self):
        return dict(self.codes)

    def pid(self, name):
        return len(self.started)

    def last_words(self, name):
        return f'{name} said this'

    def starved(self, name):
        return ''


class Lifecycles:
    """Stands for what managed nodes tell."""

    def __init__(self):
        self.states = {}
        self.active = set()
        self.heard = {}

    def heard_at(self, machine, node):
        return self.heard.get(node, 0.0)

    def say(self, node, state):
        self.states[node] = state
        if state == 'active':
            self.active.add(node)

    def begin(self, machine, node):
        self.states.pop(node, None)
        self.active.discard(node)
        self.heard.pop(node, None)

    def lifecycle(self, machine, node):
        return self.states.get(node, '')

    def was_active(self, machine, node):
        return node in self.active


class Bench:
    """A supervisor with its surroundings."""

    def __init__(self, *specs):
        self.said = []
        self.graph, self.lifecycles = Processes(), Lifecycles()
        self.supervisor = Supervisor(self.said.append, self.lifecycles, POLICY)
        self.processes = [self.supervisor.start(self.graph, [spec]) for spec in specs]
        self.now = 0.0

    def listen(self, duration, *nodes):
        """Let time pass in which some nodes report every second [s]."""
        for _ in range(round(duration)):
            self.now += 1.0
            self.lifecycles.heard.update(dict.fromkeys(nodes, self.now))
            self.supervisor.poll(self.now)

    def end(self, name, code, after=0.0):
        """Let a process end; return when it is started again, None if it is not."""
        self.now += after
        self.graph.codes[name] = code
        self.supervisor.poll(self.now)
        process = next(item for item in self.processes if item.name == name)
        if process.state is not ProcessState.WAITING:
            return None
        count, ended = len(self.graph.started), self.now
        while len(self.graph.started) == count:
            self.now += 0.125
            assert self.now - ended < 100.0
            self.supervisor.poll(self.now)
        return self.now - ended


def test_restarts_come_ever_later_and_end():
    bench = Bench(NodeSpec('thermal_predictor'))
    delays = [bench.end('thermal_predictor', -9) for _ in range(5)]
    assert delays == [0.5, 1.0, 2.0, 4.0, 4.0]
    assert not bench.supervisor.given_up
    assert bench.end('thermal_predictor', -9) is None
    assert bench.supervisor.given_up == ['mill/thermal_predictor']
    assert bench.supervisor.restarts == {'mill/thermal_predictor': 5}
    assert bench.said[-1] == (
        'mill/thermal_predictor was killed by SIGKILL; given up after 5 restarts within 100 s'
    )
    count = len(bench.graph.started)
    bench.supervisor.poll(bench.now + 1000.0)
    assert len(bench.graph.started) == count


def test_old_restarts_do_not_count():
    bench = Bench(NodeSpec('thermal_predictor'))
    for _ in range(20):
        assert bench.end('thermal_predictor', 1, after=101.0) == 0.5
    assert (
        'ended with code 1: thermal_predictor said this; starts again in 0.5 s' in (bench.said[-2])
    )


def test_what_is_beside_the_run_is_started_again_and_never_ends_it():
    """The live page: not by its death, not by refused parameters, not by being given up."""
    bench = Bench(NodeSpec('compensator'))
    page = bench.supervisor.start(bench.graph, [NodeSpec('dashboard')], beside=True)
    bench.processes.append(page)
    assert bench.end('dashboard', 1) == 0.5
    assert bench.end('dashboard', 2) is None
    assert page.state is ProcessState.GIVEN_UP
    assert (bench.supervisor.given_up, bench.supervisor.over) == ([], False)
    refused = bench.supervisor.start(bench.graph, [NodeSpec('dashboard')], beside=True)
    bench.graph.codes['dashboard'] = 2
    bench.supervisor.poll(bench.now)
    assert refused.state is ProcessState.GIVEN_UP


def test_others_are_left_alone():
    bench = Bench(NodeSpec('thermal_predictor'), NodeSpec('compensator'))
    bench.end('thermal_predictor', -9)
    assert [specs[0].name for specs in bench.graph.started] == [
        'thermal_predictor',
        'compensator',
        'thermal_predictor',
    ]


def test_parameters_that_are_refused_end_the_run_at_the_start():
    bench = Bench(NodeSpec('compensator'))
    with pytest.raises(GraphError, match='mill/compensator ended with code 2: compensator said'):
        bench.end('compensator', 2)


def test_parameters_that_are_refused_later_give_the_node_up():
    bench = Bench(NodeSpec('compensator'))
    bench.end('compensator', -9)
    assert bench.end('compensator', 2) is None
    assert bench.supervisor.given_up == ['mill/compensator']


def test_run_is_over_with_the_machine_and_fails_with_it():
    bench = Bench(NodeSpec('compensator'), NodeSpec('simulated_machine'))
    assert not bench.supervisor.over
    bench.end('simulated_machine', 0)
    assert bench.supervisor.over
    bench = Bench(NodeSpec('compensator'), NodeSpec('simulated_machine'))
    with pytest.raises(GraphError, match='mill/simulated_machine was killed by SIGKILL'):
        bench.end('simulated_machine', -9)


def test_node_that_says_nothing_any_more_is_started_anew():
    """Asked first, killed if it stands still; it is named with what was the matter."""
    bench = Bench(NodeSpec('compensator'), NodeSpec('recorder', {'output': 'bag'}))
    bench.listen(10, 'compensator', 'recorder')
    bench.listen(60, 'compensator')
    assert bench.graph.signals == []
    bench.listen(2, 'compensator')
    assert bench.graph.signals == [('recorder', signal.SIGTERM)]
    assert bench.said[-1] == 'mill/recorder said nothing for 61 s; it is ended'
    bench.listen(RECORDER_STOP - 1, 'compensator')
    assert len(bench.graph.signals) == 1
    bench.listen(1, 'compensator')
    assert bench.graph.signals[1:] == [('recorder', signal.SIGKILL)]
    assert bench.end('recorder', -9) == 0.5
    assert 'mill/recorder fell silent and was killed by SIGKILL; ' in bench.said[-2]
    # Until it has spoken in its new life nothing is known of it.
    bench.listen(200, 'compensator')
    assert len(bench.graph.signals) == 2
    bench.listen(1, 'recorder')
    bench.listen(61, 'compensator')
    assert bench.graph.signals[2:] == [('recorder', signal.SIGTERM)]
    assert bench.end('recorder', 0) == 0.5  # the last restart was long ago
    assert 'mill/recorder fell silent and was ended; starts again' in bench.said[-2]


def test_who_stood_still_itself_ends_nobody():
    """Nor does who hears nobody: the network may be down, or all of them may stand still."""
    bench = Bench(NodeSpec('compensator'), NodeSpec('thermal_predictor'))
    bench.listen(10, 'compensator', 'thermal_predictor')
    bench.now += 1000.0
    bench.listen(50, 'compensator')
    bench.listen(300)
    bench.listen(59, 'compensator')
    assert bench.graph.signals == []
    bench.listen(3, 'compensator')
    assert bench.graph.signals == [('thermal_predictor', signal.SIGTERM)]


def test_who_computes_is_not_ended_for_its_silence():
    """A scheduler may have a program of a million lines; it ends its work, and hangs later."""
    bench = Bench(NodeSpec('compensator'), NodeSpec('feedrate_scheduler'))
    bench.listen(10, 'compensator', 'feedrate_scheduler')
    for _ in range(200):
        bench.listen(1, 'compensator')
        bench.graph.time += 0.5
    bench.listen(300, 'compensator', 'feedrate_scheduler')
    assert bench.graph.signals == []
    bench.listen(65, 'compensator')
    assert bench.graph.signals == [('feedrate_scheduler', signal.SIGTERM)]


@pytest.mark.ros
def test_time_that_a_process_has_used_is_read(tmp_path):
    graph = GraphProcesses('mill', folder=tmp_path)
    with graph:
        graph.start(NodeSpec('compensator'))
        process = graph._processes['compensator']
        wait_for(lambda: graph.worked('compensator') > 0.1, 'the process has computed')
        process.kill()
        process.wait(HANG)
        assert graph.worked('compensator') == 0.0


def test_what_makes_time_is_not_ended_for_its_silence():
    bench = Bench(NodeSpec('compensator'), NodeSpec('simulated_machine'))
    bench.listen(10, 'compensator', 'simulated_machine')
    bench.listen(200, 'compensator')
    assert bench.graph.signals == []


def test_without_a_machine_the_run_is_over_when_all_are_given_up():
    bench = Bench(NodeSpec('compensator'))
    for _ in range(6):
        assert not bench.supervisor.over
        bench.end('compensator', -9)
    assert bench.supervisor.over


@pytest.mark.parametrize(
    ('autostart', 'states', 'again'),
    [
        (True, ['unconfigured', 'inactive', 'active'], True),
        (True, ['active', 'inactive'], False),  # the operator has switched it off
        (True, ['unconfigured'], True),  # it died before it got so far
        (True, [], True),
        (False, ['unconfigured', 'inactive', 'active'], False),  # the operator activates
    ],
)
def test_managed_node_comes_back_as_it_was(autostart, states, again):
    bench = Bench(NodeSpec('compensator', {'autostart': autostart}))
    for state in states:
        bench.lifecycles.say('compensator', state)
    bench.end('compensator', -9)
    assert bench.graph.started[-1][0].parameters == {'autostart': again}


def test_node_that_was_switched_off_stays_off_however_often_it_dies():
    bench = Bench(NodeSpec('compensator', {'autostart': True}))
    for state in ('active', 'inactive'):
        bench.lifecycles.say('compensator', state)
    for _ in range(3):
        bench.end('compensator', -9)
        assert bench.graph.started[-1][0].parameters == {'autostart': False}


def test_node_that_died_on_its_way_is_still_brought_up():
    bench = Bench(NodeSpec('compensator', {'autostart': True}))
    bench.lifecycles.say('compensator', 'active')
    for _ in range(3):
        bench.end('compensator', -9)
        bench.lifecycles.say('compensator', 'unconfigured')
    assert bench.graph.started[-1][0].parameters == {'autostart': True}


def test_recorder_goes_on_in_another_bag():
    bench = Bench(NodeSpec('recorder', {'output': '/data/shift_again'}))
    for number in (1, 2, 3):
        bench.end('recorder', -9)
        output = bench.graph.started[-1][0].parameters['output']
        assert output == f'/data/shift_again_again{number}'


def parameters(**wanted):
    return {spec.name: dict(spec.parameters) for spec in node_specs(**wanted)}


def test_any_components_in_the_order_of_their_turns():
    makes_time = ('simulated_machine', 'simulated_body')
    everything = [name for name in COMPONENTS if name not in makes_time]
    assert list(parameters(nodes=everything[::-1])) == everything
    assert list(parameters(nodes=['servo_controller'])) == ['servo_controller']
    assert list(parameters(duties=('T2',), feedrate=True, record=Path('bag'))) == [
        *THERMAL,
        'feedrate_scheduler',
        'recorder',
        'simulated_machine',
    ]


def test_body_of_a_controller_makes_time_and_starts_last():
    found = parameters(nodes=['simulated_body', 'linuxcnc_bridge', 'compensator'])
    assert list(found)[-1] == 'simulated_body'
    assert found['simulated_body'] == {'nodes': ['linuxcnc_bridge', 'compensator']}
    assert all(found[name]['use_sim_time'] for name in ('linuxcnc_bridge', 'compensator'))
    with pytest.raises(GraphError, match='each makes time, not both'):
        parameters(nodes=['simulated_body'], duties=('T2',))


def test_parameters_follow_from_what_is_wanted():
    found = parameters(
        nodes=[name for name in COMPONENTS if name != 'simulated_body'],
        model=Path('m.json'),
        autostart=True,
        state_directory=Path('/s'),
    )
    for name, component in COMPONENTS.items():
        if name in ('simulated_machine', 'simulated_body'):
            continue
        kept = any(item.persistent for item in component.OUTPUTS)
        assert found[name].get('autostart') is (True if component.MANAGED else None)
        assert found[name].get('state_directory') == ('/s' if kept else None)
        assert found[name]['use_sim_time'] is True
    assert found['thermal_predictor']['model'] == 'm.json'
    assert 'force' not in found['thermal_predictor']
    assert parameters(force_model=True)['thermal_predictor']['force'] is True
    assert 'duties' not in found['simulated_machine']
    assert 'use_sim_time' not in parameters(autostart=True)['compensator']
    assert parameters(duties=('T2',), lockstep=True)['simulated_machine']['lockstep_nodes'] == [
        *THERMAL
    ]


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        (('--nodes', 'compensator,baker'), ['compensator', 'but found baker']),
        (('--nodes', 'recorder'), ['recorder needs a bag', '--record']),
        (('--lockstep',), ['--lockstep needs a simulated machine']),
        (('--machine', ','), ['--machine: expected a name']),
        (('--params', '.'), ['expected files <node>.yaml']),
    ],
)
def test_refusals(refused, arguments, naming):
    refused('up', *arguments, naming=naming)


class Views(dict):
    """Stands for the monitor."""

    def view(self, machine, node):
        return self[node]


class Said:
    """What a node says of itself."""

    def __init__(self, **changes):
        values = {
            'heard_at': 10.0,
            'lifecycle': '',
            'was_active': False,
            'level': Level.OK,
            'trouble': (),
            'activity': {'rate [1/s]': '5.0', 'latency [ms]': '1.25'},
        }
        self.__dict__.update(values | changes)

    def silent(self, now):
        return self.heard_at > 0.0 and now - self.heard_at > 5.0


def test_row_shows_state_rate_latency_and_limits():
    bench = Bench(NodeSpec('compensator', {'autostart': True}))
    process = bench.processes[0]
    trouble = ('slew limit: slew limit active on Y',)
    said = Said(lifecycle='active', level=Level.WARN, trouble=trouble)
    assert row(process, 'compensator', said, 11.0) == (
        'mill/compensator',
        'active',
        '',
        '5.0',
        '1.25',
        'slew limit: slew limit active on Y',
    )
    assert row(process, 'compensator', said, 17.0)[1:4] == ('silent for 7 s', '', '')
    assert row(process, 'compensator', Said(heard_at=0.0), 17.0)[1] == 'starting'
    bench.graph.codes['compensator'] = -11
    bench.supervisor.poll(0.0)
    cells = row(process, 'compensator', said, 11.0)
    assert cells[1] == 'starts again'
    assert cells[3:] == ('', '', 'was killed by SIGSEGV')


def test_table_has_a_row_per_node_and_cuts_no_line():
    bench = Bench(NodeSpec('compensator'), NodeSpec('sensor_selector'))
    views = Views(compensator=Said(trouble=('x' * 500,)), sensor_selector=Said())
    out = io.StringIO()
    Console(file=out, width=100).print(table(bench.processes, views, 11.0))
    lines = out.getvalue().splitlines()
    assert len(lines) == 3
    assert [line.split()[0] for line in lines[1:]] == ['mill/compensator', 'mill/sensor_selector']
    assert max(map(len, lines)) <= 100


def test_elsewhere_only_changes_are_written():
    bench = Bench(NodeSpec('compensator', {'autostart': True}))
    out = io.StringIO()
    view = ProcessView(Console(file=out, width=100))
    views = Views()
    for changes in (
        {'heard_at': 0.0},
        {'lifecycle': 'inactive'},
        {'lifecycle': 'active'},
        {'lifecycle': 'active', 'level': Level.ERROR, 'trouble': ('state: ramping for 1 s',)},
        {'lifecycle': 'active', 'level': Level.ERROR, 'trouble': ('state: ramping for 2 s',)},
        {'lifecycle': 'active'},
        {'heard_at': 0.0},
        {'lifecycle': 'active'},
    ):
        views['compensator'] = Said(**{'heard_at': math.inf, **changes})
        view.update(bench.processes, views)
    assert out.getvalue().splitlines() == [
        'mill/compensator: inactive',
        'mill/compensator: active',
        'mill/compensator: state: ramping for 1 s',
        'mill/compensator: recovered',
        'mill/compensator: active',
    ]


def test_elsewhere_silence_is_written():
    """A node that was stopped says nothing itself, and the others only that they miss it."""
    bench = Bench(NodeSpec('compensator'), NodeSpec('sensor_selector'))
    out = io.StringIO()
    view = ProcessView(Console(file=out, width=100))
    views = Views(compensator=Said(heard_at=math.inf))
    for heard_at in (math.inf, 10.0, 10.0, math.inf, 10.0):
        views['sensor_selector'] = Said(heard_at=heard_at)
        view.update(bench.processes, views)
    bench.graph.codes['sensor_selector'] = -9
    bench.supervisor.poll(0.0)
    view.update(bench.processes, views)
    silent = 'mill/sensor_selector: silent, though its process runs: it hangs, was stopped, or the'
    assert [line[: len(silent)] for line in out.getvalue().splitlines()] == [
        silent,
        'mill/sensor_selector: heard again',
        silent,
    ]


@pytest.fixture
def plain_environment(monkeypatch):
    """Nothing said about who may find whom."""
    for name in (*processes.CHOSEN, 'FASTRTPS_DEFAULT_PROFILES_FILE'):
        monkeypatch.setenv(name, '')
        monkeypatch.delenv(name)
    return monkeypatch


def test_discovery_stays_on_this_host(plain_environment):
    processes.prepare_environment()
    assert os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'
    assert Path(os.environ['FASTRTPS_DEFAULT_PROFILES_FILE']).is_file()


def test_discovery_is_opened_on_request(plain_environment):
    processes.open_to_network()
    processes.prepare_environment()
    assert os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'SUBNET'


@pytest.mark.parametrize(
    'name', ['ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY', 'ROS_DISCOVERY_SERVER']
)
def test_what_the_user_has_chosen_stands(plain_environment, name):
    plain_environment.setenv(name, '10.0.0.7')
    processes.open_to_network()
    processes.prepare_environment()
    assert 'ROS_AUTOMATIC_DISCOVERY_RANGE' not in os.environ


SLOW_NODE = """#!/bin/sh
trap 'while [ ! -e room ]; do sleep 0.01; done; exit 0' TERM
touch "ready-$2"
while :; do sleep 0.01; done
"""
"""Stands for the Python of a node that ends when there is room for what it holds."""


def test_who_writes_a_bag_or_waits_for_one_has_time_to_end(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('node').write_text(SLOW_NODE)
    Path('node').chmod(0o755)
    monkeypatch.setattr(graph_processes.sys, 'executable', str(tmp_path / 'node'))
    monkeypatch.setattr(bring_up, 'NODE_STOP', 0.0)
    monkeypatch.setattr(bring_up, 'RECORDER_STOP', HANG)

    with GraphProcesses('mill', folder=tmp_path / 'log') as graph:
        names = ('compensator', 'recorder', 'dashboard')
        for name in names:
            graph.start(NodeSpec(name))
            wait_for(Path(f'ready-fuzzycnc_ros.nodes.{name}').exists, name)

        def make_room():
            wait_for(lambda: 'compensator' in graph.poll(), 'the end of the first one')
            Path('room').touch()

        room = threading.Thread(target=make_room)
        room.start()
        graph.stop()
        room.join()
        assert graph.poll() == {'compensator': -9, 'recorder': 0, 'dashboard': 0}


def test_nodes_end_along_the_way_of_a_reading():
    ended = []

    class Graph:
        names = ('compensator', 'recorder', 'temperature_acquisition', 'simulated_machine')

        def interrupt(self, name):
            return [name]

        def wait_ended(self, names):
            ended.extend(names)

    _end([Graph()])
    assert ended == ['simulated_machine', 'temperature_acquisition', 'compensator', 'recorder']

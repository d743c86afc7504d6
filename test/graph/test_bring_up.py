# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The table that `up` and the launch file follow: both start the same."""

from pathlib import Path

import pytest

from fuzzycnc_ros.graph.bring_up import (
    ADDED,
    LAUNCH_ARGUMENTS,
    THERMAL,
    NodeSpec,
    RestartPolicy,
    again,
    launched,
    node_specs,
)
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.ros.presence import MACHINE, GraphError

ROOT = Path(__file__).parents[2]
PARAMS = ROOT / 'params'


def launch(tmp_path, **given):
    """Return the nodes that launch arguments mean."""
    values = {name: item.default for name, item in LAUNCH_ARGUMENTS.items()}
    assert set(given) <= set(values)
    return launched(values | given, PARAMS, tmp_path)


def test_every_node_is_in_both():
    """But the nodes without a component: arguments of their own start recorder and page."""
    nodes = {path.stem for path in PARAMS.glob('*.yaml')}
    reports = {'mqtt_publisher', 'mtconnect_adapter', 'opcua_server'}
    assert nodes - {'player', 'recorder', 'dashboard'} - reports == {*COMPONENTS}
    assert {*THERMAL, *ADDED.values(), MACHINE} == {*COMPONENTS}
    managed = {name for name, item in COMPONENTS.items() if item.MANAGED}
    found = {spec.name: spec for spec in node_specs(nodes=[*managed], autostart=True)}
    assert all(found[name].parameters['autostart'] is True for name in managed)


@pytest.mark.parametrize(
    ('arguments', 'wanted'),
    [
        ({}, {'nodes': [*THERMAL, MACHINE], 'autostart': True}),
        ({'simulated': 'false'}, {}),
        ({'simulated': 'false', 'autostart': 'true', 'linuxcnc': 'true'},
         {'nodes': [*THERMAL, 'linuxcnc_bridge'], 'autostart': True}),
        ({'duties': 'T2,T3', 'rate': '600', 'model': 'mill.json', 'force_model': 'true'},
         {'duties': ('T2', 'T3'), 'machine_parameters': {'rate': 600.0}, 'autostart': True,
          'model': Path('mill.json'), 'force_model': True}),
        ({'lockstep': 'true', 'record': 'bag', 'feedrate': 'true'},
         {'nodes': [*THERMAL, MACHINE], 'feedrate': True, 'lockstep': True, 'autostart': True,
          'record': Path('bag')}),
        ({'nodes': 'servo_controller', 'autostart': 'false'},
         {'nodes': ['servo_controller', MACHINE]}),
    ],
)  # fmt: skip
def test_launch_and_up_start_the_same(tmp_path, monkeypatch, arguments, wanted):
    monkeypatch.chdir(tmp_path)
    Path('mill.json').touch()
    items = launch(tmp_path, **arguments)
    state = tmp_path / 'state' / 'mill'
    assert [item.spec for item in items] == node_specs(**wanted, state_directory=state)
    for item in items:
        assert (item.machine, item.remap) == ('mill', ())
        assert item.files == (PARAMS / f'{item.spec.name}.yaml',)
        assert item.files[0].is_file()


def test_machines_have_names_bags_and_clocks_of_their_own(tmp_path):
    items = launch(tmp_path, machine='mill_1, mill_2', record='bags/shift')
    assert {item.machine for item in items} == {'mill_1', 'mill_2'}
    assert all(item.remap == ('/clock:=clock',) for item in items)
    bags = [item.spec.parameters['output'] for item in items if item.spec.name == 'recorder']
    assert bags == ['bags/shift_mill_1', 'bags/shift_mill_2']
    items = launch(tmp_path, machine='shop/mill,shop_mill', record='bags/shift')
    bags = [item.spec.parameters['output'] for item in items if item.spec.name == 'recorder']
    assert bags == ['bags/shift_shop-mill', 'bags/shift_shop_mill']
    states = {item.spec.parameters.get('state_directory') for item in items} - {None}
    assert len(states) == 2


def test_clock_is_as_asked_for(tmp_path):
    items = launch(tmp_path, use_sim_time='false')
    assert not any(item.spec.parameters.get('use_sim_time') for item in items)
    items = launch(tmp_path, simulated='false', use_sim_time='true')
    assert all(item.spec.parameters['use_sim_time'] for item in items)


def test_a_folder_of_parameters_is_read_whole(tmp_path):
    (tmp_path / 'all.yaml').touch()
    assert {item.files for item in launch(tmp_path, params_dir=str(tmp_path))} == {
        (tmp_path / 'all.yaml',)
    }


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        ({'params_dir': 'nowhere'}, 'params_dir: nowhere: expected files <node>.yaml'),
        ({'machine': ','}, 'machine: expected a name'),
        ({'machine': '1/x'}, 'machine: expected a name such as mill_1'),
        ({'model': 'nowhere.json'}, 'model: expected a file'),
        ({'rate': 'fast'}, "rate: expected a number but found 'fast'"),
        ({'autostart': 'perhaps'}, "autostart: expected true or false but found 'perhaps'"),
        ({'nodes': 'compresor'}, 'nodes: expected names among'),
        ({'linuxcnc': 'true'}, 'linuxcnc_bridge, simulated_machine'),
        ({'simulated': 'false', 'linuxcnc': 'true', 'opcua': 'true'}, 'opcua_bridge'),
        (
            {'feedrate': 'true', 'joint_trajectory': 'true', 'lockstep': 'true'},
            'feedrate_scheduler or joint_trajectory_bridge in lock-step',
        ),
    ],
)
def test_bad_arguments_are_named(tmp_path, arguments, naming):
    with pytest.raises((GraphError, ValueError), match=naming):
        launch(tmp_path, **arguments)


def test_restarts_come_ever_later_and_end():
    policy = RestartPolicy(delay=0.5, delay_max=3.0, restarts_max=4, window=100.0)
    delays = [policy.delay_after(list(range(count)), 50.0) for count in range(5)]
    assert delays == [0.5, 1.0, 2.0, 3.0, None]
    assert policy.delay_after([0.0, 1.0, 2.0, 3.0], 102.5) == 1.0


def test_what_is_started_anew_goes_on_where_it_was():
    compensator = NodeSpec('compensator', {'autostart': True, 'lockstep': False})
    assert again(compensator, 1, resume=False).parameters['autostart'] is False
    assert again(compensator, 1, resume=True) == compensator
    recorder = NodeSpec('recorder', {'output': 'bag'})
    names = []
    for count in (1, 2, 3):
        recorder = again(recorder, count, resume=False)
        names.append(recorder.parameters['output'])
    assert names == ['bag_again1', 'bag_again2', 'bag_again3']


@pytest.mark.parametrize('machines', ['mill,mill_again1', 'shop/mill_again12,saw,shop/mill'])
def test_no_restart_records_into_the_bag_of_another_machine(tmp_path, machines):
    with pytest.raises(GraphError, match=r'name without _again\d+ beside (shop/)?mill, since a'):
        launch(tmp_path, machine=machines, record='bag')
    assert launch(tmp_path, machine=machines)  # nothing is recorded
    # Without the other one the name is as good as any.
    for names in ('mill_again1,lathe', 'mill,mill_again', 'mill/again1,mill'):
        started = launch(tmp_path, machine=names, record='bag')
        outputs = [item.spec.parameters.get('output') for item in started]
        assert len({*outputs} - {None}) == 2


def test_a_probing_cycle_needs_a_control_that_keeps_its_own_time():
    with pytest.raises(GraphError, match=r'expected no probe_cycle in lock-step'):
        node_specs(nodes=('probe_cycle',), duties=('T1',), lockstep=True)
    specs = node_specs(nodes=('probe_cycle', 'linuxcnc_bridge'))
    assert [spec.name for spec in specs] == ['linuxcnc_bridge', 'probe_cycle']

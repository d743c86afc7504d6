# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc security write`: the form of the policies, and what they forbid."""

import posixpath
import shlex
from xml.etree import ElementTree

import pytest

from fuzzycnc_ros.graph.access import PRETENDERS, TOOLS
from fuzzycnc_ros.registry import COMPONENTS

NODES = [name for name in (*COMPONENTS, *TOOLS) if name not in PRETENDERS]
FORM = {
    'policy': ({'version'}, {'enclaves'}),
    'enclaves': (set(), {'enclave'}),
    'enclave': ({'path'}, {'profiles'}),
    'profiles': (set(), {'profile'}),
    'profile': ({'ns', 'node'}, {'topics', 'services', 'actions'}),
}
"""Attributes and children of each element; all are needed, and every element has a child."""
GROUPS = {
    'topics': ('topic', {'publish', 'subscribe'}),
    'services': ('service', {'reply', 'request'}),
    'actions': ('action', {'execute', 'call'}),
}


def check_form(element):
    """Refuse what the format of policies, version 0.2.0, does not know."""
    if element.tag in GROUPS:
        item, rules = GROUPS[element.tag]
        assert element.attrib
        assert set(element.attrib) <= rules
        assert set(element.attrib.values()) == {'ALLOW'}
        assert [(child.tag, dict(child.attrib)) for child in element] == [
            (item, {}) for _ in element
        ]
        names = [child.text for child in element]
        assert names
        assert len(set(names)) == len(names)
        assert all(name and name == name.strip() for name in names)
        return
    attributes, children = FORM[element.tag]
    assert set(element.attrib) == attributes
    assert {child.tag for child in element} <= children
    assert len(element)
    for child in element:
        check_form(child)


def rights(file, rule):
    """Return the absolute names that a policy allows something with."""
    found = set()
    for profile in ElementTree.parse(file).iter('profile'):
        space, node = profile.get('ns'), profile.get('node')
        for group in profile:
            for child in group if rule in group.attrib else ():
                name = child.text.replace('~', node, 1)
                found.add(posixpath.join(space, name))
    return found


@pytest.fixture
def written(fuzzycnc, tmp_path):
    """Write policies; return their folder and the lines that were printed."""

    def write(*words):
        outcome = fuzzycnc('security', 'write', tmp_path / 'policies', *words)
        assert outcome.code == 0, outcome.err
        return tmp_path / 'policies', outcome.out.splitlines()

    return write


def test_every_node_gets_a_policy_of_the_right_form_and_its_commands(written):
    folder, lines = written('--machine', 'mill,shop/lathe', '--keystore', 'my keys')
    files = sorted(str(file.relative_to(folder)) for file in folder.rglob('*.xml'))
    machines = ('mill', 'shop/lathe')
    assert files == sorted(f'{m}/{node}.policy.xml' for m in machines for node in NODES)
    commands = [shlex.split(line) for line in lines if not line.startswith('#')]
    assert commands[0] == ['ros2', 'security', 'create_keystore', 'my keys']
    expected = []
    for machine in machines:
        for node in NODES:
            file, enclave = folder / machine / f'{node}.policy.xml', f'/{machine}/{node}'
            root = ElementTree.parse(file).getroot()
            assert (root.tag, root.get('version')) == ('policy', '0.2.0')
            check_form(root)
            assert [item.get('path') for item in root.iter('enclave')] == [enclave]
            first = next(root.iter('profile'))
            assert (first.get('ns'), first.get('node')) == (f'/{machine}', node)
            expected += [
                ['ros2', 'security', 'create_enclave', 'my keys', enclave],
                ['ros2', 'security', 'create_permission', 'my keys', enclave, str(file)],
            ]
    assert commands[1:] == expected


@pytest.mark.parametrize(
    ('topic', 'writers'),
    [
        ('compensation', {'compensator'}),
        ('axis_command', {'servo_controller'}),
        ('trajectory', {'feedrate_scheduler', 'joint_trajectory_bridge'}),
        ('compensation_applied', {'linuxcnc_bridge', 'opcua_bridge'}),
        ('thermal_error', {'thermal_predictor'}),
    ],
)
def test_what_moves_a_machine_has_one_writer(written, topic, writers):
    folder, _ = written()
    found = {
        node
        for node in NODES
        if rights(folder / 'mill' / f'{node}.policy.xml', 'publish')
        & {f'/mill/{topic}', '/mill/*', '*'}
    }
    assert found == writers


def test_only_operator_and_page_ask_for_anything(written):
    folder, _ = written()
    asking = {node for node in NODES if rights(folder / 'mill' / f'{node}.policy.xml', 'request')}
    assert asking == {'operator', 'dashboard'}
    for name in asking:
        asked = rights(folder / 'mill' / f'{name}.policy.xml', 'request')
        assert {'/mill/set_thermal_reference', '/mill/compensator/change_state'} <= asked


def test_nodes_and_topics_from_outside_are_chosen(written):
    nodes = 'temperature_acquisition,player'
    topic = 'temperature_acquisition=/plc/spindle'
    folder, _ = written('--nodes', nodes, '--subscribe', topic)
    files = {file.name.partition('.')[0]: file for file in folder.rglob('*.xml')}
    assert set(files) == set(nodes.split(','))
    assert '/plc/spindle' in rights(files['temperature_acquisition'], 'subscribe')
    assert '/plc/spindle' not in rights(files['player'], 'subscribe')
    assert '/mill/*' in rights(files['player'], 'publish')


@pytest.mark.parametrize(
    ('words', 'text'),
    [
        (
            ['--machine', '/mill'],
            'expected a namespace without leading slash, such as mill, but f',
        ),
        (['--machine', ''], '--machine: expected a namespace'),
        (['--nodes', 'compensater'], 'expected a node among simulated_machine, linuxcnc_bridge'),
        (['--subscribe', 'compensator'], '--subscribe: expected NODE=/TOPIC'),
        (['--subscribe', 'compensator=plc'], '--subscribe: expected NODE=/TOPIC'),
        (['--subscribe', 'compensator=/plc/*'], '--subscribe: expected NODE=/TOPIC'),
        (['--subscribe', 'player=/plc/spindle'], 'with a node among linuxcnc_bridge'),
    ],
)
def test_wrong_words_are_refused_and_nothing_is_written(refused, tmp_path, words, text):
    refused('security', 'write', tmp_path / 'policies', *words, naming=[text])
    assert not (tmp_path / 'policies').exists()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Each parameter file of a folder reaches its node, or is named."""

import pytest

from fuzzycnc_ros.graph.bring_up import known_nodes, node_specs, page_spec, with_files
from fuzzycnc_ros.ros.parameter_files import ParameterSection, parameter_files, sections, unread
from fuzzycnc_ros.ros.presence import GraphError

RUNNING = ('/mill/compensator', '/mill/thermal_predictor', '/dashboard')


def said(folder, running=RUNNING, **files):
    """Return what is said of files with sections of these names."""
    for name, pattern in files.items():
        text = f'# {name}\n{pattern}:\n  ros__parameters:\n    period: 1.0\n'
        (folder / f'{name}.yaml').write_text(text)
    return unread(folder, sections(parameter_files(folder)), running, known_nodes())


@pytest.mark.parametrize(
    ('pattern', 'reached'),
    [
        ('/**', True),
        ('/**/compensator', True),
        ('/mill/compensator', True),
        ('mill/compensator', True),
        ('/*/compensator', True),
        ('/mill/*', True),
        ('/compensator', False),
        ('compensator', False),
        ('/mill/compensato', False),
        ('/mill_2/compensator', False),
        ('/*', False),
    ],
)
def test_a_section_is_for_the_nodes_that_ros_gives_it(tmp_path, pattern, reached):
    (tmp_path / 'x.yaml').write_text(f'{pattern}:\n  ros__parameters:\n    a: 1\n')
    (section,) = sections([tmp_path / 'x.yaml'])
    assert section.reaches('/mill/compensator') == reached


def test_names_of_nodes_may_stand_one_below_the_other(tmp_path):
    text = 'mill:\n  compensator:\n    ros__parameters: {a: 1}\n  x:\n    ros__parameters:\n'
    (tmp_path / 'x.yaml').write_text(text)
    found = sections([tmp_path / 'x.yaml'])
    assert [(part.pattern, part.line, part.values) for part in found] == [
        ('/mill/compensator', 2, {'a': 1}),
        ('/mill/x', 4, {}),
    ]


def test_what_reaches_its_node_is_not_mentioned(tmp_path):
    names = {'compensator': '/**/compensator', 'dashboard': '/dashboard', 'all': '/**'}
    assert said(tmp_path, **names) == []


def test_nodes_that_are_not_started_are_named_together(tmp_path):
    names = {'servo_controller': '/**/servo_controller', 'player': '/**/player'}
    assert said(tmp_path, **names) == [
        f'{tmp_path}: not read, as their nodes are not started: player, servo_controller'
    ]


def test_a_page_that_nobody_asked_for_is_named(tmp_path):
    (text,) = said(tmp_path, RUNNING[:2], dashboard='/**/dashboard')
    assert text.endswith('not started: dashboard')


@pytest.mark.parametrize(
    ('name', 'pattern', 'told'),
    [
        ('compensater', '/**/compensater', 'called /**/compensater; did you mean compensator?'),
        ('dash_board', '/**/dash_board', 'called /**/dash_board; did you mean dashboard?'),
        ('some', '/mill_2/compensator', 'called /mill_2/compensator'),
        ('own', '/**/warp_drive', 'called /**/warp_drive'),
    ],
)
def test_names_that_no_node_has_are_told(tmp_path, name, pattern, told):
    (text,) = said(tmp_path, **{name: pattern})
    assert text == f'{tmp_path}/{name}.yaml: line 2: not read: no node of this graph is {told}'


@pytest.mark.parametrize('pattern', ['/mill/dashboard', '/**/compensator', '/**/dash_board'])
def test_the_file_of_a_node_that_is_started_reaches_it(tmp_path, pattern):
    """What stands there may be the token."""
    with pytest.raises(GraphError, match=r'dashboard\.yaml: line 2: expected `/\*\*/dashboard:`'):
        said(tmp_path, ('/dashboard',), dashboard=pattern)


def test_both_spellings_of_yaml_are_read_and_others_named(tmp_path):
    (tmp_path / 'compensator.yml').write_text('/**/compensator:\n  ros__parameters:\n    a: 1\n')
    for name in ('dashboard.json', 'compensator.yaml.bak', 'token', 'README.md'):
        (tmp_path / name).touch()
    assert parameter_files(tmp_path) == [tmp_path / 'compensator.yml']
    assert said(tmp_path) == [
        f'{tmp_path}/{name}: not read: only names that end with .yaml or .yml are'
        for name in ('compensator.yaml.bak', 'dashboard.json')
    ]


def test_a_folder_of_bags_that_a_file_names_is_kept(tmp_path):
    def bags(record, *names):
        read = [ParameterSection(tmp_path, 1, '/**/dashboard', dict.fromkeys(names))]
        return page_spec(1, record, read).parameters.get('bags')

    assert bags(None) is None
    assert bags(tmp_path / 'bag', 'port') == str(tmp_path)
    assert bags(tmp_path / 'bag', 'bags') is None


def settled(folder, text, yielding=(), **asked):
    """Return the acquisition and the compensator as files leave them, and what is said."""
    (folder / 'some.yaml').write_text(text)
    read = sections([folder / 'some.yaml'])
    specs = node_specs(nodes=('temperature_acquisition', 'compensator'), **asked)
    found = [with_files(spec, 'mill', read, yielding) for spec in specs]
    return [spec.parameters for spec, _ in found], [line for _, told in found for line in told]


STATE = '/**:\n  ros__parameters: {state_directory: /var/lib/mill}\n'


def test_where_state_is_kept_is_left_to_files_unless_it_is_asked_for(tmp_path):
    of_run = tmp_path / 'state'
    found, said = settled(tmp_path, STATE, ('state_directory',), state_directory=of_run)
    assert not any('state_directory' in parameters for parameters in found)
    assert said == []
    found, said = settled(tmp_path, STATE, state_directory=of_run)
    assert str(of_run) in [parameters.get('state_directory') for parameters in found]
    told = f'line 1: state_directory: not read, as the command decides it: {of_run}'
    assert said == [f'{tmp_path}/some.yaml: {told}']


def test_a_switch_that_the_command_decides_is_named(tmp_path):
    text = '/mill/compensator:\n  ros__parameters: {autostart: true, lockstep: false}\n'
    assert settled(tmp_path, text, autostart=True)[1] == []
    (told,) = settled(tmp_path, text)[1]
    assert 'line 1: autostart: not read, as the command decides it: False' in told


def test_shipped_files_overrule_nothing(tmp_path):
    """They hold all defaults."""
    text = '/**:\n  ros__parameters: {state_directory: "", autostart: false}\n'
    found, said = settled(tmp_path, text, ('state_directory',), state_directory=tmp_path)
    assert any('state_directory' in parameters for parameters in found)
    assert said == []


def test_folders_below_and_a_file_in_place_of_a_folder_are_named(tmp_path):
    (tmp_path / 'mill_1').mkdir()
    (tmp_path / 'mill_1' / 'compensator.yaml').touch()
    told = said(tmp_path, compensator='/**/compensator')
    assert told == [f'{tmp_path}/mill_1: not read: only files in the folder itself are']
    with pytest.raises(GraphError, match='expected a folder but found a file'):
        parameter_files(tmp_path / 'compensator.yaml')

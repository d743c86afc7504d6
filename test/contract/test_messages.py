# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What every interface definition says of itself: units, invalid values, enums, users."""

import re
import xml.etree.ElementTree as ET
from operator import attrgetter
from pathlib import Path

import interfaces
from each_case import for_each
from interfaces import FILES, FOLDER, Field

from fuzzycnc_ros.registry import COMPONENTS

UNITS = {'-', 'm', 'm2', 'm3', '1/m', 'm/s', 'm2/s', 'rad', 'rad/s', 's', 'degC', 'K', 'Pa'}
NODES = {*COMPONENTS, 'recorder', 'player', 'mqtt_publisher', 'mtconnect_adapter', 'opcua_server'}
PLANNED = {'deformation_compensator', 'feedrate_scheduler', 'servo_controller', 'linuxcnc_bridge'}
"""Nodes whose messages are fixed before they are there."""

MESSAGES = list(FILES['msg'].values())
CALLS = [path for kind in ('srv', 'action') for path in FILES[kind].values()]
EVERY_FIELD = [
    (path, item)
    for kind in FILES
    for path in FILES[kind].values()
    for part in interfaces.parts(path)
    for item in part
]
NUMBERS = [(path, item) for path, item in EVERY_FIELD if item.is_number]
FLOATS = [(path, item) for path, item in EVERY_FIELD if item.is_float]
ENUMS = [
    (path, item) for path, item in EVERY_FIELD if (item.tag or '').startswith(('enum ', 'flags '))
]


def file_name(path: Path) -> str:
    """Return what names a definition."""
    return path.name


def field_name(case: tuple[Path, Field]) -> str:
    """Return what names a field."""
    path, item = case
    return f'{path.name}: {item.name}'


def users(path: Path, role: str) -> str:
    """Return what stands after `Published by:` and the like."""
    found = re.search(rf'{role}: (.+?)(?:\s{{2,}}\w+ by:|$)', interfaces.head(path), re.M)
    assert found, f'{path.name}: no line "{role}: ..."'
    return found.group(1)


def test_the_definitions_were_found():
    assert {'Temperatures', 'Compensation', 'ThermalError'} <= set(FILES['msg'])
    assert FILES['srv']
    assert FILES['action']


@for_each([*MESSAGES, *CALLS], file_name)
def test_line_one_says_what_it_is(path):
    first = path.read_text().splitlines()[0]
    assert re.fullmatch(r'# [A-Z].{10,}\.', first)


@for_each([*MESSAGES, *CALLS], file_name)
def test_every_field_is_explained(path):
    silent = [i.name for part in interfaces.parts(path) for i in part if len(i.comment) < 6]
    assert not silent


@for_each(NUMBERS, field_name)
def test_number_has_its_unit(path, item: Field):
    assert item.tag, f'expected "# [unit] ..." but found {item.comment!r}'
    if not item.tag.startswith(('enum ', 'flags ')):
        assert item.tag in UNITS


@for_each(FLOATS, field_name)
def test_float_says_what_an_invalid_value_is(path, item: Field):
    """Either NaN stands for one, or there is none."""
    assert re.search(r'\bNaN\b|always finite|in \[-?\d', item.comment)


@for_each(ENUMS, field_name)
def test_enum_has_constants(path, item: Field):
    kind, prefix = item.tag.split()
    named = [i for part in interfaces.parts(path) for i in part if i.value is not None]
    own = [i for i in named if i.name.startswith(f'{prefix}_')]
    assert own
    assert all(i.tag == item.tag for i in own)
    bits = kind == 'flags'
    assert [int(i.value) for i in own] == [1 << n if bits else n for n in range(len(own))]


@for_each(MESSAGES, file_name)
def test_every_constant_belongs_to_an_enum(path):
    part = interfaces.parts(path)[0]
    named = ('enum ', 'flags ')
    used = {i.tag for i in part if i.value is None and (i.tag or '').startswith(named)}
    declared = {i.tag for i in part if i.value is not None}
    # The geometry of a path is described under its kinds.
    assert declared == used


@for_each([*MESSAGES, *CALLS], file_name)
def test_constants_stand_directly_above_their_field(path):
    """Viewers such as Foxglove and Lichtblick name a field's values by the constants above it."""
    for part in interfaces.parts(path):
        above: list[Field] = []
        for item in part:
            if item.value is not None:
                above.append(item)
                continue
            named = (item.tag or '').startswith(('enum ', 'flags '))
            assert {i.tag for i in above} == ({item.tag} if named else set()), item.name
            above = []
        assert not above


@for_each(MESSAGES, file_name)
def test_message_begins_with_a_header_that_says_stamp_and_frame(path):
    first = interfaces.parts(path)[0]
    fields = [item for item in first if item.value is None]
    if path.stem == 'SensorCluster':
        assert 'inside SensorSelection' in interfaces.head(path)
        return
    assert (fields[0].type, fields[0].name) == ('std_msgs/Header', 'header')
    assert fields[0].comment.startswith('stamp: ')
    assert re.search(r'frame_id: (<machine>/(machine|workpiece|tool)|empty)', fields[0].comment)


@for_each([*MESSAGES, *CALLS], file_name)
def test_parallel_arrays_name_an_array(path):
    for part in interfaces.parts(path):
        arrays = {item.name for item in part if item.is_array}
        for item in part:
            for name in re.findall(r'parallel to `(\w+)`', item.comment):
                assert item.is_array
                assert name in arrays - {item.name}


@for_each(MESSAGES, file_name)
def test_axis_arrays_carry_iso_841_names(path):
    for item in interfaces.parts(path)[0]:
        if item.name == 'axis':
            assert item.type == 'string[]'
            assert 'ISO 841' in item.comment


@for_each(MESSAGES, file_name)
def test_error_and_offset_state_their_sign(path):
    if path.stem in ('ThermalError', 'Compensation', 'Displacement'):
        assert 'Sign: ' in interfaces.head(path)


@for_each(MESSAGES, file_name)
def test_message_names_its_users(path):
    for role in ('Published by', 'Read by'):
        text = re.sub(r'\(.*?\)|topic \w+', '', users(path, role))
        unknown = set(re.findall(r'\b[a-z]+(?:_[a-z]+)+\b', text)) - NODES - PLANNED
        assert not unknown


@for_each(CALLS, file_name)
def test_call_names_its_users(path):
    assert users(path, 'Served by') in NODES
    assert users(path, 'Called by')


@for_each(CALLS, file_name)
def test_call_answers_whether_and_why(path):
    answer = interfaces.parts(path)[1]
    assert [(item.type, item.name) for item in answer[:2]] == [
        ('bool', 'success'),
        ('string', 'message'),
    ]


@for_each(COMPONENTS.values(), attrgetter('NAME'))
def test_definition_names_the_nodes_that_declare_it(component):
    for declared, role in ((component.OUTPUTS, 'Published by'), (component.INPUTS, 'Read by')):
        for item in declared:
            if not item.record.TYPE.startswith('fuzzycnc_msgs/'):
                continue  # ROS's own
            path = FILES['msg'][item.record.TYPE.split('/')[-1]]
            told = interfaces.head(path).split(f'{role}:')[1]
            bridge = component.NAME.endswith('_bridge')
            assert component.NAME in told or (bridge and 'bridge of a real controller' in told)


def test_build_takes_every_definition():
    text = (FOLDER / 'CMakeLists.txt').read_text()
    patterns = re.findall(r'"([\w*./]+\.(?:msg|srv|action))"', text)
    built = {path for pattern in patterns for path in FOLDER.glob(pattern)}
    assert built == {path for kind in FILES for path in FILES[kind].values()}
    assert built == {
        path for path in FOLDER.rglob('*') if path.suffix in ('.msg', '.srv', '.action')
    }


def test_packages_of_field_types_are_declared():
    used = {
        item.type.split('/')[0]
        for kind in FILES
        for path in FILES[kind].values()
        for part in interfaces.parts(path)
        for item in part
        if '/' in item.type
    }
    manifest = ET.parse(FOLDER / 'package.xml').getroot()
    declared = {item.text for item in manifest if item.tag.endswith('depend')}
    assert used <= declared
    cmake = (FOLDER / 'CMakeLists.txt').read_text()
    depends = re.search(r'DEPENDENCIES ([\w\s]+)\)', cmake).group(1).split()
    assert used <= set(depends)

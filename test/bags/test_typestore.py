# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Types without ROS: definitions, hashes, and hostile definitions."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.bags import definitions, libraries, typestore
from fuzzycnc_ros.bags.canonical import canonical_message
from fuzzycnc_ros.bags.errors import BagDataError, BagTypeError, MissingLibraryError

TEMPERATURES = 'fuzzycnc_msgs/msg/Temperatures'


@pytest.mark.parametrize(
    ('text', 'complaint'),
    [
        ('uint8 x\n' * 40000, 'at most'),
        ('Foo[100000] many\n================', 'cannot be parsed'),
        ('string[100000000] many\n', 'at most 2048 members'),
        ('a/msg/B inner\n', 'contain itself'),
        ('uint8 x; import os\n', 'cannot be parsed'),
        ('\x00', 'cannot be parsed'),
    ],
)
def test_hostile_definition_is_refused(text, complaint):
    with pytest.raises(BagTypeError, match=complaint):
        definitions.parse(text, 'a/msg/B')


@pytest.mark.parametrize('name', ['', 'B', 'a/B', '../msg/B', 'a/msg/B\nuint8 x', '1/msg/B'])
def test_hostile_type_name_is_refused(name):
    with pytest.raises(BagTypeError, match=r'type name'):
        definitions.parse('uint8 x\n', name)
    assert definitions.find_text(name) is None


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_parsed_or_refused(text):
    try:
        types = definitions.parse(text, 'a/msg/B')
    except BagTypeError:
        return
    assert 'a/msg/B' in types


def test_unknown_type_is_refused_with_remedy():
    with pytest.raises(BagTypeError, match=r'source the workspace'):
        typestore.message_type('nowhere_msgs/msg/Nothing')


def test_bytes_that_do_not_fit_are_refused():
    with pytest.raises(BagDataError, match=r'damaged or was recorded with another definition'):
        typestore.deserialize(b'\x00\x01\x00\x00\x01', TEMPERATURES)


def test_message_that_does_not_fit_is_refused(new):
    message = new.temperatures(0)
    message.sensor = 5
    with pytest.raises(BagDataError, match=r'fits'):
        typestore.serialize(message)


def test_missing_library_names_remedy():
    with pytest.raises(MissingLibraryError, match=r'pip install .*\[bags\]'):
        libraries.load('no_such_library.writer')


def test_missing_definitions_name_remedy(monkeypatch, tmp_path):
    monkeypatch.setattr(definitions, 'folders', lambda package: [tmp_path])
    with pytest.raises(BagTypeError, match=r'source the workspace .* or install'):
        typestore.typestore.__wrapped__()


def test_definitions_are_found_in_a_sourced_prefix(monkeypatch, tmp_path, root):
    folder = tmp_path / 'share' / 'shop_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Load.msg').write_text('std_msgs/Header header\nPart[] part\n')
    (folder / 'Part.msg').write_text('string name\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    part = typestore.message_type('shop_msgs/msg/Part')
    assert part(name='x').name == 'x'
    text = typestore.message_definition('shop_msgs/msg/Load')
    assert 'MSG: shop_msgs/Part' in text
    assert typestore.type_hash('shop_msgs/msg/Load').startswith('RIHS01_')


def test_installed_definitions_serve_without_checkout(monkeypatch, tmp_path, root):
    installed = tmp_path / 'share' / 'fuzzycnc_msgs' / 'msg'
    shutil.copytree(root / 'msg_defs' / 'msg', installed)
    monkeypatch.setattr(definitions, '__file__', str(tmp_path / 'a' / 'b' / 'c.py'))
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    assert definitions.find_folder('fuzzycnc_msgs') == installed


def test_definition_embeds_what_it_contains_once():
    text = typestore.message_definition('fuzzycnc_msgs/msg/SensorSelection')
    parts = text.split(definitions.SEPARATOR + '\n')
    assert [part.split('\n')[0] for part in parts[1:]] == [
        'MSG: std_msgs/Header',
        'MSG: fuzzycnc_msgs/SensorCluster',
        'MSG: builtin_interfaces/Time',
    ]
    again = definitions.parse(text, 'fuzzycnc_msgs/msg/SensorSelection')
    store = typestore.typestore()
    for name, (_, fields) in again.items():
        assert fields == store.fielddefs[name][1]


def test_hash_is_the_one_of_ros():
    # As the sample bags of rosbag2 and REP 2011 state it.
    assert typestore.type_hash('std_msgs/msg/String') == (
        'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18'
    )


def test_hashes_equal_those_of_the_built_package():
    """The build of the interface package states the hash that a live graph announces."""
    folder = Path(sys.prefix) / 'share' / 'fuzzycnc_msgs' / 'msg'
    stated = {}
    for path in folder.glob('*.json'):
        entries = json.loads(path.read_text())['type_hashes']
        stated.update({entry['type_name']: entry['hash_string'] for entry in entries})
    names = [name for name in stated if name.startswith('fuzzycnc_msgs/msg/')]
    if not names:
        pytest.skip('expected the built fuzzycnc_msgs in this Python but found none: pip install')
    assert {name: typestore.type_hash(name) for name in names} == {n: stated[n] for n in names}


def test_canonical_form_forgets_padding(new):
    raw = typestore.serialize(new.temperatures(5, (1.0, np.nan, -0.0)))
    dirty = bytearray(raw)
    end = raw.index(b'machine\x00') + len('machine\x00')
    pad = -(end - 4) % 4
    assert pad > 0, 'the sample must contain padding'
    dirty[end : end + pad] = b'\xaa' * pad
    assert bytes(dirty) != raw
    assert canonical_message(bytes(dirty), TEMPERATURES) == raw
    assert canonical_message(raw, TEMPERATURES) == raw


def test_no_ros_is_imported():
    code = (
        'import sys\n'
        "sys.modules['rclpy'] = sys.modules['fuzzycnc_msgs'] = None\n"
        'from fuzzycnc_ros.bags import reader, recorder, repair, writer, canonical, runs\n'
        'from fuzzycnc_ros.bags import csv_import as _\n'
        "assert not {'rosbags', 'mcap', 'zstandard', 'yaml'} & set(sys.modules)\n"
        'from fuzzycnc_ros.bags.typestore import type_hash\n'
        f"print(type_hash('{TEMPERATURES}'))\n"
    )
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('RIHS01_')

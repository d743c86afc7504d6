# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A report in lines of SHDR: units, what is not known, alarms that come and go, the file."""

from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.components.report.shdr import NAMESPACE, TEXT_MAX, Shdr

TIME = '2026-01-02T03:04:05.000+00:00'
STAMP = '2026-01-02T03:04:05.000Z'


def document(**parts):
    """Return a report that has everything."""
    return {
        'time': TIME,
        'offsets': {'age_s': 0.1, 'offset_um': {'X': 0.0, 'Z': -12.5}, 'status': 'following'},
        'errors': {'age_s': 0.1, 'error_um': {'Z': 12.5}, 'valid': True},
        'temperatures': {
            'age_s': 0.1,
            'temperature_degC': {'front bearing': 31.25, 'T2': None, 'T3': 90.0},
            'status': {'front bearing': 'ok', 'T2': 'missing', 'T3': 'out_of_range'},
        },
        'spindle': {'age_s': 0.1, 'speed_rpm': 6000.0, 'status': 'ok'},
        'alarms': [],
        **parts,
    }


def alarm(text, level='warning', name='device rtd'):
    return {'level': level, 'node': 'temperature_acquisition', 'name': name, 'text': text}


def values(line):
    """Return the pairs of a line, by the grammar: a stamp, then keys and values in turn."""
    stamp, *fields = line.split('|')
    assert stamp == STAMP
    assert len(fields) % 2 == 0
    return dict(zip(fields[::2], fields[1::2], strict=True))


def test_machines_whose_names_look_alike_are_devices_of_their_own():
    """One agent may gather them: what is the same twice, it takes for one."""
    ids = []
    for machine in ('shop/mill', 'shop_mill'):
        shdr = Shdr(machine, 150.0)
        shdr.take(document())
        root = ElementTree.fromstring(shdr.devices())
        ids += [
            value for item in root.iter() for key in ('id', 'uuid') if (value := item.get(key))
        ]
    assert len(ids) == len(set(ids)) > 10


def test_everything_is_told_in_the_units_of_mtconnect():
    shdr = Shdr('mill', 150.0)
    (line,) = shdr.take(document())
    assert values(line) == {
        'availability': 'AVAILABLE',
        'temperature_front_bearing': '31.25',
        'temperature_T2': 'UNAVAILABLE',
        'temperature_T3': 'UNAVAILABLE',
        'offset_X': '0',
        'offset_Z': '-0.0125',
        'error_Z': '0.0125',
        'spindle_speed': '6000',
    }
    everything = shdr.everything()
    assert values(everything[0]) == values(line)
    assert everything[1:] == [f'{STAMP}|alarms|NORMAL||||']


def test_only_what_has_changed_is_told_again():
    shdr = Shdr('mill', 150.0)
    assert shdr.everything() == []
    shdr.take(document())
    assert shdr.take(document()) == []
    slower = {'age_s': 0.1, 'speed_rpm': 5000.0, 'status': 'ok'}
    (line,) = shdr.take(document(spindle=slower))
    assert values(line) == {'spindle_speed': '5000'}


def test_what_is_too_old_or_gone_or_not_valid_is_unavailable():
    shdr = Shdr('mill', 150.0)
    shdr.take(document())
    old = {'age_s': 151.0, 'offset_um': {'X': 0.0, 'Z': -12.5}, 'status': 'following'}
    invalid = {'age_s': 0.1, 'error_um': {'Z': 12.5}, 'valid': False}
    (line,) = shdr.take(document(offsets=old, errors=invalid, spindle=None, temperatures=None))
    assert values(line) == {
        'temperature_front_bearing': 'UNAVAILABLE',
        'offset_X': 'UNAVAILABLE',
        'offset_Z': 'UNAVAILABLE',
        'error_Z': 'UNAVAILABLE',
        'spindle_speed': 'UNAVAILABLE',
    }
    young = {**old, 'age_s': 149.0}
    (line,) = shdr.take(document(offsets=young, errors=invalid, spindle=None, temperatures=None))
    assert values(line) == {'offset_X': '0', 'offset_Z': '-0.0125'}


def test_alarms_are_conditions_that_come_change_and_go():
    shdr = Shdr('mill', 150.0)
    shdr.take(document())
    one, code = 'ambient: open circuit', 'temperature_acquisition.device_rtd'
    begin = f'{STAMP}|alarms'
    assert shdr.take(document(alarms=[alarm(one)])) == [f'{begin}|WARNING|{code}|||{one}']
    assert shdr.take(document(alarms=[alarm(one)])) == []
    assert shdr.everything()[1:] == [f'{begin}|NORMAL||||', f'{begin}|WARNING|{code}|||{one}']
    worse = [alarm('a|b\nc', 'error'), alarm('x' * 999, name='sensors')]
    lines = shdr.take(document(alarms=worse))
    assert lines[0] == f'{begin}|FAULT|{code}|||a/b/c'
    assert lines[1].endswith(f'|{"x" * TEXT_MAX}')
    assert shdr.take(document()) == [
        f'{begin}|NORMAL|{code}|||',
        f'{begin}|NORMAL|temperature_acquisition.sensors|||',
    ]


@given(st.dictionaries(st.text(min_size=1), st.none() | st.floats(-1e3, 1e3), max_size=5))
def test_no_name_breaks_a_line_or_a_key(readings):
    part = {
        'age_s': 0.0,
        'temperature_degC': readings,
        'status': dict.fromkeys(readings, 'ok'),
    }
    alarms = [alarm(name, name=name) for name in readings]
    shdr = Shdr('mill', 150.0)
    lines = shdr.take(document(temperatures=part, alarms=alarms))
    assert all('\n' not in line and '\r' not in line for line in lines)
    assert sum(key.startswith('temperature_') for key in values(lines[0])) == len(readings)
    assert all(len(line.split('|')) == 7 for line in lines[1:])


def test_the_file_of_devices_has_every_key_once():
    shdr = Shdr('shop/mill', 150.0)
    (line,) = shdr.take(document())
    text = shdr.devices()
    found = ElementTree.fromstring(text.encode())
    items = found.findall(f'.//{{{NAMESPACE}}}DataItem')
    names = [item.get('name') for item in items]
    assert sorted(names) == sorted([*values(line), 'alarms'])
    assert len({item.get('id') for item in found.iter() if item.get('id')}) == 2 + len(items) + 3
    units = {item.get('name'): item.get('units') for item in items}
    assert units['temperature_T2'] == 'CELSIUS'
    assert units['offset_Z'] == 'MILLIMETER'
    assert units['spindle_speed'] == 'REVOLUTION/MINUTE'
    assert found.find(f'.//{{{NAMESPACE}}}Device').get('name') == 'shop-mill'
    # The same items give the same file, whatever came first or is known now.
    other = Shdr('shop/mill', 150.0)
    other.take(document(temperatures=None))
    other.take(document(offsets=None))
    assert other.devices() == text

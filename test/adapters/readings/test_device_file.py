# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file of devices: what it means, and what is said where it is wrong."""

import importlib
import math
import re
import struct
import sys

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip('rclpy')

from fuzzycnc_ros.adapters.modbus.devices import FORMATS, Register, SerialLine
from fuzzycnc_ros.adapters.modbus.registers import REGISTERS_MAX, blocks, value_of
from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials
from fuzzycnc_ros.adapters.readings.device_file import DRIVERS, DeviceFile, read_devices
from fuzzycnc_ros.adapters.readings.devices import SPINDLE
from fuzzycnc_ros.ros.parameters import ParameterError

pytestmark = pytest.mark.ros

MODBUS = """\
devices:
  - name: rtd
    protocol: modbus_tcp
    host: 10.0.0.5
    scale: 0.1
    open_circuit: [0x7FFF, 0x8000]
    sensors:
      T1: 0
      T2: {register: 1, table: input, scale: 0.01}
      T3: {register: 10, type: float32, word_order: little, scale: 1, open_circuit: -9999}
    spindle_speed: {register: 40, type: uint16, max: 6000}
"""
OPC_UA = """\
devices:
  - name: control
    protocol: opc_ua
    url: opc.tcp://10.0.0.7:4840/
    period: 0.5
    sensors:
      T1: ns=2;s=Spindle.T1
      T2: {path: "0:Objects/2:Spindle/2:T2"}
      T3: {node: "nsu=urn:mill;i=7", offset: -273.15}
"""


@pytest.fixture
def read(tmp_path):
    def of(text):
        path = tmp_path / 'devices.yaml'
        path.write_text(text)
        return read_devices(path)

    return of


def test_modbus_fields(read):
    (device,) = read(MODBUS)
    assert device.sensors == ('T1', 'T2', 'T3')
    assert (device.port, device.unit, device.period, device.timeout) == (502, 1, 1.0, 2.0)
    one, two, three, spindle = device.channels
    assert (one.table, one.register, one.type, one.scale) == ('holding', 0, 'int16', 0.1)
    assert (two.table, two.scale, two.open_circuit) == ('input', 0.01, (0x7FFF, 0x8000))
    assert (three.scale, three.open_circuit, three.word_order) == (1.0, (-9999,), 'little')
    # The spindle speed inherits nothing: what scales temperatures does not scale speeds.
    assert spindle.scale == pytest.approx(2.0 * math.pi / 60.0)
    assert spindle.open_circuit == ()
    assert spindle.largest == pytest.approx(200.0 * math.pi)
    assert one.largest == math.inf


RTU = """\
devices:
  - name: rtd
    protocol: modbus_rtu
    port: /dev/ttyUSB0
    baud_rate: 9600
    sensors: {T1: 0}
  - name: spindle
    protocol: modbus_rtu
    port: /dev/ttyUSB0
    baud_rate: 9600
    unit: 2
    sensors: {T2: 0}
"""


def test_modbus_rtu_fields(read):
    one, two = read(RTU)
    assert one.line == two.line == SerialLine('/dev/ttyUSB0', 9600, 'even', 1)
    assert (one.unit, one.timeout, one.sensors) == (1, 1.0, ('T1',))
    assert two.address == 'Modbus RTU /dev/ttyUSB0 unit 2'
    one, two = read(RTU.replace('    baud_rate: 9600\n', ''))
    # What the standard asks of a unit that was not told: 19200 bit/s, even parity.
    assert one.line == two.line == SerialLine('/dev/ttyUSB0', 19200, 'even', 1)


@pytest.mark.parametrize(
    ('old', 'new', 'line', 'text'),
    [
        ('/dev/ttyUSB0', 'ttyUSB0', 4, 'expected the file of a serial port, such as /dev/ttyUSB0'),
        ('/dev/ttyUSB0', 'socket://10.0.0.5:502', 4, 'expected the file of a serial port'),
        ('9600', '9600.5', 5, 'baud_rate: expected a whole number from 300 to 4e+06'),
        ('unit: 2', 'unit: 248', 11, 'unit: expected a whole number from 1 to 247'),
        ('unit: 2', 'parity: mark', 11, 'parity: expected one of even, odd, none'),
        ('unit: 2', 'stop_bits: 3', 11, 'stop_bits: expected a whole number from 1 to 2'),
        ('unit: 2', 'host: 10.0.0.5', 11, "unknown field 'host'"),
        ('unit: 2', 'parity: none', 9, 'same baud_rate, parity and stop_bits as device rtd, wh'),
    ],
)
def test_wrong_modbus_rtu_files_are_refused(read, old, new, line, text):
    with pytest.raises(ParameterError, match=re.escape(text)) as caught:
        read(RTU.replace(old, new, 1))
    assert f'devices.yaml: line {line}: ' in str(caught.value)


def test_opc_ua_fields(read):
    (device,) = read(OPC_UA)
    assert [channel.place for channel in device.channels] == [
        'node ns=2;s=Spindle.T1',
        'path 0:Objects/2:Spindle/2:T2',
        'node nsu=urn:mill;i=7',
    ]
    assert device.channels[2].offset == -273.15
    assert device.security is None


@pytest.mark.parametrize(
    ('old', 'new', 'line', 'text'),
    [
        ('T1: 0', 'T1: 40001.5', 8, 'register: expected a whole number'),
        ('T1: 0', 'T1: 70000', 8, 'what manuals call 40001 is register 0 of the table holding'),
        ('T1: 0', 'T1: 010', 8, '010 would be octal in YAML'),
        ('T1: 0', 'T1: first', 8, "register: expected a number but found 'first'"),
        ('T1: 0', 'T1: {table: input}', 8, "expected the field 'register'"),
        ('T1: 0', 'T1: [0]', 8, 'expected fields with values'),
        ('T1: 0', 'T2: 0', 9, "'T2' is repeated here after line 8"),
        (
            'table: input',
            'table: coil',
            9,
            "table: expected one of holding, input but found 'coil'",
        ),
        ('table: input', 'tabel: input', 9, "unknown field 'tabel'; did you mean table?"),
        ('scale: 0.01', 'scale: .nan', 9, 'scale: expected a number from -1e+09 to 1e+09'),
        ('scale: 0.01', 'scale: 0', 9, 'scale: expected another number than 0'),
        ('type: float32', 'type: float', 10, 'type: expected one of int16, uint16'),
        ('10, type: float32', '65535, type: float32', 10, 'does not fit behind 65535'),
        ('0x8000]', '0x18000]', 6, 'expected raw values of a int16'),
        ('0x8000]', '3276.7]', 6, 'expected raw values of a int16'),
        ('max: 6000', 'max: -1', 11, 'max: expected a number from 0 to 1e+06'),
        ('scale: 0.01', 'max: 90', 9, "unknown field 'max'"),
        ('host: 10.0.0.5', 'host: "10.0.0.5/"', 4, 'host: expected a name or address'),
        ('host: 10.0.0.5', 'port: 502', 2, "device rtd: expected the field 'host'"),
        ('modbus_tcp', 'modbus', 3, 'expected one of modbus_tcp, modbus_rtu, opc_ua'),
        ('scale: 0.1', 'period: 0', 5, 'period: expected a number from 0.005 to 3600 s'),
        ('6000}', '6000, unit: Hz}', 11, 'unit: expected one of rpm, rad/s'),
        ('devices:\n', 'device:\n', 1, "expected the field 'devices'"),
        ('devices:\n', 'x: 1\ndevices:\n', 1, "unknown field 'x'"),
    ],
)
def test_wrong_modbus_files_are_refused(read, old, new, line, text):
    assert old in MODBUS
    with pytest.raises(ParameterError, match=re.escape(text)) as caught:
        read(MODBUS.replace(old, new, 1))
    assert f'devices.yaml: line {line}: ' in str(caught.value)


@pytest.mark.parametrize(
    ('old', 'new', 'line', 'text'),
    [
        ('opc.tcp://10.0.0.7:4840/', 'http://10.0.0.7:4840/', 4, 'url: expected opc.tcp://'),
        ('10.0.0.7:4840', '10.0.0.7', 4, 'usual port 4840'),
        ('10.0.0.7:4840', '10.0.0.7:99999', 4, 'usual port 4840'),
        ('10.0.0.7', 'joe:secret@10.0.0.7', 4, 'put them into the file credentials'),
        ('ns=2;s=Spindle.T1', 'Spindle.T1', 7, 'expected a node id such as ns=2;s=Spindle.T1'),
        ('0:Objects/2:Spindle/2:T2', 'Objects/Spindle', 8, 'expected steps from the root'),
        ('{path:', '{node: i=5, path:', 8, 'expected either node'),
        ('period: 0.5', 'security: {policy: Basic256}', 5, 'policy: expected one of Basic256Sha'),
        (
            'period: 0.5',
            'security: {policy: Basic256Sha256, certificate: a.der, private_key: b}',
            5,
            'certificate: expected a file but nothing is at',
        ),
        ('period: 0.5', 'credentials: user.yaml', 5, 'credentials: expected a file but nothing'),
        ('period: 0.5', 'credentials: devices.yaml', 5, 'or say allow_plain_password: true'),
    ],
)
def test_wrong_opc_ua_files_are_refused(read, old, new, line, text):
    assert old in OPC_UA
    with pytest.raises(ParameterError, match=re.escape(text)) as caught:
        read(OPC_UA.replace(old, new, 1))
    assert f'devices.yaml: line {line}: ' in str(caught.value)


@pytest.mark.parametrize(
    'text', ['', 'x', '[1, 2', 'devices: []', '- 1', '\x00', 'devices: {a: 1}']
)
def test_what_is_no_device_file_is_refused(read, text):
    with pytest.raises(ParameterError, match=r'devices\.yaml'):
        read(text)


def test_names_are_unique_over_all_devices(read):
    other = MODBUS.partition('\n')[2]
    with pytest.raises(ParameterError, match='sensor T1 is already read from device rtd'):
        read(MODBUS + other.replace('name: rtd', 'name: two'))
    renamed = re.sub(r'T(\d)', r'U\1', other)
    with pytest.raises(ParameterError, match='another device is called rtd too'):
        read(MODBUS + re.sub('    spindle_speed.*', '', renamed))
    with pytest.raises(ParameterError, match='the spindle_speed is already read from device rtd'):
        read(MODBUS + renamed.replace('name: rtd', 'name: two'))


def test_credentials(tmp_path):
    path = tmp_path / 'user.yaml'
    path.write_text('username: joe\npassword: 0123\n')
    path.chmod(0o644)
    with pytest.raises(ParameterError, match=f'run chmod 600 {path}'):
        read_credentials(path)
    path.chmod(0o600)
    assert read_credentials(path) == ('joe', '0123')
    path.write_text('username: joe\n')
    with pytest.raises(ParameterError, match='line 1: expected username and password'):
        read_credentials(path)


def examples_of(root):
    """Return the device files of the docs and of the examples."""
    how_to, examples = root / 'docs' / 'how-to', root / 'examples'
    pages = [how_to / 'your-sensors.md', how_to / 'temperature-drivers.md']
    shown = re.compile(r'^```yaml\n(devices:\n.*?)^```', re.M | re.S)
    found = [text for page in pages for text in shown.findall(page.read_text())]
    files = [*examples.glob('sensors/*.yaml'), examples / 'devices.yaml']
    return [*found, *(file.read_text() for file in files)]


def test_every_file_of_the_table_is_there_and_of_its_protocol(root, read, tmp_path):
    page = (root / 'docs' / 'how-to' / 'your-sensors.md').read_text()
    for name in ('broker.pem', 'broker-user.yaml'):
        (tmp_path / name).touch()
    rows = re.findall(r'^\| .* \| \[`(\w+)`\].* \| `(sensors/\w+\.yaml)` \|$', page, re.M)
    assert {file for _, file in rows} == {
        f'sensors/{path.name}' for path in (root / 'examples' / 'sensors').glob('*')
    }
    tables = page.partition('## What you have')[2].partition('\n## ')[0]
    named = set(re.findall(r'[`/]([\w./-]+\.(?:yaml|csv|ini|hal))`?', tables))
    places = [root / 'examples', root, root / 'linuxcnc']
    assert [name for name in named if not any((p / name).exists() for p in places)] == []
    assert {'probing/probe.yaml', 'opcua-control.yaml', 'fuzzycnc.hal'} <= named
    for protocol, file in rows:
        text = (root / 'examples' / file).read_text()
        assert len(text.splitlines()) <= 13  # three are its head
        assert f'protocol: {protocol}\n' in text
        assert read(text)


def test_what_drivers_share_names_none_of_them_but_in_one_line(root):
    folder = root / 'fuzzycnc_ros' / 'adapters'
    own = {folder / f'{p.partition(":")[0].replace(".", "/")}.py' for p in DRIVERS.values()}
    shared = {*folder.glob('*.py'), *folder.glob('readings/*.py')} - own
    for protocol, place in DRIVERS.items():
        lines = [line for path in shared for line in path.read_text().splitlines()]
        naming = [line.strip() for line in lines if f"'{protocol}'" in line]
        assert naming == [f"'{protocol}': '{place}',"]


def test_every_example_of_the_docs_is_a_device_file(root, read, tmp_path):
    examples = examples_of(root)
    assert len(examples) >= 12
    for name in ('own.der', 'own-key.pem', 'control.der', 'control-user.yaml'):
        (tmp_path / name).touch()
    for name in ('broker.pem', 'broker-user.yaml'):
        (tmp_path / name).touch()
    for example in examples:
        assert read(example)


def test_the_schema_takes_what_is_read_and_refuses_what_is_not(root):
    jsonschema = pytest.importorskip('jsonschema')
    validator = jsonschema.Draft202012Validator(DeviceFile.model_json_schema())
    for text in [*examples_of(root), MODBUS, OPC_UA]:
        validator.validate(yaml.safe_load(text))
    wrong = [
        ('T1: 0', 'T1: 70000'),
        ('T1: 0', 'T1: {table: input}'),
        ('table: input', 'tabel: input'),
        ('type: float32', 'type: float'),
        ('host: 10.0.0.5', 'port: 502'),
        ('modbus_tcp', 'modbus'),
        ('scale: 0.1', 'period: 0'),
        ('devices:', 'device:'),
    ]
    for old, new in wrong:
        assert not validator.is_valid(yaml.safe_load(MODBUS.replace(old, new, 1))), new


@pytest.mark.parametrize(
    ('old', 'new', 'text'),
    [
        ('name: rtd', 'name: [a]', 'line 2: device 1: name: expected a text but found a list'),
        ('name: rtd', 'nam: rtd', "line 2: device 1: expected the field 'name' but it is"),
        (
            'modbus_tcp',
            '[1]',
            'line 3: device rtd: protocol: expected one of modbus_tcp, modbus_',
        ),
        (
            'scale: 0.1',
            'scale: true',
            "line 5: device rtd: scale: expected a number but found 'tr",
        ),
        ('scale: 0.1', 'scale: 1\n    scale: 2', "line 6: device rtd: 'scale' is repeated here"),
        ('T1: 0', '"": 0', 'line 8: device rtd: sensors: expected a printable name but found'),
        (
            'T1: 0',
            'T1:',
            "line 8: device rtd, sensor T1: register: expected a number but found ''",
        ),
        ('T1: 0', '\tT1: 0', "found character '\\t' that cannot start any token"),
        ('scale: 0.1', 'periode: 2', "line 5: device rtd: unknown field 'periode'; did you mean"),
        ('max: 6000', 'unit: 1', 'line 11: device rtd, spindle_speed: unit: expected one of rpm'),
    ],
)
def test_what_is_wrong_is_named_with_its_place(read, old, new, text):
    with pytest.raises(ParameterError, match=re.escape(text)):
        read(MODBUS.replace(old, new, 1))


def test_without_pydantic_2_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, 'pydantic', None)
    monkeypatch.delitem(sys.modules, 'fuzzycnc_ros.adapters.yaml_model')
    with pytest.raises(ParameterError, match=r"pydantic 2 .*pip install 'fuzzycnc_ros\[modbus,op"):
        importlib.import_module('fuzzycnc_ros.adapters.yaml_model')


def registers(*places):
    return [Register(name=f'T{p}', table='input', register=p, type=t) for p, t in places]


def test_registers_that_touch_are_read_together():
    items = registers((3, 'int32'), (0, 'int16'), (1, 'float32'), (7, 'int16'))
    found = blocks(items)
    assert [(b.register, b.count, b.channels) for b in found] == [(0, 5, (1, 2, 0)), (7, 1, (3,))]


@given(st.lists(st.tuples(st.integers(0, 65532), st.sampled_from(sorted(FORMATS))), min_size=1))
def test_requests_cover_every_value_and_are_no_longer_than_allowed(places):
    items = registers(*places)
    found = blocks(items)
    assert sorted(i for block in found for i in block.channels) == list(range(len(items)))
    for block in found:
        assert block.count <= REGISTERS_MAX
        for index in block.channels:
            end = items[index].register + items[index].count
            assert block.register <= items[index].register
            assert end <= block.register + block.count


@given(
    st.sampled_from(sorted(FORMATS)),
    st.sampled_from(['big', 'little']),
    st.sampled_from(['big', 'little']),
    st.integers(-(2**63), 2**63 - 1),
)
def test_registers_and_values_fit_each_other(kind, word_order, byte_order, seed):
    item = Register(
        name=SPINDLE,  # of which any value is a reading
        table='input',
        register=0,
        type=kind,
        word_order=word_order,
        byte_order=byte_order,
    )
    size = 2 * item.count
    bits = (seed % 2 ** (8 * size)).to_bytes(size, 'big')
    (raw,) = struct.unpack(f'>{FORMATS[kind]}', bits)
    words = [bits[place : place + 2] for place in range(0, size, 2)]
    if word_order == 'little':
        words.reverse()
    found = value_of(item, [int.from_bytes(word, byte_order) for word in words])
    if np.isfinite(raw):
        assert found == float(raw)
    else:
        assert found.startswith('reads ')


def test_open_circuit_codes_may_be_signed_or_not():
    item = Register(
        name='T', table='input', register=0, type='int16', open_circuit=(0x8000,), scale=0.01
    )
    assert value_of(item, [0x8000]) == 'open circuit (raw value -32768)'
    assert value_of(item, [0xD8F1]) == pytest.approx(-99.99)
    item = Register(name='T', table='input', register=0, type='uint16', open_circuit=(-1,))
    assert value_of(item, [0xFFFF]) == 'open circuit (raw value 65535)'


def test_limits_of_a_sensor_are_those_of_its_entry(tmp_path):
    text = """\
devices:
  - name: rtd
    protocol: modbus_tcp
    host: 10.0.0.5
    sensors: {{front: 0, bed: {{register: 1, rate_max: {rate}, range_high: 150}}}}
"""
    path = tmp_path / 'devices.yaml'
    path.write_text(text.format(rate=0.7))
    (device,) = read_devices(path)
    assert [channel.limits for channel in device.channels] == [
        (),
        (('range_high', 150.0), ('rate_max', 0.7)),
    ]
    path.write_text(text.format(rate=-1))
    with pytest.raises(ParameterError, match='rate_max'):
        read_devices(path)


NTC = MODBUS.replace('scale: 0.1', 'ntc: {beta: 3950, divider: {fixed: 4700, supply: 4095}}')


def test_a_thermistor_is_of_all_sensors_or_of_one(read):
    (device,) = read(NTC.replace('T1: 0', 'T1: {register: 0, ntc: {beta: 3435}, offset: -0.4}'))
    one, two, _, spindle = device.channels
    assert one.ntc.temperature(10e3) == pytest.approx(25.0)
    assert value_of(one, [10_000]) == pytest.approx(24.6)
    assert two.ntc.supply == 4095.0
    assert spindle.ntc is None
    text = value_of(two, [0])
    assert 'raw value 0 is none of its thermistor: broken wire, short circuit' in text


@pytest.mark.parametrize(
    ('ntc', 'text'),
    [
        ('{resistance: 10000}', 'expected either beta, with resistance and at, or steinhart_hart'),
        ('{}', 'expected either beta'),
        ('{beta: 3950, steinhart_hart: [1, 2, 3]}', 'expected either beta'),
        ('{steinhart_hart: [1, 2]}', 'expected the three coefficients a, b, c but found 2'),
        ('{steinhart_hart: [1.1, 2.3, 0.8]}', 'it gives no temperature from -80 to 400 degC'),
        ('{beta: 39.5}', 'expected a number from 100 to 20000 K but found 39.5'),
        ('{beta: 3950, divider: {fixed: 4700}}', "expected the field 'supply' but it is missing"),
        (
            '{beta: 3950, divider: {fixed: 4700, supply: 5, ntc: top}}',
            'expected one of low, high but found',
        ),
    ],
)
def test_wrong_thermistors_are_refused(read, ntc, text):
    with pytest.raises(ParameterError, match=re.escape(text)):
        read(NTC.replace('{beta: 3950, divider: {fixed: 4700, supply: 4095}}', ntc))

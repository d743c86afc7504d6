# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile CSV recordings and parameter files: refused with the line, or read into numbers."""

import random
import shutil
from dataclasses import fields
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fuzzing.campaign import SEEDS, fuzz, refusal, refused_or_read
from fuzzing.file_mutations import damaged, mutated_json, mutated_text
from fuzzing.pattern_targets import offsets_text
from hypothesis import given

from fuzzycnc_ros.adapters.opcua.control_file import read_control
from fuzzycnc_ros.adapters.readings.device_file import read_devices
from fuzzycnc_ros.bags.csv_import import import_csv
from fuzzycnc_ros.bags.csv_mapping import CsvMapping
from fuzzycnc_ros.bags.errors import BagError, CsvError
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.cli.bags.import_csv import _read_mapping
from fuzzycnc_ros.cli.programs.scheduling_machine import read_machine
from fuzzycnc_ros.core.deformation.offset_file import read_offsets
from fuzzycnc_ros.core.document import ModelFileError
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.studies.servo.servo_settings import read_settings

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')

ROOT = Path(__file__).parents[2]
RECORDING = '\n'.join(
    ['t,a,b,rpm,ch']
    + [
        f'{k * 15},{20 + 0.2 * k:.3f},{21 + 0.1 * k:.3f},{600 * (k > 3)},{0.5 * k:.3f}'
        for k in range(24)
    ]
)
EXPORT = '\n'.join(
    ['sep=;', 'Zeit;"Vorn\n[°C]";Z [µm]']
    + [f'12.03.2026 08:{k:02d}:00,5;2{k % 9},{k};{k},5' for k in range(24)]
)
RECORDINGS = (
    (
        RECORDING,
        CsvMapping(time='t', temperatures=['a', 'b'], displacements=['ch=Z:um'], machine='mill'),
    ),
    (
        RECORDING,
        CsvMapping(
            time='t',
            temperatures=['a', 'b'],
            displacements=['ch=Z:um'],
            spindle_speed='rpm',
            machine='mill',
            resample=30.0,
            zero=True,
        ),
    ),
    (
        RECORDING.partition('\n')[2],
        CsvMapping(header=False, time='c1', temperatures=['c[23]'], displacements=['c5=Z:um']),
    ),
    (
        EXPORT,
        CsvMapping(
            time='Zeit', temperatures=['Vorn*'], displacements=['Z [µm]=Z:um'], decimal=','
        ),
    ),
    (EXPORT, CsvMapping(time='Zeit', temperatures=['Vorn*'], encoding='cp1252')),
)
MAPPING_FILE = """time: t
time_unit: s
temperatures: [a, b]
displacements: ["ch=Z:um"]
spindle_speed: rpm
rename: {a: left, b: right}
machine: mill
rows: [0, 20]
"""
DEVICES_FILE = """devices:
  - name: rtd
    protocol: modbus_tcp
    host: 192.168.10.50
    unit: 1
    table: input
    type: int16
    scale: 0.1
    open_circuit: [0x7FFF, 0x8000]
    sensors: {front: 0, rear: 1, ambient: {register: 7, scale: 0.01}}
  - name: control
    protocol: opc_ua
    url: opc.tcp://192.168.10.2:4840/
    period: 0.5
    sensors:
      motor: ns=2;s=Spindle.Temperature.Front
      column: {path: "0:Objects/2:Machine/2:Column/2:Temperature", offset: -273.15}
    spindle_speed: {node: ns=2;s=Spindle.ActualSpeed, unit: rpm}
  - name: card
    protocol: linuxcnc_hal
    sensors:
      table: {pin: in0, fault: open0, ntc: {steinhart_hart: [1e-3, 2e-4, 1e-7]}}
  - name: board
    protocol: lines
    port: /dev/ttyACM0
    columns: [a, "-", b]
    ntc: {beta: 3950, resistance: 10000, divider: {fixed: 4700, supply: 1023, ntc: high}}
    sensors: {nut: a, bed: {key: b, rate_max: 0.7}}
  - name: house
    protocol: mqtt
    host: 192.168.10.3
    max_age: 30
    sensors: {hall: {topic: tele/+/SENSOR, json: DS18B20.Temperature}}
  - name: bus
    protocol: one_wire
    sensors: {base: 28-0316a2791cff}
  - name: printer
    protocol: moonraker
    url: http://192.168.10.4:7125
    sensors: {chamber: temperature_sensor chamber}
"""
CONTROL_FILE = """url: opc.tcp://192.168.10.2:4840/
unit: um
position_unit: mm
hand_shake:
  sequence: ns=2;s=Comp.Sequence
  heartbeat: ns=2;s=Comp.Heartbeat
  valid_for: ns=2;s=Comp.ValidFor
  acknowledged: ns=2;s=Comp.Acknowledged
state:
  on: ns=2;s=Comp.On
  homed: ns=2;s=Comp.Homed
axes:
  X:
    offset: ns=2;s=Comp.X.K0
    slope: ns=2;s=Comp.X.Slope
    reference_position: ns=2;s=Comp.X.P0
    travel: [-100, 500]
    applied: ns=2;s=Comp.X.Applied
    position: ns=2;s=Comp.X.Position
  Z:
    offset: {node: ns=2;s=Comp.Z.Counts, scale: 0.01}
    applied: {path: "0:Objects/2:Machine/2:Z/2:Applied"}
"""
SETTINGS_FILE = """settings:
  gain: 1.5
rules:
  centres: [-1.0, 0.0, 1.0]
  values: [[-1.0, -0.5, 0.0], [-0.5, 0.0, 0.5], [0.0, 0.5, 1.0]]
"""


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp('fuzz')


@fuzz(80, share=0.2)
@given(seed=SEEDS)
def test_recordings(folder, seed):
    rng = random.Random(seed)
    file, out = folder / 'recording.csv', folder / 'bag'
    text, mapping = rng.choice(RECORDINGS)
    file.write_bytes(damaged(text, rng))
    shutil.rmtree(out, ignore_errors=True)
    reason = refusal(CsvError, lambda: import_csv(file, out, mapping))
    if reason:
        assert str(file) in reason
        assert not out.exists()
        return
    if refusal(BagError, lambda: read_run(out)):
        return
    run = read_run(out)
    assert np.isfinite(run.time).all()
    assert not np.isinf(run.temperature).any()
    assert not np.isinf(run.displacement).any()


@cache
def parameters() -> str:
    """Return the parameters of two nodes as they are shipped."""
    names = ('feedrate_scheduler', 'simulated_machine')
    return '\n'.join((ROOT / 'params' / f'{name}.yaml').read_text() for name in names)


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_parameter_files(folder, seed):
    file = folder / 'machine.yaml'
    file.write_bytes(damaged(parameters(), random.Random(seed)))
    refused_or_read(read_machine, file)


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_mapping_files(folder, seed):
    file = folder / 'mapping.yaml'
    file.write_bytes(damaged(MAPPING_FILE, random.Random(seed)))
    known = [item.name for item in fields(CsvMapping)]
    refused_or_read(lambda path: _read_mapping(path, known), file)


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_settings_files(folder, seed):
    file = folder / 'settings.yaml'
    file.write_bytes(damaged(SETTINGS_FILE, random.Random(seed)))
    refused_or_read(read_settings, file)


@pytest.mark.parametrize(
    ('read', 'text'),
    [(read_devices, DEVICES_FILE), (read_control, CONTROL_FILE)],
    ids=['devices', 'control'],
)
@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_device_files(folder, read, text, seed):
    file = folder / 'devices.yaml'
    file.write_bytes(damaged(text, random.Random(seed)))
    refused_or_read(read, file)


@pytest.mark.parametrize(
    ('read', 'text'), [(read_devices, DEVICES_FILE), (read_control, CONTROL_FILE)]
)
def test_the_device_files_themselves_are_read(folder, read, text):
    file = folder / 'good.yaml'
    file.write_text(text)
    assert read(file)


@pytest.mark.parametrize(
    'text',
    [
        '[' * 100_000,
        'devices: &a [*a]',
        'devices: [{name: !!int ""}]',
        'devices: [{name: x, protocol: modbus_tcp, host: h, sensors: {T: {register: !!int ""}}}]',
        'devices: [{name: x, protocol: modbus_tcp, host: h, sensors: {T: !!python/name:os ""}}]',
        'devices: [{name: x, protocol: modbus_tcp, host: h, period: !!timestamp x}]',
        f'devices: [{{name: x, protocol: modbus_tcp, host: h, period: {"9" * 400}}}]',
        'devices: [{name: x, protocol: modbus_tcp, host: h, sensors: {T: {register: 1, '
        f'open_circuit: 0x{"F" * 9000}}}}}}}]',
    ],
)
def test_device_files_whose_values_are_none(folder, text):
    file = folder / 'none.yaml'
    file.write_text(text)
    assert str(file) in refusal(ParameterError, lambda: read_devices(file))


@fuzz(25, share=0.2)
@given(seed=SEEDS)
def test_offset_files(seed):
    rng = random.Random(seed)
    text = offsets_text()
    text = mutated_json(text, rng) if rng.random() < 0.5 else mutated_text(text, rng)
    found = []
    if not refusal(ModelFileError, lambda: found.append(read_offsets(text))):
        assert np.isfinite(found[0].nominal).all()
        assert np.isfinite(found[0].offset).all()
        assert len(found[0].nominal) == len(found[0].offset)

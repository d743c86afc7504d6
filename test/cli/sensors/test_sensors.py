# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc sensors`: devices read without any node, and sensors compared."""

import json
import re

import numpy as np
import pytest

pytest.importorskip('rclpy')

from fuzzycnc_ros.cli.main import run

pytestmark = pytest.mark.ros
FRONT, REAR, AMBIENT = '28-0316a2791cff', '28-0417c11e55ff', '28-0000000000aa'
FILE = """
devices:
  - name: w1
    protocol: one_wire
    folder: {folder}
    period: 0.05
    sensors:
      front: {{id: 28-0316a2791cff, offset: 0.2}}
      rear: 28-0417c11e55ff
      ambient: 28-0000000000aa
"""


@pytest.fixture
def devices(tmp_path):
    for name, value in ((FRONT, 21000), (REAR, 20000), (AMBIENT, 20062)):
        folder = tmp_path / 'w1' / name
        folder.mkdir(parents=True)
        (folder / 'temperature').write_text(f'{value}\n')
    path = tmp_path / 'devices.yaml'
    path.write_text(FILE.format(folder=tmp_path / 'w1'))
    return path


def test_devices_are_read_once(devices, tmp_path, capsys):
    out = tmp_path / 'read.json'
    assert run(['sensors', 'read', str(devices), '--json', str(out)]) == 0
    assert json.loads(out.read_text()) == {'front': 21.2, 'rear': 20.0, 'ambient': 20.062}
    (tmp_path / 'w1' / REAR / 'temperature').unlink()
    capsys.readouterr()
    assert run(['sensors', 'read', str(devices)]) == 1
    shown = capsys.readouterr().out
    assert '20.06' in shown
    assert 'the bus has no such sensor' in ' '.join(shown.split())


def test_a_device_that_is_not_there_is_told(devices, tmp_path, capsys):
    path = tmp_path / 'gone.yaml'
    path.write_text(FILE.format(folder=tmp_path / 'none').replace('0.05', '0.05, timeout: 0.05'))
    path.write_text(path.read_text().replace('0.05, timeout: 0.05', '0.05\n    timeout: 0.05'))
    assert run(['sensors', 'read', str(path)]) == 1
    assert 'load the driver of the bus' in ' '.join(capsys.readouterr().out.split())
    path.write_text('devices: []')
    assert run(['sensors', 'read', str(path)]) == 2
    assert 'expected a list' in capsys.readouterr().err


def table(path, **columns):
    """Write a table of an hour at rest with some noise."""
    random = np.random.default_rng(2)
    rows = [f'time,{",".join(columns)}']
    for second in range(0, 3600, 20):
        values = [f'{level + random.normal(0.0, 0.03):.3f}' for level in columns.values()]
        rows.append(f'{second},{",".join(values)}')
    path.write_text('\n'.join(rows) + '\n')
    return path


def test_a_table_of_a_night_tells_what_to_add(tmp_path, capsys):
    path = table(tmp_path / 'night.csv', front=21.0, rear=20.0, ambient=20.05, cabinet=24.0)
    out = tmp_path / 'check.json'
    words = ['sensors', 'check', str(path), '--drop-sensor', 'cabinet', '--json', str(out)]
    assert run(words) == 1
    shown = ' '.join(capsys.readouterr().out.split())
    assert 'add to offset' in shown
    assert 'Evidence: ' in shown
    assert 'is your word' in shown
    offsets = json.loads(out.read_text())['offsets']
    assert list(offsets) == ['front']
    assert offsets['front'] == pytest.approx(-0.95, abs=0.1)
    # What it advised is what makes them agree.
    path = table(path, front=21.0 + offsets['front'], rear=20.0, ambient=20.05)
    assert run(['sensors', 'check', str(path)]) == 0


def test_commands_of_the_page_work(devices, tmp_path, monkeypatch, root):
    """Those that need sensors and a night, with a folder of sensors and a table in their place."""
    from fuzzycnc_ros.core.thermal import sensor_check

    page = (root / 'docs' / 'how-to' / 'your-sensors.md').read_text()
    shown = re.findall(r'^ *(fuzzycnc (?:sensors|schema) .*)$', page, re.M)
    assert len(shown) == 5
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sensor_check, 'REST_WINDOW_MIN', 0.5)
    (tmp_path / 'w1' / FRONT / 'temperature').write_text('19862\n')  # 20.062 with its offset
    table(tmp_path / 'night.csv', front=20.0, rear=20.1, ambient=20.05, cabinet=20.1)
    columns = 'front,rear,ambient,cabinet'
    assert run(['import-csv', 'night.csv', '--out', 'night', '--temperature', columns]) == 0
    for line in shown:
        words = line.replace('10min', '1.5s').split()[1:]
        assert run(words) == 0, line


def test_what_cannot_be_compared_is_refused_in_a_line(tmp_path, capsys, root):
    path = table(tmp_path / 'two.csv', front=21.0, rear=20.0)
    assert run(['sensors', 'check', str(path)]) == 2
    assert 'of two that differ either may be wrong' in capsys.readouterr().err
    assert run(['sensors', 'check', str(path), '--drop-sensor', 'x']) == 2
    assert '--drop-sensor: expected some of front, rear but found x' in capsys.readouterr().err
    assert run(['sensors', 'check', str(path), '--time', 't']) == 2
    path.write_text(path.read_text().replace('.', ',').replace(',', ';', 1))
    capsys.readouterr()
    assert run(['sensors', 'check', str(path)]) == 2
    assert ' --' not in capsys.readouterr().err.replace('`fuzzycnc import-csv --', '')
    assert run(['sensors', 'check', str(root / 'bags' / 'mill_warm_up')]) == 2
    assert 'with the spindle at rest' in capsys.readouterr().err


def test_devices_are_read_for_a_while_and_the_whole_offset_is_told(
    devices, tmp_path, monkeypatch, capsys
):
    from fuzzycnc_ros.core.thermal import sensor_check

    monkeypatch.setattr(sensor_check, 'REST_WINDOW_MIN', 0.5)
    out = tmp_path / 'check.json'
    words = ['sensors', 'check', str(devices), '--duration', '1.5s', '--json', str(out)]
    assert run(words) == 1
    assert 'offset to write' in ' '.join(capsys.readouterr().out.split())
    # 21.2 with an offset of 0.2 against the median of 20.062, which is that of two at 20.03.
    assert json.loads(out.read_text())['offsets'] == {'front': pytest.approx(-0.969, abs=0.05)}

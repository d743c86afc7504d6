# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values in a real HAL: pins, signals, faults, its end and its return."""

import pytest

pytest.importorskip('rclpy')

from equipment.hal_alone import HalAlone, skip_without
from equipment.polled import good, is_text, lost, wait

pytestmark = pytest.mark.ros

FILE = """
devices:
  - name: card
    protocol: linuxcnc_hal
    interpreter: {interpreter}
    period: 0.02
    sensors:
      front: card.temp
      rear: {{pin: rear, offset: -0.5}}
      motor: {{pin: card.adc, ntc: {{beta: 3950, divider: {{fixed: 10000, supply: 4096}}}}}}
      coolant: {{pin: card.temp, fault: card.open}}
      gone: card.nothing
      switch: card.open
    spindle_speed: {{pin: card.rps, scale: 60}}
"""
GOOD = [21.5, 21.0, pytest.approx(25.0), 21.5]


@pytest.fixture
def hal(tmp_path):
    skip_without()
    made = HalAlone(tmp_path)
    made.start()
    made.set(temp=21.5, adc=2048, open=False, rps=50.0)
    yield made
    made.stop()


def test_pins_signals_and_faults_of_hal_are_read_and_it_comes_back(hal, poll_file):
    poller = poll_file(FILE.format(interpreter=hal.interpreter))
    *found, gone, switch, speed = wait(poller, good).readings
    assert found == GOOD
    assert is_text(gone, 'HAL has no pin, signal or parameter card.nothing', 'halcmd show pin')
    assert is_text(switch, 'card.open: expected a number but found False')
    assert speed == pytest.approx(314.159, abs=1e-3)

    hal.set(open=True, adc=4096)
    found = wait(poller, lambda item: good(item) and is_text(item.readings[3], 'card.open is tr'))
    assert found.readings[0] == 21.5
    wait(poller, lambda item: good(item) and is_text(item.readings[2], 'none of its thermistor'))
    for value, text in (('nan', "found 'nan'"), (5000.0, 'reads 5000 degC, which no sensor')):
        hal.set(temp=value)
        wait(poller, lambda item, t=text: good(item) and is_text(item.readings[0], t))

    hal.stop()
    assert wait(poller, lost).trouble
    hal.start()
    hal.set(temp=21.5, adc=2048, open=False, rps=50.0)
    wait(poller, lambda item: good(item) and list(item.readings[:4]) == GOOD)


def test_without_hal_or_its_python_it_says_what_to_do(poll_file, tmp_path):
    skip_without()
    program = tmp_path / 'python3'
    program.write_text('#!/bin/sh\nexec unshare --ipc /usr/bin/python3 "$@"\n')
    program.chmod(0o755)
    poller = poll_file(FILE.format(interpreter=program))
    assert wait(poller, lost).trouble == 'HAL does not run here; start LinuxCNC'
    poller = poll_file(FILE.format(interpreter=tmp_path / 'python9'))
    assert 'python9: ' in wait(poller, lost).trouble

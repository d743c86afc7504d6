# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The bridge and a real LinuxCNC: every trap of external offsets, and who dies when."""

import shutil
import signal
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from equipment.bridge_rig import ACTIVATE, CONFIGURE, DEACTIVATE, MICRON, BridgeRig
from equipment.linuxcnc_machine import LinuxcncMachine, exclusive
from processes import KEPT

from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    SECOND,
)

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.qualify]

AXES = ('X', 'Y', 'Z')
CLOSE = 0.2 * MICRON
"""Applied against requested, after settling [m]."""
SLOPE = (1e-4, -5e-5, 1.5e-4)
"""Of all commands to a LinuxCNC that takes slopes; at zero of the machine they change nothing."""
FAST = {'slew_max': 200 * MICRON}


@pytest.fixture(scope='module', params=[False, True], ids=['counts', 'slopes'])
def controller(request):
    """A LinuxCNC for the tests of this file, with stock components alone and with ours."""
    with exclusive(slopes=request.param):
        folder = Path(tempfile.mkdtemp(prefix='fuzzycnc-linuxcnc-'))
        machine = LinuxcncMachine(folder, slopes=request.param)
        try:
            machine.start()
            yield machine
        finally:
            machine.end()
            shutil.rmtree(folder, ignore_errors=True)


class Rig(BridgeRig):
    """A bridge on the LinuxCNC of this file."""

    NODE = 'linuxcnc_bridge'
    AXES = AXES
    CLOSE = CLOSE

    def __init__(self, graph, observer, controller):
        super().__init__(graph, observer)
        self.controller = controller

    @property
    def slopes(self):
        """Whether the servo thread takes slopes."""
        return 'fuzzycnc-sequence' in self.controller.halcmd('show', 'sig', 'fuzzycnc-sequence')

    def command(self, offset, *, slope=None, reference=(0.0, 0.0, 0.0), **more):
        """Command offsets [um], along lines wherever those are taken."""
        if slope is None:
            slope = SLOPE if self.slopes else (0.0, 0.0, 0.0)
        super().command(offset, slope=slope, reference=reference, **more)

    def start(self, *, active=True, wait=True, **parameters):
        return self.launch({**FAST, **parameters}, active=active, wait=wait)

    def position(self):
        """Where the machine is, offsets included [m]."""
        return 1e-3 * np.array(self.controller.state()['position'])


@pytest.fixture
def rig(graph, observer, controller):
    """A bridge on a homed machine at zero, without offsets."""
    controller.halcmd('sets', 'fuzzycnc-on', '1')
    controller.on()
    controller.home()
    controller.line('G53 G0 X0 Y0 Z0')
    return Rig(graph, observer, controller)


def test_follows_tells_and_ramps_to_zero(rig):
    rig.start(active=False)
    assert (rig.last.status, rig.last.reason) == (OffsetStatus.IDLE, '')
    assert not rig.allowed
    rig.command((5, 5, 5))
    assert rig.change(CONFIGURE)
    assert rig.change(ACTIVATE)
    rig.until(lambda: rig.allowed, 'allowed')
    rig.settle((10, -20, 30))
    assert rig.last.status == OffsetStatus.FOLLOWING
    np.testing.assert_allclose(rig.position(), MICRON * np.array([10, -20, 30]), atol=CLOSE)
    np.testing.assert_allclose(rig.states[-1].position, 0.0, atol=1e-9)
    assert rig.states[-1].state == MachineMode.ON
    assert rig.change(DEACTIVATE)
    rig.until(lambda: rig.at((0, 0, 0)) and rig.last.status == OffsetStatus.IDLE, 'at zero')
    assert not rig.allowed
    path = np.array([item.offset for item in rig.applied])
    stamps = np.array([item.stamp for item in rig.applied]) / SECOND
    # Between two looks LinuxCNC goes on where the bridge does not see it.
    reach = FAST['slew_max'] * (np.diff(stamps) + 0.02) + CLOSE
    assert (np.abs(np.diff(path, axis=0)).max(axis=1) <= reach).all()
    rig.until(lambda: rig.controller.halcmd('gets', 'fuzzycnc-enable') == 'FALSE', 'lets go')


def test_line_along_an_axis(rig):
    """K0 + slope (x - P0) follows the commanded position, at which the offset is not counted."""
    rig.start()
    rig.command((10, 0, 0), slope=(2e-4, 0, 0), reference=(0.05, 0, 0))
    if not rig.slopes:
        rig.refused('LinuxCNC takes none on X; its HAL file is fuzzycnc.hal')
        return
    rig.until(lambda: rig.at((0, 0, 0)), 'at zero of the line')
    rig.controller.line('G53 G0 X150')
    rig.until(lambda: rig.at((30, 0, 0)), '30 um at 150 mm')
    rig.until(lambda: abs(rig.states[-1].position[0] - 0.15) < 1e-8, 'at rest')
    rig.until(lambda: rig.at((30, 0, 0)), 'in force at rest')
    assert rig.position()[0] == pytest.approx(0.15 + 30e-6, abs=CLOSE)
    rig.controller.off()
    rig.refused('machine is off')
    rig.controller.on()
    rig.controller.teleop()
    rig.until(lambda: rig.allowed and rig.at((0, 0, 0)), 'starts anew at zero, wherever it parks')
    rig.command((10, 0, 0), slope=(2e-4, 0, 0), reference=(0.05, 0, 0))
    rig.until(lambda: rig.at((30, 0, 0)), 'of the place where it was parked')
    rig.controller.line('G53 G0 X0')
    rig.until(lambda: rig.at((0, 0, 0)), 'at zero of the line again')
    assert rig.position()[0] == pytest.approx(0.0, abs=CLOSE)


def test_nothing_before_homing(rig):
    rig.controller.unhome()
    rig.start(wait=False)
    rig.refused('not homed')
    rig.command((20, 0, 0))
    rig.observer.spin_for(0.3)
    assert rig.at((0, 0, 0))
    assert not rig.states[-1].homed
    rig.controller.home()
    rig.until(lambda: rig.allowed, 'allowed')
    rig.settle((20, 0, 0))


def test_off_and_on_with_an_offset(rig):
    zero = rig.controller.halcmd('getp', 'joint.2.motor-pos-cmd')
    rig.start()
    rig.settle((0, 0, 50))
    rig.controller.off()
    rig.refused('machine is off')
    rig.until(lambda: rig.states[-1].state == MachineMode.OFF, 'state')
    rig.controller.estop()
    rig.refused('emergency stop')
    before = rig.position()
    rig.controller.on()
    rig.controller.teleop()
    rig.until(lambda: rig.allowed and rig.at((0, 0, 0)), 'starts anew at zero')
    np.testing.assert_allclose(rig.position(), before, atol=CLOSE)
    rig.observer.spin_for(0.3)
    assert rig.at((0, 0, 0))
    # The zero of the machine stays: a probe in machine coordinates sees all of the error again.
    rig.controller.line('G53 G0 Z0')
    moved = float(rig.controller.halcmd('getp', 'joint.2.motor-pos-cmd')) - float(zero)
    assert moved == pytest.approx(0.0, abs=1e-4)
    rig.settle((0, 0, 20))
    rig.settle((0, 0, 0))
    assert rig.at((0, 0, 0))


def test_frozen(rig):
    rig.start()
    rig.settle((0, 0, 40))
    rig.controller.halcmd('sets', 'fuzzycnc-on', '0')
    rig.refused('frozen at Z 40')
    rig.observer.spin_for(0.5)
    assert rig.at((0, 0, 40))
    assert not rig.allowed
    rig.controller.halcmd('sets', 'fuzzycnc-on', '1')
    rig.until(lambda: rig.allowed, 'takes offsets again')
    rig.settle((0, 0, 15))
    rig.settle((0, 0, 0))
    assert rig.controller.halcmd('gets', 'fuzzycnc-register-z') == '0'


def test_scale_changes_with_counts_standing(rig):
    rig.start()
    rig.settle((0, 0, 40))
    scale = ('sets', 'fuzzycnc-scale-z') if rig.slopes else ('setp', 'axis.z.eoffset-scale')
    rig.controller.halcmd(*scale, '0.00002')
    try:
        rig.until(lambda: any('counts of zero meant' in a.reason for a in rig.applied), 'noticed')
        rig.until(lambda: rig.allowed and rig.at((0, 0, 0)), 'goes on')
        rig.settle((0, 0, 15))
        rig.settle((0, 0, 0))
        assert rig.controller.halcmd('gets', 'fuzzycnc-register-z') == '0'
    finally:
        rig.controller.halcmd(*scale, '0.00001')
    path = np.array([item.offset[2] for item in rig.applied])
    assert path.max() <= 40e-6 + CLOSE
    assert path.min() >= -CLOSE


def test_soft_limit(rig):
    rig.start()
    rig.controller.line('G53 G0 Z199.98')
    rig.command((0, 0, 50), reference=(0, 0, 0.19998))
    rig.until(lambda: rig.last.at_limit[2], 'the limit is told')
    rig.until(lambda: 'a soft limit cuts Z 50.00 um to Z 20' in rig.last.reason, 'why')
    rig.controller.line('G53 G0 Z0')
    rig.command((0, 0, 50))
    rig.until(lambda: rig.at((0, 0, 50)) and not rig.last.at_limit.any(), 'in full')
    rig.settle((0, 0, 0))


def test_joint_mode(rig):
    rig.start()
    rig.settle((0, 0, 20))
    rig.controller.joints()
    rig.command((0, 0, 5))
    rig.until(lambda: 'joint mode' in rig.last.reason, 'told')
    assert rig.at((0, 0, 20))
    rig.controller.teleop()
    rig.until(lambda: rig.at((0, 0, 5)) and not rig.last.reason, 'follows')


def test_own_limits_and_expiry(rig):
    rig.start()
    rig.command((500, 0, 0), slope=(0, 0, 0))
    rig.until(lambda: rig.at((60, 0, 0)) and rig.last.at_limit[0], 'cut')
    rig.command((10, 0, 0), valid=1.0)
    rig.until(lambda: rig.at((10, 0, 0)), 'follows')
    rig.until(lambda: rig.last.status == OffsetStatus.EXPIRED and rig.at((0, 0, 0)), 'expires')


def test_refuses_to_start_beside_another_writer(rig):
    rig.start()
    rig.settle((10, 0, 0))
    second = rig.graph.start('linuxcnc_bridge', FAST, namespace='/lathe')
    assert rig.change(CONFIGURE, 'lathe')
    rig.until(lambda: 'connected' in second.output, 'second is connected')
    assert not rig.change(ACTIVATE, 'lathe')
    assert 'is written by fuzzycnc-' in second.output
    assert second.interrupt() == 0
    assert rig.at((10, 0, 0))
    rig.settle((0, 0, 0))


def test_refuses_limits_beyond_those_of_the_hal_file(rig):
    rig.start(active=False, offset_max=200e-6)
    assert rig.change(CONFIGURE)
    assert not rig.change(ACTIVATE)
    assert 'offset_max = 200 µm is above the 100 µm' in rig.bridge.output


def test_killed_bridge_leaves_no_offset_and_a_new_one_goes_on(rig):
    rig.start()
    rig.settle((0, 30, 0))
    rig.graph.kill(rig.bridge)
    place = rig.position()
    seen = len(rig.applied)
    rig.start(active=False)  # within HOLD_TIME
    rig.refused('nobody owns it')
    assert rig.change(CONFIGURE)
    assert rig.change(ACTIVATE)
    rig.until(lambda: rig.last.status == OffsetStatus.FOLLOWING, 'taken over')
    rig.observer.spin_for(6.5)  # longer than HOLD_TIME
    np.testing.assert_allclose([item.offset[1] for item in rig.applied[seen:]], 30e-6, atol=CLOSE)
    np.testing.assert_allclose(rig.position(), place, atol=CLOSE)
    rig.epoch = 2
    rig.settle((0, 20, 0))
    rig.graph.kill(rig.bridge)
    end = time.monotonic() + 60.0
    while abs(rig.position()[1]) > CLOSE:
        assert time.monotonic() < end, 'the watchdog did not take the offset to zero'
        rig.observer.spin_for(0.05)
    rig.start()
    rig.until(lambda: rig.allowed, 'armed again')
    assert rig.at((0, 0, 0))
    rig.settle((0, 10, 0))
    hold = 'fuzzycnc-offset.hold-time' if rig.slopes else 'watchdog.timeout-0'
    rig.controller.halcmd('setp', hold, '600')  # it is not what does this:
    assert rig.bridge.interrupt(signal.SIGINT) == 0
    end = time.monotonic() + 60.0
    while abs(rig.position()[1]) > CLOSE:
        assert time.monotonic() < end, 'a bridge that ends lets the offset go to zero at once'
        rig.observer.spin_for(0.05)


def test_linuxcnc_ends_and_comes_back(rig, monkeypatch):
    monkeypatch.setenv(*KEPT.split('='))  # what is started here ends with the file, not the test
    rig.start()
    rig.settle((0, 0, 25))
    rig.controller.end()
    rig.refused('LinuxCNC')
    assert not rig.last.offset.any()
    assert not rig.allowed
    for end in (rig.controller.kill, None):
        rig.controller.start()
        rig.until(lambda: 'not homed' in rig.last.reason, 'reads the new one')
        rig.controller.ready()
        rig.until(lambda: rig.allowed, 'allowed')
        rig.settle((0, 0, 25))
        if end is not None:
            end()
            rig.refused('LinuxCNC')
            assert not rig.allowed
    rig.settle((0, 0, 0))

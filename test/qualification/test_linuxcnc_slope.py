# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Offsets along an axis on a real LinuxCNC, judged in every servo period, whoever dies meanwhile.

What is asked for is offset + slope (x - P0) at the commanded position of the same period; what
LinuxCNC applies follows it as fast as OFFSET_AV_RATIO lets it, and is told apart.
"""

import contextlib
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from equipment.bridge_rig import MICRON, BridgeRig
from equipment.linuxcnc_machine import LinuxcncMachine, exclusive
from equipment.linuxcnc_offsets import PERIOD, LineTrace

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.qualify]

COUNT = 1e-8
"""Offset of one count [m]."""
SLEW = 100 * MICRON
RATE = 2 * SLEW
"""Of the HAL file [m/s]."""
SPEED = 0.2
SLOPE = 2e-4
LINE = {'slope': (SLOPE, 0.0, 0.0), 'reference': (0.05, 0.0, 0.0)}
WAY = 'G21 G90 G94 G64 P0.01\nF12000\no1 repeat [500]\nG1 X150\nG1 X-150\no1 endrepeat\nM2\n'
HOLD = 2.0


class Rig(BridgeRig):
    """A bridge on a LinuxCNC whose X goes forth and back at 200 mm/s."""

    NODE = 'linuxcnc_bridge'
    AXES = ('X', 'Y', 'Z')
    CLOSE = 0.2 * MICRON

    def __init__(self, graph, observer, controller, folder):
        super().__init__(graph, observer)
        self.controller, self._folder = controller, folder
        self.trace = None

    @property
    def gantry(self):
        """Whether X has two joints."""
        return 'X' in self.controller.letters[1:]

    def start(self):
        """Start LinuxCNC, and sample it in every servo period from then on."""
        self.controller.start()
        self.trace = LineTrace(self.controller, self._folder, 'x')
        self.controller.ready()

    def bring_line(self, offset=10.0):
        """Bring a bridge, and the line in force."""
        self.launch({'slew_max': SLEW, 'adopt_time': 20.0}, active=True, wait=True)
        self.renew(offset)

    def renew(self, offset=10.0):
        """Command the line until it is all in force."""

        def there():
            self.command((offset, 0, 0), **LINE)
            self.observer.spin_for(0.2)
            return self.ends == pytest.approx([offset - 50.0, offset + 30.0], abs=0.02)

        self.until(there, 'line in force')

    @property
    def ends(self):
        """Offsets that the servo thread has at both ends of the travel [um]."""
        found = [self.controller.halcmd('gets', f'fuzzycnc-{end}-x') for end in ('low', 'high')]
        return [1e6 * COUNT * float(text.split()[-1]) for text in found]

    def run_axis(self):
        self.controller.run(self.controller.write_program('way', WAY))

    def stop(self):
        """End the samples; check what holds of all, return them."""
        found = self.trace.stop()
        asked, line = found.request[1:], found.line[:-1]
        follows = found.following[:-1] & found.following[1:]
        apart = np.abs(asked - line)[follows]
        speed = np.abs(np.diff(found.position)) / PERIOD
        # what moves without its axis moves no faster than the HAL file allows
        still = (speed[:-1] < 1e-9) & (speed[1:] < 1e-9)
        change = np.abs(np.diff(found.request))[1:][still]
        print(
            f'{len(found.position)} periods, {int(follows.sum())} followed at up to '
            f'{speed.max():.3f} m/s; asked from its line {1e6 * apart.max():.4f} um; largest '
            f'step at rest {1e6 * change.max():.4f} um; applied from asked '
            f'{1e6 * np.abs(found.applied - found.request).max():.3f} um'
        )
        return found

    def close(self):
        if self.trace is not None:
            self.trace.close()


@pytest.fixture
def rig(graph, observer, request):
    """A LinuxCNC that takes slopes, homed and on; X may be a gantry of two joints."""
    with exclusive(slopes=True), contextlib.ExitStack() as stack:
        folder = Path(tempfile.mkdtemp(prefix='fuzzycnc-linuxcnc-'))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        section = {'COUNTS_PER_SECOND': RATE / COUNT, 'HOLD_TIME': HOLD}
        controller = LinuxcncMachine(
            folder, slopes=True, letters=getattr(request, 'param', 'XYZ'), **section
        )
        stack.callback(controller.end)
        found = Rig(graph, observer, controller, folder)
        stack.callback(found.close)
        found.start()
        yield found


def test_what_is_asked_for_is_the_line_at_the_commanded_position(rig):
    rig.bring_line()
    rig.run_axis()
    begin = len(rig.applied)
    end = time.monotonic() + 8.0
    while time.monotonic() < end:
        rig.renew()
    assert rig.applied[-1].reason == ''
    assert not any(item.at_limit.any() for item in rig.applied[begin:])
    found = rig.stop()
    position, asked = found.position[-4000:], found.request[-4000:]
    speed = np.abs(np.diff(position)) / PERIOD
    assert speed.max() == pytest.approx(SPEED, rel=1e-3)
    wanted = 10 * MICRON + SLOPE * (position - 0.05)
    bound = COUNT + SLOPE * np.append(speed, speed[-1]) * PERIOD
    assert (np.abs(asked - wanted) <= bound + 1e-12).all()
    # of the period before, it is the line to half a count
    assert np.abs(asked[1:] - wanted[:-1]).max() <= 0.5 * COUNT + 1e-12


def test_killed_bridge_and_a_new_one(rig):
    """The line stands and follows the axis for the hold, then goes to zero at every place."""
    rig.bring_line()
    rig.run_axis()
    rig.renew()
    rig.graph.kill(rig.bridge)
    rig.observer.spin_for(0.5 * HOLD)
    assert rig.ends == pytest.approx([-40.0, 40.0], abs=0.02)
    rig.bring_line()  # within the hold, or while it goes to zero
    rig.graph.kill(rig.bridge)
    rig.until(lambda: rig.ends == [0.0, 0.0], 'taken to zero by the servo thread')
    found = rig.stop()
    assert found.request[-1] == pytest.approx(0.0, abs=COUNT)
    for place in (found.low, found.high):
        assert np.abs(np.diff(place)).max() <= RATE * 1.5 * PERIOD


def test_linuxcnc_is_killed(rig):
    rig.bring_line()
    rig.controller.kill()
    rig.refused('LinuxCNC')
    rig.close()
    rig.start()
    rig.until(lambda: rig.allowed, 'allowed')
    assert rig.ends == [0.0, 0.0]
    rig.renew()
    found = rig.stop()
    assert np.abs(np.diff(found.request)).max() <= RATE * 1.5 * PERIOD + COUNT


def test_off_on_and_homed_anew_away_from_the_reference(rig):
    """At power-on the offset becomes part of the position, and no zero moves by it."""
    zero = rig.controller.halcmd('getp', 'joint.0.motor-pos-cmd')
    rig.bring_line()
    rig.controller.line('G53 G0 X150')
    rig.renew()
    rig.controller.off()
    rig.until(lambda: rig.ends == [0.0, 0.0], 'dropped')
    rig.controller.on()
    rig.controller.teleop()
    rig.renew()
    rig.controller.line('G53 G0 X50')
    rig.until(lambda: rig.at((10, 0, 0)), 'at the reference')
    moved = float(rig.controller.halcmd('getp', 'joint.0.motor-pos-cmd')) - float(zero)
    assert moved == pytest.approx(50.01, abs=2e-4)
    rig.controller.unhome()
    rig.refused('not homed')
    rig.controller.home()
    rig.until(lambda: rig.allowed, 'allowed')
    rig.renew()
    found = rig.stop()
    ready = found.following[1:] & found.following[:-1]
    speed = np.abs(np.diff(found.position)) / PERIOD
    step = np.abs(np.diff(found.request)) - 1.01 * SLOPE * speed * PERIOD
    assert step[ready].max() <= RATE * 1.5 * PERIOD + 2 * COUNT


@pytest.mark.parametrize('rig', ['XYZ', 'XYZX'], indirect=True)
def test_joint_mode_moves_no_offset_and_leaps_nowhere_after_it(rig):
    """The position of the axis is an old one there; the joint is moved by 100 mm meanwhile."""
    rig.bring_line()
    rig.controller.line('G53 G0 X50')
    rig.renew()
    rig.controller.joints()
    rig.until(lambda: rig.controller.halcmd('gets', 'fuzzycnc-tracking') == 'FALSE', 'seen')
    for joint in (0, 3) if rig.gantry else (0,):
        rig.controller.jog(joint, 100.0, 50.0)
    rig.command((20, 0, 0), **LINE)
    rig.until(lambda: 'offsets do not move in joint mode' in rig.last.reason, 'told')
    assert rig.at((10, 0, 0))
    rig.controller.teleop()
    rig.renew(20.0)
    found = rig.stop()
    assert found.position[-1] == pytest.approx(0.15, abs=1e-4)
    assert found.request[-1] == pytest.approx(20 * MICRON + SLOPE * 0.1, abs=0.05 * MICRON)
    begin = np.flatnonzero(found.tracking[:-1] & ~found.tracking[1:])[-1]
    end = begin + np.flatnonzero(found.tracking[begin + 1 :])[0]
    inside = found.request[begin + 2 : end]
    assert np.ptp(inside) <= COUNT
    speed = np.abs(np.diff(found.position)) / PERIOD
    quiet = speed < 1e-3
    assert np.abs(np.diff(found.request))[quiet].max() <= RATE * 1.5 * PERIOD + 2 * COUNT

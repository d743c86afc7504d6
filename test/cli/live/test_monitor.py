# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What `operate status` waits for: on a busy computer states come after the reports of nodes."""

from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from fuzzycnc_ros.cli.live import supervision_monitor
from fuzzycnc_ros.cli.live.supervision_monitor import Monitor

STATES = ('unconfigured', 'inactive', 'active', 'inactive')


class Late(Monitor):
    """A monitor to which one message arrives each time that it listens."""

    def __init__(self, arriving):
        self.views = {}
        self._configurations = 0
        self._spins = 0
        self._arriving = iter(arriving)
        self.operator = SimpleNamespace(
            publishers=lambda topic: [SimpleNamespace(node_name='compensator')]
        )
        self._tell = self._configuration_handler('mill')

    @property
    def age(self):
        return 0.1 * self._spins

    def present(self):
        return {('mill', 'compensator')}

    def spin(self, duration=0.1):
        self._spins += 1
        state = next(self._arriving, None)
        if state == 'report':
            self.view('mill', 'compensator').heard_at = 1.0
        elif state:
            self._tell(SimpleNamespace(node='compensator', lifecycle_state=state))


@pytest.mark.parametrize(('report', 'quiet'), [(0, 0), (0, 40), (2, 0), (4, 0)])
def test_the_newest_state_is_waited_for(monkeypatch, report, quiet):
    monkeypatch.setattr(supervision_monitor, '_living', lambda machine: set())
    arriving = [*STATES[:report], 'report', *[''] * quiet, *STATES[report:]]
    monitor = Late(arriving)
    monitor.settle('mill', 2.5)
    assert monitor.lifecycle('mill', 'compensator') == 'inactive'
    assert monitor.view('mill', 'compensator').was_active

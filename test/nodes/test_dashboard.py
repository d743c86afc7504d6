# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How often a dashboard looks for news."""

from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')
pytest.importorskip('starlette', reason="the page needs pip install 'fuzzycnc_ros[page]'")

from fuzzycnc_ros.nodes.dashboard import ALONE, TICK, DashboardNode

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ('clients', 'interval', 'pause'),
    [(0, 30.0, ALONE), (0, 0.5, 0.5), (1, 30.0, TICK), (2, 0.5, TICK)],
)
def test_without_clients_it_looks_rarely_but_soon_enough_for_the_first(
    make_node, tmp_path, clients, interval, pause
):
    node = DashboardNode(
        make_node('dashboard', port=0, interval=interval, state_directory=str(tmp_path))
    )
    server = node._server
    try:
        node._server = SimpleNamespace(clients=clients, show=lambda *view: None)
        node._show()
        assert node._ticks.timer_period_ns == pytest.approx(1e9 * pause)
    finally:
        node._server = server
        node.stop()

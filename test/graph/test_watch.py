# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The live page and its twin in the terminal, as commands start them."""

import json
import time
import urllib.request

import pytest
from processes import free_port

from fuzzycnc_ros.runtime.records import Temperatures

pytest.importorskip('starlette', reason="the page needs pip install 'fuzzycnc_ros[page]'")

pytestmark = [pytest.mark.ros, pytest.mark.slow]

RUN = 600.0
"""Wall time [s] in which a demo must be done, also on a busy computer."""


def answers(port):
    """Whether a page is served at a port of this computer."""
    try:
        with urllib.request.urlopen(f'http://127.0.0.1:{port}/', timeout=10.0) as page:
            return b'<title>' in page.read()
    except OSError:
        return False


def test_a_graph_with_its_page_is_watched_in_the_terminal(command, observer, tmp_path):
    samples = observer.records('temperatures', Temperatures)
    port = free_port()
    nodes = ('--nodes', 'temperature_acquisition')
    up = command('up', '--simulate', 'T2', '--rate', 60, *nodes, f'--page={port}')
    observer.until(lambda: f'live page: http://127.0.0.1:{port}/' in up.output, up.output)
    observer.until(lambda: answers(port) and len(samples) > 2, up.output)
    view = {'sensors': {'ok': 0}}
    until = time.monotonic() + RUN
    while not view['sensors']['ok']:  # a screen shows what came while it was made
        assert time.monotonic() < until, up.output
        watched = command('watch', '--once', '--json', tmp_path / 'view.json')
        assert watched.wait() == 0, watched.output
        view = json.loads((tmp_path / 'view.json').read_text())
    assert view['machine'] == 'mill'
    assert view['sensors']['ok'] == 76
    assert 'sensors 76 of 76 good' in watched.output
    # Beside the screen the middleware may complain of what others left in shared memory.
    screen = [line for line in watched.output.splitlines() if 'RTPS_' not in line]
    assert not any('\x1b' in line for line in screen)
    assert max(map(len, screen)) <= 80
    assert up.interrupt() == 0, up.output


def test_a_demo_shows_its_machine_until_it_is_ended(command, observer, tmp_path):
    port = free_port()
    demo = command('demo', '--scenario', 'contour', f'--page={port}', '--out', tmp_path / 'shown')
    observer.until(lambda: answers(port), demo.output)
    observer.until(lambda: 'stays until Ctrl-C' in demo.output, demo.output, RUN)
    assert answers(port)
    assert demo.interrupt() in (0, 130), demo.output
    assert not answers(port)
    assert (tmp_path / 'shown' / 'report.html').is_file()

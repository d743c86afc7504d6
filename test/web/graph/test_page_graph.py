# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a browser shows of a real graph is what the node says, and troubles are seen in time."""

import re
import signal
import socket
import sys
import time
from urllib.parse import urlsplit

import pytest

pytest.importorskip('starlette', reason="the page needs pip install 'fuzzycnc_ros[page]'")

from live_page import model_fields, node_rows, number, offset_rows, operator_fields
from processes import free_port

pytestmark = pytest.mark.ros

UPDATES = 6
"""Views that are compared on each tab."""
RATE = 60.0
WITHIN = 2.0
"""Time [s] in which trouble must be seen."""
LISTEN = """
window.told = {};
const socket = new WebSocket(location.origin.replace('http', 'ws') + '/live');
socket.onmessage = ({data}) => {
  const {type, machine, view} = JSON.parse(data);
  if (type === 'view') (window.told[machine] ??= {})[view.sequence] = view;
};
"""
"""A second reader of the same socket, which keeps what the page is told."""


def compare(page, url, machine, tab, check, updates=UPDATES):
    """Compare what is seen with what was told, in so many updates."""
    page.open(url, machine, tab)
    page.run(LISTEN)
    compared = set()

    def another():
        seen = page.seen()
        # Plots of many lines may be a view behind.
        sequence = seen['drawn'] if tab == 'temperatures' else seen['sequence']
        view = page.run('return window.told[arguments[0]]?.[arguments[1]]', machine, sequence)
        if view is not None and sequence not in compared:
            check(seen, view)
            compared.add(sequence)
        return len(compared) >= updates

    page.until(another, f'{updates} updates of {machine}')


def check_operator(seen, view):
    assert seen['fields'] == operator_fields(view)
    assert seen['state'] == view['state']['compensation']
    assert [alarm[1] for alarm in seen['alarms']] == [alarm['cause'] for alarm in view['alarms']]
    assert ('NO DATA' in seen['noData']) == bool(view['silent'])


def check_offsets(seen, view):
    assert seen['sheets'].get('Offsets now', []) == offset_rows(view)


def check_model(seen, view):
    assert seen['fields'] == model_fields(view)
    assert seen['sheets'] == {'Nodes': node_rows(view)}


def check_temperatures(seen, view):
    if not seen['legends']:
        return  # the past is being fetched
    wanted = {name: number(value, 2, '°C') for name, value in view['sensors']['values'].items()}
    shown = {name: text for name, text in seen['legends'].items() if name in wanted}
    assert shown == wanted


def address(observer, running):
    """Wait for the address of the page of a command or node."""
    observer.until(lambda: 'live page: ' in running.output, running.output)
    url = re.findall(r'live page: (\S+)', running.output)[0]

    def listens():
        with socket.socket() as asking:
            return asking.connect_ex(('127.0.0.1', urlsplit(url).port)) == 0

    observer.until(listens, f'{url} is served: {running.output}')  # `up` says it beforehand
    return url


@pytest.mark.slow
def test_two_machines_and_their_bags(graph, observer, opened, model_file, tmp_path):
    port = free_port()
    command = [
        *(sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'up', '--simulate', 'T2'),
        *('--machine', 'mill,lathe', '--rate', f'{RATE:g}', '--model', str(model_file)),
        *('--autostart', '--compose', f'--page={port}', '--record', str(tmp_path / 'bag')),
    ]
    up = graph.launch('up', command, tmp_path)
    url = address(observer, up)
    opened.look(1920, 1080, 'light')
    compare(opened, url, 'mill', 'operator', check_operator)
    opened.until(lambda: opened.seen()['state'] == 'active', 'compensation')
    opened.complaints()
    compare(opened, url, 'mill', 'operator', check_operator)
    compare(opened, url, 'lathe', 'offsets', check_offsets)
    compare(opened, url, 'lathe', 'model', check_model)
    compare(opened, url, 'mill', 'temperatures', check_temperatures)
    opened.open(url, 'mill', 'error')
    opened.until(lambda: opened.seen()['rows'] > 5, 'what was before the page was opened')
    assert {'Y predicted', 'Z predicted'} <= set(opened.seen()['legends'])
    assert opened.complaints() == []
    assert up.interrupt(signal.SIGINT) == 0
    opened.until(lambda: 'The server does not answer' in opened.seen()['noData'], 'NO DATA')

    page = graph.start('dashboard', {'port': 0}, namespace='/')
    url = address(observer, page)
    bag = tmp_path / 'bag_mill'
    graph.start('player', {'bag': str(bag), 'rate': RATE})
    compare(opened, url, 'mill', 'operator', check_operator)
    compare(opened, url, 'mill', 'offsets', check_offsets)


def predictor_killed(nodes):
    """Kill the predictor; return what must be seen."""
    nodes['thermal_predictor'].send(signal.SIGKILL)
    return lambda seen: any(
        'thermal_predictor' in row[0] and 'ended' in row[1] for row in seen['alarms']
    )


def machine_killed(nodes):
    """Kill all nodes of the machine; return what must be seen."""
    for running in nodes.values():
        running.send(signal.SIGKILL)
    return lambda seen: 'NO DATA' in seen['noData']


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize('trouble', [predictor_killed, machine_killed])
def test_trouble_is_seen_in_time_with_its_cause(graph, observer, opened, model_file, trouble):
    nodes = graph.start_shift(model_file, lockstep=False, rate=RATE)
    page = graph.start('dashboard', {'port': 0}, namespace='/')
    url = address(observer, page)
    opened.open(url)
    opened.until(lambda: opened.seen()['state'] == 'active', 'compensation')
    begin = time.monotonic()
    shown = trouble(nodes)
    opened.until(lambda: shown(opened.seen()), 'the trouble')
    elapsed = time.monotonic() - begin
    told = opened.seen()
    assert 'ended' in f'{told["alarms"]} {told["noData"]}'
    assert elapsed < WITHIN, f'seen after {elapsed:.2f} s'


def test_a_page_that_hangs_is_told(graph, observer, opened):
    page = graph.start('dashboard', {'port': 0}, namespace='/')
    url = address(observer, page)
    graph.start('temperature_acquisition', {})
    opened.open(url)
    page.send(signal.SIGSTOP)
    try:
        opened.until(lambda: 'Nothing from the server' in opened.seen()['noData'], 'NO DATA')
    finally:
        page.send(signal.SIGCONT)


@pytest.mark.slow
def test_a_limit_and_a_sensor(graph, observer, opened, model_file):
    graph.start_shift(
        model_file,
        lockstep=False,
        rate=RATE,
        sensor_faults=('T62:dead:600',),
        overrides={'compensator': {'offset_max': 3e-6}},
    )
    url = address(observer, graph.start('dashboard', {'port': 0}, namespace='/'))
    opened.open(url)
    opened.until(lambda: any('T62' in text for text in opened.seen()['lost']), 'the lost sensor')
    opened.until(
        lambda: 'limit of size' in opened.seen()['fields'].get('Y limited', ''), 'the limit'
    )
    compare(opened, url, 'mill', 'operator', check_operator)

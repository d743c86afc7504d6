# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the server answers: frames, stretches of history, bags, actions."""

import io
import json
import tarfile

import pytest
from processes import wait_for
from websockets.sync.client import connect

from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.web.live import Frames

TEXT = b'\x00\x01\x00\x00\x03\x00\x00\x00hi\x00'


def test_a_page_is_greeted_and_gets_views(page):
    with connect(f'ws://{page.host}/live') as client:
        hello = json.loads(client.recv(timeout=30))
        assert hello == {'type': 'hello', 'machines': ['mill', 'shop/lathe']}
        page.server.show('mill', {'sequence': 1})
        frame = json.loads(client.recv(timeout=30))
        assert frame == {'type': 'view', 'machine': 'mill', 'view': {'sequence': 1}}
        page.server.greet({'type': 'hello', 'machines': []})
        assert json.loads(client.recv(timeout=30))['machines'] == []
    wait_for(lambda: page.server.clients == 0, 'it has gone')


def test_frames_are_replaced_and_never_queued():
    frames = Frames()
    frames.greet({'machines': ['a', 'b']})
    number, newer = frames.since(-1)
    assert len(newer) == 1
    for sequence in range(1000):
        frames.put('a', f'a{sequence}')
    frames.put('b', 'b')
    number, newer = frames.since(number)
    assert newer == ['a999', 'b']
    assert frames.since(number) == (number, [])
    frames.greet({'machines': ['b']})
    assert frames.since(-1)[1][0] == 'b'


def test_nobody_gets_what_was_shown_before_all_had_left(page):
    with connect(f'ws://{page.host}/live') as client:
        client.recv(timeout=30)
        page.server.show('mill', {'sequence': 1})
        client.recv(timeout=30)
    wait_for(lambda: page.server.clients == 0, 'it has gone')
    with connect(f'ws://{page.host}/live') as client:
        assert json.loads(client.recv(timeout=30))['type'] == 'hello'
        page.server.show('mill', {'sequence': 2})
        assert json.loads(client.recv(timeout=30))['view'] == {'sequence': 2}


def test_a_stretch_of_history_is_asked_for_within_bounds(page):
    def ask(query):
        status, _, body = page.request('GET', f'/history/{query}')
        return status, json.loads(body)

    assert ask('mill?series=error&begin=1&end=2.5&points=7') == (
        200,
        {'machine': 'mill', 'series': 'error', 'time': [1.0, 2.5], 'points': 7},
    )
    assert ask('shop/lathe')[1]['machine'] == 'shop/lathe'
    assert ask('mill?points=999999999')[1]['points'] == 2000
    assert ask('mill?points=-5')[1]['points'] == 1
    for query in ('series=x', 'begin=x', 'end=nan', 'end=inf', 'points=1.5', 'points=1e9'):
        status, says = ask(f'mill?{query}')
        assert (status, bool(says['says'])) == (400, True), query
    status, says = ask('nobody')
    assert status == 404
    assert 'mill' in says['says']


def test_an_action_is_carried_out_or_refused_with_the_remedy(page, refusing):
    status, says = refusing.act('reference', {'by': 'anna'})
    assert status == 409
    assert says == {'done': False, 'says': 'because; do that', 'needs': 'force'}
    page.machines.refusal = None
    assert page.act('reference', {'by': 'anna', 'force': True}) == (
        200,
        {'done': True, 'says': 'done'},
    )
    assert page.act('probe', {'values': {'Y': 1e-6}}, machine='shop/lathe')[0] == 200
    assert page.machines.done == [
        ('mill', 'reference', {'by': 'anna', 'force': True}),
        ('shop/lathe', 'probe', {'values': {'Y': 1e-6}}),
    ]
    assert page.act('reference', {}, machine='nobody')[0] == 404


@pytest.fixture
def bags(tmp_path):
    """A folder with a bag, one that is being written, one with a report, and something else."""
    folder = tmp_path / 'bags'
    for name in ('monday', 'tuesday'):
        with BagWriter(folder / name) as writer:
            writer.add_topic('/mill/note', 'std_msgs/msg/String')
            writer.write('/mill/note', 10**9, 10**9, TEXT)
            writer.write('/mill/note', 3 * 10**9, 3 * 10**9, TEXT)
    (folder / 'tuesday.html').write_text('<h1>report</h1>')
    (folder / 'other').mkdir()
    return folder


def test_bags_are_listed_packed_and_reported(serve, bags):
    open_one = BagWriter(bags / 'today')
    open_one.add_topic('/mill/note', 'std_msgs/msg/String')
    page = serve(bags=bags)
    listed = {item['name']: item for item in json.loads(page.request('GET', '/bags/')[2])}
    assert set(listed) == {'monday', 'tuesday', 'today'}
    monday = listed['monday']
    assert (monday['begin'], monday['duration'], monday['complete']) == (1.0, 2.0, True)
    assert monday['bytes'] == sum(file.stat().st_size for file in (bags / 'monday').iterdir())
    assert not listed['today']['complete']
    assert listed['today']['duration'] is None
    open_one.close()
    status, headers, body = page.request('GET', '/bags/monday')
    assert status == 200
    assert 'monday.tar' in headers['content-disposition']
    with tarfile.open(fileobj=io.BytesIO(body)) as archive:
        for file in (bags / 'monday').iterdir():
            packed = archive.extractfile(f'monday/{file.name}')
            assert packed is not None
            assert packed.read() == file.read_bytes()
        assert len(archive.getnames()) == len(list((bags / 'monday').iterdir()))
    status, headers, body = page.request('GET', '/bags/tuesday/report')
    assert status == 200
    assert body == b'<h1>report</h1>'
    assert 'sandbox' in headers['content-security-policy']
    assert page.request('GET', '/bags/monday/report')[0] == 404
    assert page.request('GET', '/bags/other')[0] == 404


def test_without_a_folder_there_are_no_bags(page):
    assert json.loads(page.request('GET', '/bags/')[2]) == []
    assert page.request('GET', '/bags/monday')[0] == 404

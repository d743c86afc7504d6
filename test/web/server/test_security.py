# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What comes from elsewhere is refused or harmless, and nothing on the page moves an axis."""

import json
import os
import re
import resource
import socket
import time
from contextlib import ExitStack, contextmanager, suppress

import pytest
from processes import wait_for
from served_page import SECRET
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from fuzzycnc_ros.web import app, connections

pytestmark = pytest.mark.filterwarnings('ignore::ResourceWarning')

BEARER = {'Authorization': f'Bearer {SECRET}'}
OTHERS = ('evil.example', 'evil.example:80', '127.0.0.1.evil.example', '', '10.0.0.1', 'a b', '[')


@pytest.mark.parametrize('path', ['/', '/history/mill', '/bags/', '/static/page.js', '/nothing'])
@pytest.mark.parametrize('host', OTHERS)
def test_a_foreign_host_gets_nothing(page, path, host):
    status, _, body = page.request('GET', path, headers={'Host': host})
    assert status in (400, 403)
    assert b'mill' not in body


def test_two_hosts_or_none_get_nothing(page):
    for hosts in ((), (page.host, 'evil.example'), (page.host, page.host)):
        lines = ''.join(f'Host: {host}\r\n' for host in hosts)
        with page.open(f'GET /bags/ HTTP/1.1\r\n{lines}\r\n'.encode()) as connection:
            assert connection.recv(100).split()[1] in (b'400', b'403')


@pytest.mark.parametrize('origin', ['http://evil.example', 'null', 'https://{host}', 'http://x'])
def test_a_foreign_origin_neither_acts_nor_watches(page, origin):
    headers = {'Origin': origin.format(host=page.host)}
    status, says = page.act('deactivate', {}, **headers)
    assert status == 403
    assert 'Origin' in says['says']
    with page.open(page.socket(headers)) as connection:
        assert connection.recv(100).split()[1] == b'403'
    assert page.machines.done == []


def test_the_own_origin_and_none_are_served(page):
    assert page.act('deactivate', {}, Origin=f'http://{page.host}')[0] == 200
    assert page.act('deactivate', {})[0] == 200


def test_a_name_of_this_computer_can_be_added(serve):
    page = serve(hosts=('mill.shop',))
    assert page.request('GET', '/bags/', headers={'Host': 'mill.shop'})[0] == 200
    assert page.request('GET', '/bags/', headers={'Host': 'MILL.shop:80'})[0] == 200
    assert page.request('GET', '/bags/', headers={'Host': 'mill.shop.evil'})[0] == 403


def test_without_the_token_one_reads_and_does_not_act(serve):
    page = serve(SECRET)
    assert page.request('GET', '/history/mill')[0] == 200
    wrong = (
        {},
        {'Authorization': 'Bearer'},
        {'Authorization': 'Bearer wrong'},
        {'Authorization': f'Basic {SECRET}'},
        {'Authorization': f'Bearer {SECRET}x'},
        {'Authorization': f'Bearer {SECRET[:-1]}'},
        {'Authorization': SECRET},
        {'Authorization': 'Bearer \xff'},
        {'Cookie': f'token={SECRET}'},
    )
    for headers in wrong:
        for action in (*app.ACTIONS, 'jog'):
            status, says = page.act(action, {}, **headers)
            assert (status, says['needs']) == (401, 'token'), headers
        assert page.act(f'deactivate?token={SECRET}', {}, **headers)[0] == 401
    assert page.machines.done == []
    assert page.act('deactivate', {}, **BEARER)[0] == 200
    assert len(page.machines.done) == 1


def test_what_can_be_asked_for_is_this_and_no_more(page):
    """Nothing else has a route: no axis is moved, no limit raised, no parameter set."""
    routes = {
        (route.path, tuple(sorted(getattr(route, 'methods', None) or ())))
        for route in app.page_app(
            app.LivePage(page.machines, None, None, None)  # nothing of it is asked here
        ).routes
    }
    assert routes == {
        ('/', ('GET', 'HEAD')),
        ('/history/{machine:path}', ('GET', 'HEAD')),
        ('/bags/', ('GET', 'HEAD')),
        ('/bags/{name}', ('GET', 'HEAD')),
        ('/bags/{name}/report', ('GET', 'HEAD')),
        ('/act/{machine:path}/{action}', ('POST',)),
        ('/live', ()),
        ('/static/vendor', ()),
        ('/static', ()),
    }
    assert app.ACTIONS == ('reference', 'activate', 'deactivate', 'probe', 'forget', 'record')
    for action in (
        'jog',
        'move',
        'set',
        'set_parameters',
        'configure',
        'limit',
        '',
        '..',
        'x' * 99,
    ):
        assert page.request('POST', f'/act/mill/{action}', b'{}')[0] in (404, 405), action
    for method in ('PUT', 'DELETE', 'PATCH', 'TRACE', 'OPTIONS', 'CONNECT', 'GET'):
        assert page.request(method, '/act/mill/deactivate')[0] in (400, 404, 405), method
    for path in ('/', '/bags/', '/history/mill', '/live'):
        assert page.request('POST', path, b'{}')[0] in (404, 405), path
    assert page.machines.done == []


def test_every_answer_tells_browsers_what_they_may_do(page):
    for method, path in (
        ('GET', '/bags/'),
        ('GET', '/nothing'),
        ('POST', '/act/mill/jog'),
        ('GET', '/history/mill?series=x'),
        ('GET', '/static/vendor/uplot/uPlot.iife.min.js'),
    ):
        _, headers, _ = page.request(method, path, b'{}' if method == 'POST' else None)
        policy = headers['content-security-policy']
        assert "default-src 'self'" in policy
        assert "frame-ancestors 'none'" in policy
        assert 'unsafe' not in policy
        assert '*' not in policy
        assert headers['x-content-type-options'] == 'nosniff'
        assert headers['referrer-policy'] == 'no-referrer'
        assert 'server' not in headers
        assert 'access-control-allow-origin' not in headers


@pytest.mark.parametrize(
    'path',
    [
        '/static/../app.py',
        '/static/%2e%2e/app.py',
        '/static/..%2fapp.py',
        '/static/vendor/../../app.py',
        '/static//etc/passwd',
        '/static/%00',
        '/bags/..',
        '/bags/%2e%2e',
        '/bags/..%2f..%2fsecret',
        '/bags/../secret/report',
        '/bags/secret.txt',
        '/bags/link',
        '/bags/%2fetc/report',
        '//etc/passwd',
        '/static/\\..\\app.py',
    ],
)
def test_no_path_leads_out_of_the_folders(serve, tmp_path, path):
    (tmp_path / 'secret').mkdir()
    (tmp_path / 'secret' / 'a.mcap').write_text('secret')
    bags = tmp_path / 'bags'
    bags.mkdir()
    (bags / 'secret.txt').write_text('secret')
    (bags / 'link').symlink_to(tmp_path / 'secret')
    status, _, body = serve(bags=bags).request('GET', path)
    assert status in (400, 403, 404), (status, body[:100])
    assert b'secret' not in body
    assert b'Copyright' not in body
    assert b'root:' not in body


def test_a_script_for_a_name_stays_a_name(page):
    name = '<script>alert(1)</script>'
    with connect(f'ws://{page.host}/live') as client:
        client.recv(timeout=30)
        page.server.show('mill', {'sensors': {'values': {name: 1.0}}})
        assert json.loads(client.recv(timeout=30))['view']['sensors']['values'] == {name: 1.0}
    status, headers, body = page.request('GET', '/history/%3Cscript%3Ealert(1)%3C%2Fscript%3E')
    assert status == 404
    assert headers['content-type'] == 'application/json'
    status, _, body = page.request('GET', '/history/x%1b%5B2J%0dSet-Cookie:%20a=b')
    assert status == 404
    assert b'\x1b' not in body
    assert b'\\x1b' in body


@pytest.mark.parametrize(
    'body',
    [
        b'[]',
        b'"x"',
        b'{',
        b'\xff\xfe',
        b'{"a": ' * 500,
        b'[' * 4000,
        b'{"by": "' + b'x' * 5000 + b'"}',
        b'x' * 1_000_000,
        b'{"by": "\\ud800"}',
        b'{"\\udfff": 1}',
        b'{"values": [{"x": "\\udc80"}]}',
        b'{"by": "anna", "x": [NaN]}',
        b'{"x": 1e999}',
    ],
)
def test_a_body_that_is_no_small_object_is_refused(page, body):
    try:
        status, _, answer = page.request('POST', '/act/mill/deactivate', body)
        assert status == 400
        assert not json.loads(answer)['done']
    except (ConnectionError, TimeoutError):
        assert len(body) > app.BODY_MAX  # it did not hear it out
    assert page.machines.done == []


def test_a_form_of_another_page_is_no_request(page):
    for kind in ('text/plain', 'application/x-www-form-urlencoded', 'multipart/form-data', None):
        status, _, _ = page.request('POST', '/act/mill/deactivate', b'{}', {'Content-Type': kind})
        assert status == 415, kind
    assert page.machines.done == []


def test_a_page_that_says_too_much_is_closed(page):
    for frame in ('x' * 1_000_000, b'x' * 2000):
        with connect(f'ws://{page.host}/live', max_size=None) as client:
            client.recv(timeout=30)
            with suppress(ConnectionClosed):
                client.send(frame)
            with pytest.raises(ConnectionClosed):
                client.recv(timeout=30)
    with connect(f'ws://{page.host}/live') as client:
        client.send('hello')
        page.server.show('mill', {})
        assert client.recv(timeout=30)


def test_a_slow_speaker_is_closed(page, monkeypatch):
    monkeypatch.setattr(connections, 'HEADERS_WITHIN', 0.3)
    monkeypatch.setattr(connections, 'STALLED', 0.6)
    starts = (
        b'',
        b'G',
        b'GET / HTTP/1.1\r\nHost: ',
        b'POST /act/mill/deactivate HTTP/1.1\r\nHost: ' + page.host.encode() + b'\r\n'
        b'Content-Type: application/json\r\nContent-Length: 10\r\n\r\n{',
    )
    with ExitStack() as stack:
        slow = [stack.enter_context(page.open(start)) for start in starts]
        for connection in slow:
            connection.settimeout(60.0)
            with _ending(connection):
                while connection.recv(1000):
                    pass
    assert page.machines.done == []
    monkeypatch.undo()  # a busy computer is a slow speaker too
    assert page.request('GET', '/bags/')[0] == 200


@contextmanager
def _ending(connection):
    try:
        yield
    except ConnectionResetError:
        return


def test_one_who_sends_a_letter_at_a_time_is_closed(page, monkeypatch):
    monkeypatch.setattr(connections, 'HEADERS_WITHIN', 0.3)
    with page.open(b'GET / HTTP/1.1\r\n') as connection:
        connection.settimeout(0.05)
        deadline = time.monotonic() + 60.0
        closed = False
        while not closed and time.monotonic() < deadline:
            try:
                connection.sendall(b'X')
                closed = connection.recv(1) == b''
            except TimeoutError:
                continue
            except OSError:
                closed = True
        assert closed


def crowd(page, size):
    """Open so many connections that say nothing, and see that the page is served all the same."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = size + 5000  # both ends are in this process; the server's are closed at once
    if hard != resource.RLIM_INFINITY and hard < wanted:
        pytest.skip(f'expected {wanted} open files to be allowed but found {hard}: ulimit -n')
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted), hard))
    try:
        with connect(f'ws://{page.host}/live') as client, ExitStack() as stack:
            client.recv(timeout=30)
            for _ in range(size):
                opened = socket.socket()
                stack.callback(opened.close)
                opened.settimeout(60.0)
                with _ending(opened):
                    opened.connect(page.address)
            # Who was there goes on, whatever the crowd does.
            page.server.show('mill', {'sequence': 1})
            assert json.loads(client.recv(timeout=60))['view'] == {'sequence': 1}
            wait_for(
                lambda: connections.WatchedConnection.open <= connections.SOCKETS_MAX,
                'only so many are open',
            )
        wait_for(lambda: _served(page), 'it serves again')
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def _served(page):
    try:
        return page.request('GET', '/bags/')[0] == 200
    except OSError:
        return False


def test_two_thousand_sockets_do_no_harm(page):
    crowd(page, 2000)


@pytest.mark.slow
def test_ten_thousand_sockets_do_no_harm(page):
    crowd(page, 10_000)


def test_a_page_that_takes_nothing_is_dropped_and_the_others_go_on(page, monkeypatch):
    monkeypatch.setattr(app, 'SEND_WITHIN', 0.5)
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.connect(page.address)
    deaf.sendall(page.socket())
    with deaf, connect(f'ws://{page.host}/live', max_size=None) as client:
        wait_for(lambda: page.server.clients == 2, 'both are there')
        sequence = 0
        deadline = time.monotonic() + 60.0
        while page.server.clients == 2 and time.monotonic() < deadline:
            sequence += 1
            page.server.show('mill', {'sequence': sequence, 'filling': 'x' * 200_000})
            got = 0
            while got < sequence:
                frame = json.loads(client.recv(timeout=60))
                got = frame.get('view', {}).get('sequence', 0)
        assert page.server.clients == 1


def test_only_so_many_pages_are_open(page, monkeypatch):
    monkeypatch.setattr(app, 'PAGES_MAX', 3)
    with ExitStack() as stack:
        for _ in range(3):
            client = stack.enter_context(connect(f'ws://{page.host}/live'))
            client.recv(timeout=30)
        with page.open(page.socket()) as connection:
            assert connection.recv(100).split()[1] == b'403'
    wait_for(lambda: page.server.clients == 0, 'all have gone')
    with connect(f'ws://{page.host}/live') as client:
        assert client.recv(timeout=30)


def test_nonsense_is_answered_or_closed(page):
    for start in (
        b'\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03',
        b'GET / HTTP/9.9\r\n\r\n',
        b'\x00' * 100,
        b'GET ' + b'/a' * 20_000 + b' HTTP/1.1\r\n\r\n',
        b'GET / HTTP/1.1\r\nHost: ' + b'x' * 40_000 + b'\r\n\r\n',
        b'GET / HTTP/1.1\r\n' + b'a: b\r\n' * 10_000 + b'\r\n',
        os.urandom(500),
    ):
        with page.open() as connection, _ending(connection):
            connection.sendall(start)
            connection.shutdown(socket.SHUT_WR)
            while connection.recv(1000):
                pass
    assert page.request('GET', '/bags/')[0] == 200


ACT = (
    b'POST /act/mill/deactivate HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n'
)
CHUNKS = b'\r\n2\r\n{}\r\n0\r\n\r\n'
SMUGGLED = {
    'a length beside chunks': b'Content-Length: 2\r\nTransfer-Encoding: chunked\r\n' + CHUNKS,
    'chunks beside a length': b'transfer-encoding: chunked\r\ncontent-length: 2\r\n' + CHUNKS,
    'two lengths': b'Content-Length: 2\r\nContent-Length: 2\r\n\r\n{}',
    'two other lengths': b'Content-Length: 2\r\nContent-Length: 40\r\n\r\n{}',
    'a list of lengths': b'Content-Length: 2, 2\r\n\r\n{}',
    'a body of another protocol': b'Upgrade: websocket\r\nContent-Length: 2\r\n\r\n{}',
    'two encodings': b'Transfer-Encoding: chunked\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n',
    'a folded line': b'X: a\r\n b\r\nContent-Length: 2\r\n\r\n{}',
    'a bare line feed': b'X: a\nContent-Length: 2\r\n\r\n{}',
    'line feeds alone': b'Content-Length: 2\n\n{}',
    'a bare carriage return': b'X: a\rb\r\nContent-Length: 2\r\n\r\n{}',
    'a space before the colon': b'Content-Length : 2\r\n\r\n{}',
    'a length with a sign': b'Content-Length: +2\r\n\r\n{}',
    'another encoding': b'Transfer-Encoding: gzip, chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n',
}


@pytest.mark.parametrize('before', [b'', b'GET /bags/ HTTP/1.1\r\nHost: localhost\r\n\r\n'])
@pytest.mark.parametrize('rest', SMUGGLED.values(), ids=SMUGGLED)
def test_a_head_that_can_be_read_in_two_ways_is_refused(page, rest, before):
    """Also behind another request on the same connection."""
    answer = b''
    with page.open() as connection:
        connection.sendall(before + ACT + rest)
        while part := connection.recv(10_000):
            answer += part
    statuses = re.findall(rb'HTTP/1\.1 (\d+)', answer)
    assert statuses == [b'200'] * bool(before) + [statuses[-1]]
    assert statuses[-1] in (b'400', b'501')
    assert page.machines.done == []


@pytest.mark.parametrize(
    'start',
    [
        b'GET /live HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n'
        b'Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n'
        b'Content-Length: 5\r\n\r\nabcde',
        ACT.replace(b'HTTP/1.1', b'HTTP/1.0') + b'Transfer-Encoding: chunked\r\n' + CHUNKS,
    ],
    ids=['a WebSocket with a body', 'chunks before they existed'],
)
def test_a_body_that_cannot_be_there_is_refused(page, start):
    with page.open() as connection:
        connection.sendall(start)
        assert connection.recv(100).startswith(b'HTTP/1.1 400')
    assert page.machines.done == []


def test_a_head_in_pieces_is_read(page):
    with page.open() as connection:
        for byte in ACT + b'Content-Length: 2\r\nConnection: close\r\n\r\n{}':
            connection.sendall(bytes([byte]))
        assert connection.recv(100).startswith(b'HTTP/1.1 200')

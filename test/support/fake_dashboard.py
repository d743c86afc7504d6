# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A server that shows the live page whatever state a test wants, without a graph behind it.

It says what the node `dashboard` says, in the same form.  By hand, with a machine whose state
changes every few seconds: `python test/support/fake_dashboard.py 8000`.
"""

import asyncio
import contextlib
import copy
import math
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    JSONResponse,
    PlainTextResponse,
    Response,
)
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

WEB = Path(__file__).parents[2] / 'fuzzycnc_ros' / 'web'
STAMP = 1.7e9
"""Machine time of the first view [s]."""
DAY = 86400.0
BAGS = [
    {'name': 'run_1', 'bytes': 12_345_678, 'begin': STAMP - 7200.0, 'duration': 5400.0,
     'complete': True},
    {'name': 'a run/<b>&', 'bytes': 900, 'begin': STAMP - 60.0, 'duration': 12.0,
     'complete': False},
]  # fmt: skip
HEADERS = {'Content-Security-Policy': "default-src 'self'"}


def axis(name: str, **changes: Any) -> dict[str, Any]:
    """Return an axis of a view."""
    return {
        'axis': name,
        'offset': -1.2e-6,
        'requested': -1.3e-6,
        'slope': 2.5e-6,
        'reference_position': 0.1,
        'limit': 5e-5,
        'share': 0.024,
        'rate': -2e-9,
        'arrow': 'down',
        'predicted': 1.3e-6,
        'band': 2e-6,
        'limited': [],
        'probe': None,
        'stable_in': 1200.0,
        'along': None,
        **changes,
    }


def view(machine: str = 'mill', **changes: Any) -> dict[str, Any]:
    """Return a view of a machine that is well, but for what is changed."""
    names = [f't{number:02d}' for number in range(12)]
    document = {
        'machine': machine,
        'sequence': 1,
        'stamp': STAMP,
        'age': 0.4,
        'simulated': True,
        'silent': '',
        'state': {
            'compensation': 'active',
            'why': 'offsets follow the predicted error',
            'machine': 'running',
            'offsets_allowed': True,
        },
        'axes': [
            axis('Y', probe={'measured': 1.6e-6, 'predicted': 1.4e-6, 'age': 340.0}),
            axis('Z', offset=23.46e-6, requested=24e-6, share=0.4692, rate=1.4e-8, arrow='up',
                 predicted=-24e-6, band=3.1e-6, stable_in=4500.0),
        ],
        'spindle': 104.72,
        'sensors': {
            'ok': len(names),
            'substituted': [],
            'missing': [],
            'values': {name: 21.0 + 0.7 * at for at, name in enumerate(names)},
            'clusters': [
                {'chosen': 't01', 'members': names[:4]},
                {'chosen': 't05', 'members': names[4:9]},
            ],
        },
        'model': {
            'name': 'linear_dynamic 3f9a1c2b7d10',
            'valid': True,
            'why': '',
            'file': 'mill.json',
            'hash': '3f9a1c2b7d10',
            'runs': ['monday', 'tuesday'],
            'in_domain': True,
            'distance': 0.4,
            'held_out': {'Y': 1.6e-6, 'Z': 2.25e-6},
            'shadow': None,
        },
        'nodes': [
            {'name': 'compensator', 'lifecycle': 'active', 'level': 'ok', 'rate': 1.0,
             'latency': 0.002, 'trouble': []},
            {'name': 'thermal_predictor', 'lifecycle': 'running', 'level': 'ok', 'rate': 1.0,
             'latency': 0.0041, 'trouble': []},
        ],
        'alarms': [],
        'recording': None,
        'feeds': None,
        'servo': None,
        'soft': None,
        'probing': None,
    }  # fmt: skip
    return {**document, **changes}


def alarm(level: str = 'error', **changes: Any) -> dict[str, Any]:
    """Return an alarm of a view."""
    return {
        'level': level,
        'node': 'thermal_predictor',
        'name': 'ended',
        'cause': 'thermal_predictor has ended',
        'remedy': 'start it again; its log says why it ended',
        'since': STAMP - 5.0,
        **changes,
    }


def busy_view(machine: str = 'mill', **changes: Any) -> dict[str, Any]:
    """Return a view in which much is to be said."""
    document = view(machine)
    document['sensors'] |= {
        'ok': 10,
        'substituted': [{'name': 't02', 'by': 't03'}],
        'missing': [{'name': 't09', 'why': 'no reading'}],
    }
    document['axes'][1] |= {
        'offset': 5e-5, 'requested': 5e-5, 'share': 1.0, 'limited': ['clamp', 'slew'],
        'predicted': -6.1e-5,
    }  # fmt: skip
    document['alarms'] = [
        alarm('error', node='compensator', name='limit',
              cause='the offset of Z is cut at 50.0 µm: 61.0 µm are wanted',
              remedy='raise offset_max if the machine may be moved that far'),
        alarm('warn', node='temperature_acquisition', name='sensors',
              cause='t09 gives no reading, for 35 s', remedy='look at its plug'),
    ]  # fmt: skip
    document['recording'] = {'active': True, 'bag': 'run_2'}
    document['model']['shadow'] = {
        'name': 'hybrid_network 77aa10bc9d01', 'difference': {'Y': 4e-7, 'Z': -1.1e-6}
    }  # fmt: skip
    document['feeds'] = {
        'path': 'butterfly', 'status': 'following', 'reason': '', 'arc_length': 0.1234,
        'feed': 0.05, 'override': 0.8, 'method': 'log_fuzzy', 'tolerance': 2e-5,
    }  # fmt: skip
    document['servo'] = {
        'status': 'following', 'reason': '', 'missed': 2,
        'axes': [
            {'axis': 'X', 'position': 0.123456, 'velocity': 0.01, 'error': 1.5e-6,
             'saturated': False},
            {'axis': 'Y', 'position': -0.02, 'velocity': -0.002, 'error': -2.25e-6,
             'saturated': True},
        ],
    }  # fmt: skip
    document['soft'] = {
        'path': 'leaf', 'material': 'foam', 'model': '77aa10bc9d0177aa', 'thickness': 0.03,
        'stitches': 412, 'offset_max': 1.8e-3, 'flagged': 7,
    }  # fmt: skip
    document['nodes'][1] |= {'level': 'warn', 'trouble': ['input: temperatures late']}
    return {**document, **changes}


def rows(series: str, begin: float, end: float, points: int, newest: float) -> dict[str, Any]:
    """Return a made-up past: a day that warms up, sampled every 10 s at the finest."""
    begin, end = max(begin, newest - DAY), min(end, newest)
    step = max(10.0, (end - begin) / points)
    count = max(0, int((end - begin) / step) + 1)
    moments = [begin + step * at for at in range(count)]
    hours = [(moment - STAMP) / 3600.0 for moment in moments]

    def column(values: list[float | None], width: float = 0.0) -> dict[str, list[float | None]]:
        shift = {'min': -width, 'mean': 0.0, 'max': width}
        return {
            kind: [None if value is None else value + by for value in values]
            for kind, by in shift.items()
        }

    columns, flags = {}, {}
    if series == 'temperatures':
        for at in range(12):
            values = [21 + 0.7 * at + math.sin(0.9 * hour + at / 5) for hour in hours]
            columns[f't{at:02d}'] = column(values)
        flags['t02'] = [int(moment > newest - 900.0) for moment in moments]
    for name, size in (('Y', 1.3e-6), ('Z', -24e-6)):
        wave = [size * (1 + 0.3 * math.sin(2 * hour)) for hour in hours]
        if series == 'compensation':
            columns[f'{name} requested'] = column([-value for value in wave])
            columns[f'{name} applied'] = column([-0.97 * value for value in wave], 4e-7)
            columns[f'{name} limit'] = column([5e-5] * count)
        if series == 'error':
            probed = [value + 4e-7 if at % 60 == 30 else None for at, value in enumerate(wave)]
            columns[f'{name} predicted'] = column(wave)
            columns[f'{name} band'] = column([2e-6] * count)
            columns[f'{name} probed'] = column(probed)
            columns[f'{name} residual'] = column([None if v is None else 4e-7 for v in probed])
        if series == 'axes':
            columns[f'{name} position'] = column([0.1 * math.sin(9 * hour) for hour in hours])
            columns[f'{name} following'] = column(wave)
    return {'time': moments, 'columns': columns, 'flags': flags}


class FakeDashboard:
    """What a browser sees as the node `dashboard`.

    Attributes
    ----------
    url : str
        Where the page is.
    answers : dict
        Status and body of the next answers to each action, in order.
    acted : list
        Actions that were asked for: machine, action, body, Authorization header.
    past : callable
        What answers when history is asked for.
    asked : list
        Stretches of history that were asked for: machine, series, begin, end.
    """

    def __init__(self, port: int = 0) -> None:
        self.reset()
        routes = [
            Route('/', self._page),
            Route('/static/{name:path}', self._static),
            Route('/history/{machine}', self._history),
            Route('/bags/', self._bags),
            Route('/bags/{name:path}/report', self._report),
            Route('/bags/{name:path}', self._bag),
            Route('/act/{machine}/{action}', self._act, methods=['POST']),
            WebSocketRoute('/live', self._live),
        ]
        config = uvicorn.Config(
            Starlette(routes=routes),
            port=port,
            log_level='warning',
            lifespan='off',
            ws='websockets-sansio',
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run)

    def start(self) -> None:
        """Serve until `stop`."""
        self._thread.start()
        while not self._server.started:
            assert self._thread.is_alive(), 'the server did not start'
            time.sleep(0.01)
        port = self._server.servers[0].sockets[0].getsockname()[1]
        self.url = f'http://127.0.0.1:{port}/'

    def stop(self) -> None:
        """End the server."""
        self.refusing = True
        self._server.should_exit = True
        self._thread.join()

    def reset(self) -> None:
        """Be a machine that is well."""
        self.views: dict[str, dict[str, Any]] = {'mill': view()}
        self.writable, self.needs_token, self.interval = True, False, 0.25
        self.recordable = True
        self.mute = self.refusing = False
        self.past = rows
        self.answers: dict[str, list[tuple[int, dict[str, Any]]]] = {}
        self.acted: list[tuple[str, str, dict[str, Any], str]] = []
        self.asked: list[tuple[str, str, float, float]] = []

    def show(self, *documents: dict[str, Any]) -> None:
        """Show these machines and no others."""
        self.views = {document['machine']: document for document in documents}

    # What browsers ask for; all of it runs in the thread of the server.

    async def _page(self, request: Request) -> Response:
        return HTMLResponse((WEB / 'static' / 'index.html').read_text(), headers=HEADERS)

    async def _static(self, request: Request) -> Response:
        name = request.path_params['name']
        path = WEB / name if name.startswith('vendor/') else WEB / 'static' / name
        if path.is_file():
            return FileResponse(path, headers=HEADERS)
        return _refused(404, f'no file {name}')

    async def _history(self, request: Request) -> Response:
        asked, machine = request.query_params, request.path_params['machine']
        begin, end = float(asked['begin']), float(asked['end'])
        self.asked.append((machine, asked['series'], begin, end))
        if machine not in self.views:
            return _refused(404, f'no machine {machine}')
        newest = self.views[machine]['stamp']
        found = self.past(asked['series'], begin, end, int(asked['points']), newest)
        return JSONResponse({'machine': machine, 'series': asked['series'], **found})

    async def _bags(self, request: Request) -> Response:
        return JSONResponse(BAGS)

    async def _bag(self, request: Request) -> Response:
        return PlainTextResponse('the bytes of a bag')

    async def _report(self, request: Request) -> Response:
        if request.path_params['name'] == 'run_1':
            return HTMLResponse('<!DOCTYPE html><title>Report of run_1</title>', headers=HEADERS)
        return _refused(404, 'no report of that bag; write one')

    async def _act(self, request: Request) -> Response:
        path, body = request.path_params, await request.json()
        action = path['action']
        token = request.headers.get('authorization', '')
        self.acted.append((path['machine'], action, body, token))
        status, answer = 200, {'done': True, 'says': f'{action} is done'}
        if self.answers.get(action):
            status, answer = self.answers[action].pop(0)
        return JSONResponse(answer, status)

    async def _live(self, socket: WebSocket) -> None:
        if self.refusing:
            await socket.close()
            return
        await socket.accept()
        told = None
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while not self.refusing:
                hello = {
                    'type': 'hello',
                    'version': '0.1.0',
                    'machines': list(self.views),
                    'writable': self.writable,
                    'needs_token': self.needs_token,
                    'recordable': self.recordable,
                    'interval': self.interval,
                }
                if not self.mute:
                    if hello != told:
                        await socket.send_json(hello)
                        told = hello
                    for machine, document in copy.copy(self.views).items():
                        document['sequence'] += 1
                        frame = {'type': 'view', 'machine': machine, 'view': document}
                        await socket.send_json(frame)
                await asyncio.sleep(self.interval)
            await socket.close()


def _refused(status: int, says: str) -> Response:
    return JSONResponse({'done': False, 'says': says}, status)


@contextmanager
def serving(port: int = 0) -> Iterator[FakeDashboard]:
    """Yield a server that runs; it ends in the end."""
    fake = FakeDashboard(port)
    fake.start()
    try:
        yield fake
    finally:
        fake.stop()


def main() -> None:
    """Show a machine whose state changes, until Ctrl-C."""
    states = [
        view(),
        busy_view(),
        view(state={'compensation': 'holding', 'why': 'the error is 200 s old', 'machine': 'homed',
                    'offsets_allowed': True}, alarms=[alarm()]),
        view(silent='no data for 12 s: temperature_acquisition has ended: start it again'),
    ]  # fmt: skip
    with serving(int(sys.argv[1])) as fake, contextlib.suppress(KeyboardInterrupt):
        print(fake.url)
        began = time.time()
        while True:
            passed = time.time() - began
            state = states[int(passed / 15) % len(states)] | {'stamp': STAMP + passed}
            fake.show(state, view('lathe', stamp=STAMP + passed))
            time.sleep(0.5)


if __name__ == '__main__':
    main()

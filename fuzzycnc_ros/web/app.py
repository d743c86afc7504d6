# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The live page over HTTP and WebSocket: what there is to ask for, and how it is answered.

Reading is free to whoever is let in; acting goes through one route, to the actions that are listed
here and to no others.
"""

import asyncio
import json
from collections.abc import Awaitable, Callable, Collection, Mapping
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Protocol

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from fuzzycnc_ros.components.dashboard.history import POINTS_MAX, SERIES
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.web.guard import Guard, Token, refused
from fuzzycnc_ros.web.live import Frames

STATIC = Path(__file__).with_name('static')
VENDOR = Path(__file__).with_name('vendor')
ACTIONS = ('reference', 'activate', 'deactivate', 'probe', 'forget', 'record')
"""All that can be done from the page: none of them moves an axis or raises a limit."""
BODY_MAX = 4096
"""Largest body of a request [bytes]."""
BODY_WITHIN = 5.0
"""Time [s] within which a body must have come."""
SEND_WITHIN = 10.0
"""Time [s] within which a page must take a frame."""
PAGES_MAX = 128
"""Pages that are open at once."""
TRY_LATER = 1013
"""Close code of a WebSocket for which there is no room."""
DEFAULT_POINTS = 600


class ActionRefusedError(Exception):
    """An action was not carried out; the text says why and what to do.

    Parameters
    ----------
    says : str
        Cause and remedy.
    more : mapping
        What else the answer holds.
    """

    def __init__(self, says: str, **more: Any) -> None:
        super().__init__(says)
        self.more = more


class Machines(Protocol):
    """Machines that the page shows and acts at."""

    @property
    def machines(self) -> Collection[str]:
        """Names of all machines."""

    def history(
        self, machine: str, series: str, begin: float, end: float, points: int
    ) -> dict[str, Any]:
        """Return a stretch of a series; called in a thread of its own."""

    async def act(self, machine: str, action: str, body: Mapping[str, Any]) -> str:
        """Carry an action out; return what was done.

        Raises
        ------
        ActionRefusedError
            If it is not.
        """


class Recordings(Protocol):
    """The bags that can be taken from the page."""

    def listed(self) -> list[dict[str, Any]]:
        """Return name, size, time, duration and completeness of each."""

    def archive(self, name: str) -> tuple[str, Any] | None:
        """Return the name and the bytes of an archive of a bag, None if there is no such bag."""

    def report(self, name: str) -> Path | None:
        """Return the page with the report of a bag, None if there is none."""


@dataclass(frozen=True)
class LivePage:
    """All that the page is made of.

    Attributes
    ----------
    machines : Machines
        What is shown.
    frames : Frames
        Newest frames for the pages that are open.
    recordings : Recordings
        Bags.
    token : Token
        Who may act.
    address : str
        Where it is served.
    hosts : collection of str
        Further names of this computer.
    """

    machines: Machines
    frames: Frames
    recordings: Recordings
    token: Token
    address: str = '127.0.0.1'
    hosts: Collection[str] = ()


def page_app(page: LivePage) -> Starlette:
    """Return the application that serves a page."""

    def at(
        path: str, answer: Callable[[LivePage, Request], Awaitable[Response]], method: str = 'GET'
    ) -> Route:
        async def endpoint(request: Request) -> Response:
            return await answer(page, request)

        return Route(path, endpoint, methods=[method])

    async def live(socket: WebSocket) -> None:
        await _live(page, socket)

    return Starlette(
        routes=[
            at('/', _front),
            at('/history/{machine:path}', _history),
            at('/bags/', _bags),
            at('/bags/{name}', _bag),
            at('/bags/{name}/report', _report),
            at('/act/{machine:path}/{action}', _act, 'POST'),
            WebSocketRoute('/live', live),
            Mount('/static/vendor', StaticFiles(directory=VENDOR)),
            Mount('/static', StaticFiles(directory=STATIC, check_dir=False)),
        ],
        middleware=[Middleware(Guard, address=page.address, hosts=page.hosts)],
    )


async def _front(page: LivePage, request: Request) -> Response:
    return FileResponse(STATIC / 'index.html', headers={'Cache-Control': 'no-cache'})


async def _history(page: LivePage, request: Request) -> Response:
    machine, query = request.path_params['machine'], request.query_params
    if machine not in page.machines.machines:
        return _no_machine(page, machine)
    series = query.get('series', 'error')
    if series not in SERIES:
        return refused(
            400, f'series: expected one of {", ".join(SERIES)} but found {visible(series[:40])!r}'
        )
    try:
        begin = _bounded(query.get('begin', '0'))
        end = _bounded(query.get('end', '1e12'))
        points = int(query.get('points', DEFAULT_POINTS))
    except ValueError:
        return refused(400, 'begin, end, points: expected seconds, seconds and a whole number')
    points = max(1, min(points, POINTS_MAX))

    def text() -> bytes:
        document = page.machines.history(machine, series, begin, end, points)
        return json.dumps(document, allow_nan=False).encode()

    try:
        return Response(await run_in_threadpool(text), media_type='application/json')
    except FutureTimeoutError:
        return refused(503, 'dashboard does not get to it; it is busy, or hangs')


def _bounded(text: str) -> float:
    value = float(text)
    if not isfinite(value):
        raise ValueError(text)
    return value


async def _bags(page: LivePage, request: Request) -> Response:
    return JSONResponse(await run_in_threadpool(page.recordings.listed))


async def _bag(page: LivePage, request: Request) -> Response:
    found = await run_in_threadpool(page.recordings.archive, request.path_params['name'])
    if found is None:
        return _no_bag()
    name, chunks = found
    attachment = {'Content-Disposition': f'attachment; filename="{name}"'}
    return StreamingResponse(chunks, media_type='application/x-tar', headers=attachment)


async def _report(page: LivePage, request: Request) -> Response:
    found = await run_in_threadpool(page.recordings.report, request.path_params['name'])
    if found is None:
        return refused(404, 'no report of that bag; write one with fuzzycnc evaluate --report')
    # It comes from a file: it may show its own plots, and neither run scripts nor ask for more.
    strict = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox; "
    strict += "frame-ancestors 'none'"
    response = FileResponse(found, media_type='text/html')
    response.headers['Content-Security-Policy'] = strict
    return response


async def _act(page: LivePage, request: Request) -> Response:
    machine, action = request.path_params['machine'], request.path_params['action']
    if not page.token.shown(request.headers):
        return refused(
            401, 'acting needs the token that dashboard printed at its first start', needs='token'
        )
    if machine not in page.machines.machines:
        return _no_machine(page, machine)
    if action not in ACTIONS:
        return refused(404, f'expected one of {", ".join(ACTIONS)}')
    if request.headers.get('content-type', '').partition(';')[0].strip() != 'application/json':
        return refused(415, 'Content-Type: expected application/json')
    try:
        body = await asyncio.wait_for(_body(request), BODY_WITHIN)
    except (ValueError, TimeoutError, RecursionError) as error:
        return refused(400, f'body: expected one small JSON object; {visible(str(error))[:200]}')
    try:
        says = await page.machines.act(machine, action, body)
    except ActionRefusedError as error:
        return refused(409, visible(str(error)), **error.more)
    return JSONResponse({'done': True, 'says': visible(says)})


async def _body(request: Request) -> dict[str, Any]:
    text = b''
    async for chunk in request.stream():
        text += chunk
        if len(text) > BODY_MAX:
            raise ValueError(f'at most {BODY_MAX} bytes')
    found = json.loads(text or b'{}')
    if not isinstance(found, dict):
        raise ValueError('found another value')
    # A lone surrogate is no text, and a record holds no number that JSON does not have.
    json.dumps(found, ensure_ascii=False, allow_nan=False).encode()
    return found


async def _live(page: LivePage, socket: WebSocket) -> None:
    """Send a page what is new until it closes, says too much, or takes too long."""
    frames = page.frames
    if frames.clients >= PAGES_MAX:
        await socket.close(TRY_LATER)
        return
    await socket.accept()
    frames.clients += 1
    listening = asyncio.create_task(_listen(socket))
    try:
        number = -1
        while not listening.done():
            fresh = frames.fresh  # what comes from here on sets it
            number, newer = frames.since(number)
            for frame in newer:
                await asyncio.wait_for(socket.send_text(frame), SEND_WITHIN)
            waiting = asyncio.create_task(fresh.wait())
            await asyncio.wait({waiting, listening}, return_when=asyncio.FIRST_COMPLETED)
            waiting.cancel()
    except (TimeoutError, WebSocketDisconnect, RuntimeError):
        return  # it is gone, or as good as gone
    finally:
        frames.leave()
        listening.cancel()


async def _listen(socket: WebSocket) -> None:
    """Wait for a page to close; what it says is of no interest."""
    try:
        while (await socket.receive())['type'] != 'websocket.disconnect':
            pass
    except (WebSocketDisconnect, RuntimeError):
        return


def _no_machine(page: LivePage, machine: str) -> Response:
    known = ', '.join(sorted(page.machines.machines)) or 'none yet'
    return refused(404, f'expected a machine of {known} but found {visible(machine[:100])!r}')


def _no_bag() -> Response:
    return refused(404, 'no bag of that name')

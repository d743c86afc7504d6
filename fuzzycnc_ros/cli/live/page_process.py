# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The live page beside a graph that a command starts: a process that nobody waits for."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.ros.bring_up import PAGE, NodeSpec, page_spec
from fuzzycnc_ros.ros.presence import GraphError

LOOPBACK = '127.0.0.1'
Page = Annotated[
    Optional[int],  # noqa: UP045 - typer 0.9 does not read the newer form
    typer.Option(
        '--page',
        metavar='[=PORT]',
        show_default=False,
        min=0,
        max=65535,
        help='Serve the live page beside the graph, for browsers of this computer.',
    ),
]
NEEDED = ('starlette', 'uvicorn', 'websockets')


@contextmanager
def page_process(
    console: Console, port: int | None, record: Path | None = None, log: Path | None = None
) -> Iterator[tuple[GraphProcesses, NodeSpec] | None]:
    """Say where the live page is; yield its process, to be started, which ends with the block.

    Parameters
    ----------
    console : Console
        Where the address is printed.
    port : int, optional
        Where to serve it, 0 for the usual port; None: not at all.
    record : Path, optional
        Bag of the run.
    log : Path, optional
        Folder for what it writes; a temporary one if left out.

    Raises
    ------
    GraphError
        If it cannot be served there.
    """
    if port is None:
        yield None
        return
    # On use: it brings numpy, which no help needs.
    from fuzzycnc_ros.runtime.host import DashboardConfig

    port = port or DashboardConfig().port
    _check(port)
    with GraphProcesses('', folder=log) as page:
        console.print(f'live page: http://{LOOPBACK}:{port}/', soft_wrap=True)
        yield page, page_spec(port, record)


@contextmanager
def page_beside(console: Console, port: int | None, record: Path, log: Path) -> Iterator[None]:
    """Serve the live page while the block runs; it is not waited for.

    Parameters and what it raises are those of `page_process`.
    """
    with page_process(console, port, record, log) as beside:
        if beside is None:
            yield
            return
        page, spec = beside
        page.start(spec)
        yield
        if page.poll().get(PAGE):
            console.print(f'the live page had ended: {page.last_words(PAGE)}', soft_wrap=True)


def _check(port: int) -> None:
    """Refuse what the page would be refused for, before the graph is started."""
    from importlib.util import find_spec

    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise GraphError(
            f'--page: the live page needs {missing[0]}, which is not installed; install it with '
            "pip install 'fuzzycnc_ros[page]'"
        )
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            raise GraphError(
                f'--page: expected a free port but found {port}, {error.strerror}; choose '
                f'another with --page=PORT'
            ) from error

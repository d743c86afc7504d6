# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The live page beside a graph that a command starts: a process that nobody waits for."""

import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer
from rich.console import Console

from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.graph.bring_up import PAGE, NodeSpec, page_spec
from fuzzycnc_ros.ros.parameter_files import sections
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.runtime.addresses import is_loopback

if TYPE_CHECKING:
    from fuzzycnc_ros.ros.node_config import DashboardConfig

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
    console: Console,
    port: int | None,
    record: Path | None = None,
    log: Path | None = None,
    params: Sequence[Path] = (),
) -> Iterator[tuple[GraphProcesses, NodeSpec] | None]:
    """Say where the live page is; yield its process, to be started, which ends with the block.

    Parameters
    ----------
    console : Console
        Where the address is printed.
    port : int, optional
        Where to serve it, 0 for that of its parameters; None: not at all.
    record : Path, optional
        Bag of the run.
    log : Path, optional
        Folder for what it writes; a temporary one if left out.
    params : sequence of Path
        Parameter files that it reads.

    Raises
    ------
    GraphError
        If it cannot be served there.
    """
    if port is None:
        yield None
        return
    # On use: it brings numpy, which no help needs.
    from fuzzycnc_ros.ros.node_config import DashboardConfig

    with GraphProcesses('', folder=log, params=params) as page:
        spec = page_spec(port or None, record, sections(params))
        config = DashboardConfig(**spec.parameters)
        if params:
            from fuzzycnc_ros.cli.live.parameter_check import page_parameters

            config = page_parameters(page.arguments(spec))
        _check(config.listen, config.port)
        for text in _greeting(config, page.log(PAGE)):
            console.print(text, soft_wrap=True)
        yield page, spec


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


def _greeting(config: 'DashboardConfig', log: Path) -> Iterator[str]:
    """Say where the page is, and what acting and recording need there."""
    from fuzzycnc_ros.ros.node_config import OWN_FOLDER

    open_to_others = not is_loopback(config.listen)
    shown = f'[{config.listen}]' if ':' in config.listen else config.listen
    scheme = 'https' if open_to_others else 'http'
    place = f'{scheme}://{shown}:{config.port}/' if config.port else f'a free port, see {log}'
    yield f'live page: {place}'
    if config.token_file or open_to_others:
        token = config.token_file or f'{config.state_directory or OWN_FOLDER}/token'
        yield f'acting there needs the token in {token}'
    if not config.bags:
        yield (
            'Start recording there needs a folder for bags: the parameter bags in the file '
            'dashboard.yaml of a folder of parameters'
        )


def _check(address: str, port: int) -> None:
    """Refuse what the page would be refused for, before the graph is started."""
    from importlib.util import find_spec

    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise GraphError(
            f'--page: the live page needs {missing[0]}, which is not installed; install it with '
            "pip install 'fuzzycnc_ros[page]'"
        )
    with socket.socket(socket.AF_INET6 if ':' in address else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address, port))
        except OSError as error:
            raise GraphError(
                f'--page: expected a free port but found {port}, {error.strerror}; choose '
                f'another with --page=PORT'
            ) from error

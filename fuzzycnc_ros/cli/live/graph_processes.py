# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Start the nodes of a graph as processes, watch them, take them down."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fuzzycnc_ros.graph.bring_up import NodeSpec, stop_timeout
from fuzzycnc_ros.ros.leftovers import TemporaryFolder, remove_leftovers
from fuzzycnc_ros.ros.presence import TAKEOVER, GraphError
from fuzzycnc_ros.ros.processes import (
    child_set_up,
    memory_limit,
    prepare_environment,
    processor_time,
)

COMPOSED = 'composed'
"""Name of a process that holds several nodes."""

STARVED = (
    'MemoryError',
    'std::bad_alloc',
    'failed to map segment',
    'Cannot allocate memory',
    'pthread_create failed',
    "can't start new thread",
)
"""Texts of Python, the loader and the middleware where a process gets no more memory."""


def parameter_file(folder: Path, namespace: str, specs: Sequence[NodeSpec]) -> Path:
    """Write the parameters of all nodes as one ROS parameter file; return its path."""
    content = {
        f'{namespace.rstrip("/")}/{spec.name}': {'ros__parameters': dict(spec.parameters)}
        for spec in specs
        if spec.parameters
    }
    path = folder / 'parameters.yaml'
    # JSON is YAML, and keeps 1.0 a floating-point number.
    path.write_text(json.dumps(content or {'/**': {'ros__parameters': {}}}), encoding='utf-8')
    return path


def ros_arguments(namespace: str, files: Sequence[Path]) -> list[str]:
    """Return the ROS arguments for a namespace and parameter files; later files win."""
    arguments = ['--ros-args', '-r', f'__ns:={namespace}']
    for file in files:
        arguments += ['--params-file', str(file)]
    return arguments


def process_name(specs: Sequence[NodeSpec]) -> str:
    """Return the name of the process that holds some nodes."""
    return specs[0].name if len(specs) == 1 else COMPOSED


def node_title(machine: str, name: str) -> str:
    """Return the name of a node or process for people; the live page belongs to no machine."""
    return f'{machine}/{name}' if machine else name


class GraphProcesses:
    """The nodes of a graph, each in a process of its own.

    Parameters
    ----------
    machine : str
        Name of the machine, the namespace of all nodes.
    folder : Path, optional
        Where parameter files and the nodes' output go; a temporary one if left out.
    params : sequence of Path
        Parameter files that every node reads first.
    environment : mapping, optional
        Environment variables on top of the present ones.
    remap : sequence of str
        Remappings of all nodes, `from:=to`.
    """

    def __init__(
        self,
        machine: str,
        *,
        folder: Path | None = None,
        params: Sequence[Path] = (),
        environment: Mapping[str, str] | None = None,
        remap: Sequence[str] = (),
    ) -> None:
        prepare_environment()
        self.machine = machine.strip('/')
        self._namespace = f'/{self.machine}'
        self._remap = [word for rule in remap for word in ('-r', rule)]
        remove_leftovers()
        self._temporary = None if folder else TemporaryFolder()
        self.folder = folder or self._temporary.path  # type: ignore[union-attr]
        self.folder.mkdir(parents=True, exist_ok=True)
        self._params = list(params)
        # Whoever starts a graph has looked who else is there, and holds the names of its nodes.
        self._environment = {**os.environ, TAKEOVER: '1', **(environment or {})}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._patience: dict[str, float] = {}  # s that each gets to end
        self._asked: set[str] = set()  # to end, by us
        self._begun: dict[str, int] = {}  # where in its output the newest life of a node begins

    def __enter__(self) -> 'GraphProcesses':
        """Return the graph."""
        return self

    def __exit__(self, *error: object) -> None:
        """Take all nodes down."""
        self.stop()
        if self._temporary is not None:
            self._temporary.remove()
        remove_leftovers()

    def arguments(self, *specs: NodeSpec) -> list[str]:
        """Write the parameters of a process; return its ROS arguments."""
        folder = self.folder / process_name(specs)
        folder.mkdir(exist_ok=True)
        own = parameter_file(folder, self._namespace, specs)
        return ros_arguments(self._namespace, [*self._params, own]) + self._remap

    def start(self, *specs: NodeSpec) -> None:
        """Start one node, or several composed in one process.

        Output goes to `<folder>/<node>.log`, or `<folder>/composed.log`; a node that is started
        again adds to it.
        """
        name = process_name(specs)
        command = [sys.executable, '-m', f'fuzzycnc_ros.nodes.{name}']
        if name == COMPOSED:
            command += [spec.name for spec in specs]
        command += self.arguments(*specs)
        self._asked.discard(name)
        self._patience[name] = stop_timeout(spec.name for spec in specs)
        with self.log(name).open('ab' if name in self._processes else 'wb') as log:
            self._begun[name] = log.tell()
            self._processes[name] = subprocess.Popen(
                command,
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=self._environment,
                # Ctrl-C reaches only this process, which then ends the nodes in order.
                start_new_session=True,
                preexec_fn=child_set_up(),
                # The folder is needed as long as they live, even if this process is killed.
                pass_fds=[] if self._temporary is None else [self._temporary.lock],
            )

    @property
    def names(self) -> list[str]:
        """Names of all processes that were ever started."""
        return list(self._processes)

    def pid(self, name: str) -> int:
        """Return the process id of a node."""
        return self._processes[name].pid

    def signal(self, name: str, number: int) -> None:
        """Send a signal to the process of a node; how it ends then counts as its own doing."""
        self._processes[name].send_signal(number)

    def worked(self, name: str) -> float:
        """Return the processor time that a process has used [s]; 0 if it has ended."""
        try:
            return processor_time(self.pid(name))
        except OSError:
            return 0.0

    def log(self, name: str) -> Path:
        """Return the file with a node's output."""
        return self.folder / f'{name}.log'

    def poll(self) -> dict[str, int]:
        """Return the exit codes of the nodes that have ended."""
        return {
            name: process.returncode
            for name, process in self._processes.items()
            if process.poll() is not None
        }

    def check(self) -> None:
        """Refuse to go on if a node ended with an error.

        Raises
        ------
        GraphError
            If one did; the text holds the last line that it wrote.
        """
        for name, code in self.poll().items():
            if code != 0:
                raise GraphError(f'{name} ended with code {code}: {self.last_words(name)}')

    def wait(self, name: str, timeout: float) -> None:
        """Wait until a node ends by itself while the others live.

        Raises
        ------
        GraphError
            If a node ends with an error, or this one is asked to end or does not end in time.
        """
        until = time.monotonic() + timeout
        while name not in self.poll():
            self.check()
            if time.monotonic() > until:
                raise GraphError(
                    f'{name} did not end within {timeout:g} s: {self.last_words(name)}'
                )
            try:
                self._processes[name].wait(0.1)
            except subprocess.TimeoutExpired:
                continue
        self.check()
        if name in self._asked:
            raise GraphError(f'{name} was asked to end before its time')

    def interrupt(self, *names: str) -> list[str]:
        """Ask nodes to end, all if none is named; return which."""
        wanted = [n for n in self._processes if not names or n in names]
        for name in wanted:
            if self._processes[name].poll() is None:
                self._asked.add(name)
                self._processes[name].terminate()
        return wanted

    def stop(self, *names: str) -> None:
        """Ask nodes to end, all if none is named; kill those that do not."""
        self.wait_ended(self.interrupt(*names))

    def wait_ended(self, names: Sequence[str]) -> None:
        """Wait for nodes that were asked to end; kill those that do not in time."""
        begun = time.monotonic()
        for name in names:
            process = self._processes[name]
            try:
                process.wait(max(0.0, begun + self._patience[name] - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def outcome(self, name: str) -> dict[str, Any]:
        """Return what a node said of its run in its last line of JSON, empty if it did not."""
        if name not in self._processes:
            return {}
        for line in reversed(self._written(name).splitlines()):
            if line.startswith('{'):
                try:
                    said = json.loads(line)
                except ValueError:
                    continue
                return said if isinstance(said, dict) else {}
        return {}

    def last_words(self, name: str) -> str:
        """Return why a node ended as it said itself: its newest error, or its last line."""
        lines = self._newest(name).strip().splitlines()
        # A recorder says at last what is in its bag.
        errors = [line for line in lines if line.startswith('error: ')]
        return self.starved(name) or (errors or lines or ['it wrote nothing'])[-1]

    def starved(self, name: str) -> str:
        """Return in words that the newest life of a node got no more memory; empty if it did."""
        told = self._newest(name)
        if not any(sign in told for sign in STARVED):
            return ''
        most = memory_limit()  # the nodes have inherited it
        limit = 'end other programs'
        if most is not None:
            limit = f'it may have {most:.0f} MB; allow more, see `ulimit -v`'
        return f'there was not enough memory; {limit}'

    def _newest(self, name: str) -> str:
        """Return what the newest life of a node has written."""
        return self._written(name, self._begun[name])

    def _written(self, name: str, begin: int = 0) -> str:
        """Return what a node has written from a place on."""
        return self.log(name).read_bytes()[begin:].decode(errors='replace')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Several nodes in one process: `python -m fuzzycnc_ros.nodes.composed NODE... --ros-args ...`."""

import sys
from collections.abc import Sequence
from importlib import import_module

from fuzzycnc_ros.graph.bring_up import TOOLS
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.processes import end
from fuzzycnc_ros.ros.run import tell_error
from fuzzycnc_ros.ros.streams import steady_streams

_MACHINE = 'simulated_machine'


def run_composed(names: Sequence[str], ros_arguments: Sequence[str]) -> int:
    """Run nodes in this process until they are interrupted or one is done; return the exit code.

    Raises
    ------
    ValueError
        If a name is no node.
    """
    # The machine last, because it starts the run.
    ordered = sorted(names, key=lambda name: name == _MACHINE)
    makers = {name: _maker(name) for name in ordered}
    unknown = [name for name, make in makers.items() if make is None]
    if unknown or not names:
        # Loaded on use: it brings all components, and with them 18 MiB, into every process.
        from fuzzycnc_ros.registry import COMPONENTS

        known = ', '.join((*COMPONENTS, *TOOLS))
        raise ValueError(f'expected nodes among {known} but found {", ".join(unknown) or "none"}')
    return run.run([make for make in makers.values() if make], ['composed', *ros_arguments])


def _maker(name: str) -> run.HostFactory | None:
    """Return what makes a node; None if there is no node of that name."""
    module = f'fuzzycnc_ros.nodes.{name}'
    if not name.isidentifier():
        return None
    try:
        make: run.HostFactory | None = getattr(import_module(module), 'make', None)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise
        return None
    return make


def main() -> None:
    """Run the nodes that the command line names."""
    steady_streams(output_matters=False)
    split = sys.argv.index('--ros-args') if '--ros-args' in sys.argv else len(sys.argv)
    try:
        code = run_composed(sys.argv[1:split], sys.argv[split:])
    except ValueError as error:
        tell_error(error)
        code = 2
    end(code)


if __name__ == '__main__':
    main()

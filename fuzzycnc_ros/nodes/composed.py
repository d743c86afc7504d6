# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Several nodes in one process: `python -m fuzzycnc_ros.nodes.composed NODE... --ros-args ...`."""

import sys
from collections.abc import Sequence
from importlib import import_module

from fuzzycnc_ros.components.registry import COMPONENTS
from fuzzycnc_ros.nodes import run

_MACHINE = 'simulated_machine'
NODES = (*(name for name in COMPONENTS if name != _MACHINE), 'recorder', 'player', _MACHINE)
"""Nodes that can be composed; the machine last, because it starts the run."""


def run_composed(names: Sequence[str], ros_arguments: Sequence[str]) -> int:
    """Run nodes in this process until they are interrupted or one is done; return the exit code.

    Raises
    ------
    ValueError
        If a name is no node.
    """
    unknown = [name for name in names if name not in NODES]
    if unknown or not names:
        raise ValueError(
            f'expected nodes among {", ".join(NODES)} but found {", ".join(unknown) or "none"}'
        )
    ordered = sorted(names, key=NODES.index)
    makers = [import_module(f'fuzzycnc_ros.nodes.{name}').make for name in ordered]
    return run.run(makers, ['composed', *ros_arguments])


def main() -> None:
    """Run the nodes that the command line names."""
    split = sys.argv.index('--ros-args') if '--ros-args' in sys.argv else len(sys.argv)
    try:
        code = run_composed(sys.argv[1:split], sys.argv[split:])
    except ValueError as error:
        print(f'error: {error}', file=sys.stderr)
        code = 2
    sys.exit(code)


if __name__ == '__main__':
    main()

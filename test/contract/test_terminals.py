# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Text reaches terminals at few places, each of which spells control characters out."""

import ast
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / 'fuzzycnc_ros'
PRINTS = {
    'cli/console.py': 'lines and tables',
    'cli/progress_lines.py': 'progress',
    'cli/application.py': 'errors',
    'adapters/linuxcnc/feed_process.py': 'lines of a process under the Python of LinuxCNC',
    'ros/run.py': 'errors of nodes',
    'nodes/dashboard.py': 'where the page is, and the token at its first start',
    'nodes/player.py': 'JSON',
    'nodes/recorder.py': 'what came of a recording',
    'nodes/simulated_body.py': 'JSON',
    'nodes/simulated_machine.py': 'JSON',
}
CONSOLES = {'Console', 'TextColumn', 'echo', 'secho'}
"""What would show text as it comes; `fuzzycnc_ros/cli/terminal.py` has what commands use."""


@cache
def called() -> list[tuple[str, str]]:
    """Return the file and the function of every call: its name, a method's behind a dot."""
    return [
        (
            path.relative_to(PACKAGE).as_posix(),
            node.func.id if isinstance(node.func, ast.Name) else f'.{node.func.attr}',
        )
        for path in PACKAGE.rglob('*.py')
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute)
    ]


def test_only_known_places_print():
    assert {path for path, name in called() if name == 'print'} == set(PRINTS)


def test_consoles_are_those_that_spell_out():
    found = [(path, name.rpartition('.')[2]) for path, name in called()]
    assert not [item for item in found if item[1] in CONSOLES]

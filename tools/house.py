#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Measure how much there is to grasp: lines of code, import closures, files on a message's way.

Usage: tools/house.py [--before OTHER_TREE]

Lines of code are those that hold a statement: no docstring, no comment, no blank line.  An import
closure is what of the package is loaded by an import, counted in a fresh interpreter.  The way of
a message is every file of which a function runs while `thermal_predictor` and `compensator` work
on one sample of `temperatures`.
"""

from __future__ import annotations

import argparse
import ast
import io
import os
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'fuzzycnc_ros'
APART = ('core', 'papers', 'simulation')
IGNORED = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}

LOADED = f"""
import importlib, sys
importlib.import_module(sys.argv[1])
print(len([name for name in sys.modules if name.split('.')[0] == '{PACKAGE}']))
"""

WAY = f"""
import importlib, sys

def find(*names):
    for name in names:
        module, _, item = name.rpartition('.')
        try:
            return getattr(importlib.import_module('{PACKAGE}.' + module), item)
        except (ImportError, AttributeError):
            continue
    raise ImportError(names)

record_calibration = find(
    'studies.shift.thermal_shift.record_calibration', 'scenario.thermal_shift.record_calibration')
Graph = find('runtime.graph.InProcessGraph', 'components.graph.InProcessGraph')
COMPONENTS = find('registry.COMPONENTS', 'components.registry.COMPONENTS')
train = find('core.thermal.fit.train_model', 'core.thermal.train_model')
model = train(record_calibration(('D0', 'T1')).runs, candidates=('lag_ridge',))
nodes = ('temperature_acquisition', 'thermal_predictor', 'compensator')
Machine = COMPONENTS['simulated_machine']
machine = Machine(Machine.CONFIG(duties=('T2',)))
served = [COMPONENTS[name]() for name in nodes]
served[1].use_model(model.to_json())
graph = Graph(machine, served)
graph.request('compensator', 'activate')
seen = set()

def note(frame, event, argument):
    name = frame.f_code.co_filename
    if event == 'call' and '/{PACKAGE}/' in name:
        seen.add(name.split('/{PACKAGE}/')[1])

for _ in range(30):
    graph.step()
published = []
for component in served[1:]:
    def traced(name, record, receive=component.receive):
        sys.setprofile(note)
        try:
            emissions = list(receive(name, record))
        finally:
            sys.setprofile(None)
        published.extend(item.output for item in emissions)
        return iter(emissions)
    component.receive = traced
for _ in range(30):
    if 'compensation' not in published:
        seen.clear()
        graph.step()
assert set(('thermal_error', 'compensation')) <= set(published), published
print(*sorted(seen))
"""


BOILERPLATE = {
    '__post_init__',
    'inputs',
    'channels',
    'history',
    'channel',
    'merge',
    'document',
    'read',
    '_check',
    '_arrays',
    '_parts',
    '_flags',
    '_by_channel',
    '_read_array',
}
"""Methods of a run-time form that compute nothing: checks, sizes, channels, documents."""


def boilerplate(path: Path) -> int:
    """Return the lines of statements in such methods of the run-time forms of a file."""
    text = path.read_text(encoding='utf-8')
    return sum(
        code_lines(ast.unparse(method))
        for form in ast.walk(ast.parse(text))
        if isinstance(form, ast.ClassDef) and form.name.endswith('Recursion')
        for method in form.body
        if isinstance(method, ast.FunctionDef) and method.name in BOILERPLATE
    )


def code_lines(text: str) -> int:
    """Return the lines of a source text that hold a statement."""
    strings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            if isinstance(node.value.value, str):
                strings |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in IGNORED:
            lines |= set(range(token.start[0], token.end[0] + 1))
    return len(lines - strings)


def imports(path: Path, tree: Path) -> Iterator[str]:
    """Yield the modules of the package that a file names in import statements."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.ImportFrom) and (node.module or '').split('.')[0] == PACKAGE:
            base = str(node.module)
            for alias in node.names:
                whole = f'{base}.{alias.name}'
                is_module = (tree / f'{whole.replace(".", "/")}.py').is_file()
                yield whole if is_module else base


def modules(tree: Path, folder: str = '') -> dict[str, Path]:
    """Return the modules of the package, or of one of its folders, by dotted name."""
    found = sorted((tree / PACKAGE / folder).rglob('*.py'))
    return {'.'.join(path.relative_to(tree).with_suffix('').parts): path for path in found}


def answer(tree: Path, script: str, *words: str) -> str:
    """Return what a script prints that runs with the package of a tree."""
    environment = {**os.environ, 'PYTHONPATH': str(tree)}
    command = [sys.executable, '-c', script, *words]
    done = subprocess.run(
        command, cwd=tree, env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    return done.stdout.strip()


def circles(tree: Path) -> int:
    """Return how many modules lie on a circle of imports made when modules are loaded."""
    graph: dict[str, set[str]] = {}
    every = modules(tree)
    for name, path in every.items():
        body = ast.parse(path.read_text(encoding='utf-8')).body
        graph[name] = {
            target
            for node in body
            if isinstance(node, ast.ImportFrom) and node.module
            for target in (
                node.module,
                *(f'{node.module}.{alias.name}' for alias in node.names),
            )
            if target in every and target != name
        }

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        ahead = [*graph[start]]
        while ahead:
            name = ahead.pop()
            if name not in seen:
                seen.add(name)
                ahead += graph[name]
        return seen

    return sum(name in reached(name) for name in every)


def component(tree: Path, name: str) -> str:
    """Return the module of a component, wherever its tree has it."""
    found = next((tree / PACKAGE / 'components').rglob(f'{name}.py'))
    return '.'.join(found.relative_to(tree).with_suffix('').parts)


def measured(tree: Path) -> dict[str, int]:
    """Return all figures of a tree."""
    lines: Counter[str] = Counter()
    for path in modules(tree).values():
        part = path.relative_to(tree / PACKAGE).parts[0].removesuffix('.py')
        lines[part if part in APART else 'outside'] += code_lines(path.read_text(encoding='utf-8'))
    importers: Counter[str] = Counter()
    for path in modules(tree).values():
        importers.update(set(imports(path, tree)))
    core = modules(tree, 'core')
    public = sum(
        isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith('_')
        for path in core.values()
        for node in ast.parse(path.read_text(encoding='utf-8')).body
    )
    host_privates = sum(
        path.read_text(encoding='utf-8').count(f'def {name}(')
        for path in (tree / PACKAGE / 'nodes').glob('*.py')
        if path.name != 'host.py' and 'ComponentNode' in path.read_text(encoding='utf-8')
        for name in ('_subscribe', '_heard', '_now', '_poll_deadline', '_on_parameters')
    )
    asserts = sum(
        isinstance(node, ast.Assert)
        and isinstance(node.test, ast.Call)
        and ast.unparse(node.test.func) == 'isinstance'
        for path in modules(tree).values()
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
    )
    return {
        'files that run from temperatures to compensation': len(answer(tree, WAY).split()),
        'modules loaded for simulated_machine': int(
            answer(tree, LOADED, f'{PACKAGE}.nodes.simulated_machine')
        ),
        'modules loaded for compensator': int(
            answer(tree, LOADED, f'{PACKAGE}.nodes.compensator')
        ),
        'modules loaded for its component alone': int(
            answer(tree, LOADED, component(tree, 'compensator'))
        ),
        'core modules loaded for ThermalModel': int(
            answer(tree, LOADED, f'{PACKAGE}.core.thermal.model')
        ),
        'modules on a circle of imports': circles(tree),
        'private methods of the host overridden in nodes': host_privates,
        'assert isinstance': asserts,
        'files of core with one importer': sum(importers[name] == 1 for name in core),
        'public definitions of core': public,
        'statements of run-time forms that compute nothing': sum(
            boilerplate(path) for path in modules(tree).values()
        ),
        'code lines of core': lines['core'],
        'code lines of papers and simulation': lines['papers'] + lines['simulation'],
        'code lines outside these': lines['outside'],
        'files': len(modules(tree)),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--before', type=Path, help='tree of another state, shown beside')
    given = parser.parse_args()
    now = measured(ROOT)
    before = measured(given.before.resolve()) if given.before else {}
    for name, value in now.items():
        print(f'{name:<52} {before.get(name, ""):>8} {value:>8}')


if __name__ == '__main__':
    main()

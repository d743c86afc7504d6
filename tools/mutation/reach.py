# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Copies of the tree in which a suite is run, and which of its tests run a mutant's line."""

import compileall
import contextlib
import json
import os
import py_compile
import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mutation.draw import PACKAGE, Mutant, find

TOOLS = Path(__file__).resolve().parents[1]
NOT_COPIED = [
    *('.git', '.venv*', '.*_cache', '.hypothesis', '__pycache__', '*.egg-info'),
    *('build', 'install', 'log'),
]
Lines = tuple[int, int] | None
"""First and last line; None for a whole file."""


@contextlib.contextmanager
def copied(tree: Path) -> Iterator[Path]:
    """Yield a copy of a tree that can be changed."""
    with tempfile.TemporaryDirectory(prefix='mutants-') as folder:
        copy = Path(folder).resolve() / tree.name
        shutil.copytree(tree, copy, ignore=shutil.ignore_patterns(*NOT_COPIED))
        # A compiled file counts only while its source has the same hash, whatever the clock says.
        mode = py_compile.PycInvalidationMode.CHECKED_HASH
        compileall.compile_dir(copy, quiet=2, invalidation_mode=mode)
        check = [sys.executable, '-c', f'import {PACKAGE} as p; print(p.__file__)']
        found = subprocess.check_output(check, cwd=folder, env=environment(tree, copy), text=True)
        if not Path(found.strip()).is_relative_to(copy):
            raise SystemExit(
                f'mutants: expected Python to import {PACKAGE} from {copy} but found '
                f'{found.strip()}: start it without -I, -E and -P'
            )
        yield copy


def environment(tree: Path, copy: Path) -> dict[str, str]:
    """Return the environment in which tests import the package from a copy of the tree."""
    # What a pytest left that this one was started from would be taken for its own.
    kept = {k: v for k, v in os.environ.items() if not k.startswith(('PYTEST_', 'COVERAGE_'))}
    return {
        'AMENT_PREFIX_PATH': sys.prefix,
        'FUZZYCNC_DATA': str(tree.parent / 'shared' / 'data'),
        'OMP_NUM_THREADS': '1',
        'OPENBLAS_NUM_THREADS': '1',
        **kept,
        'FUZZYCNC_MUTANTS_REPORT': str(copy.parent / 'report.jsonl'),
        'PYTHONDONTWRITEBYTECODE': '1',
        'PYTHONPATH': os.pathsep.join([str(copy), str(TOOLS)]),
    }


def pytest(
    tree: Path,
    copy: Path,
    arguments: Sequence[str],
    limit: float | None = None,
    more: Mapping[str, str] | None = None,
) -> tuple[int, list[dict[str, Any]]]:
    """Run pytest in a copy; return its exit code, or -1 after the limit [s], and its report."""
    report = copy.parent / 'report.jsonl'
    report.write_text('')
    command = [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider']
    command += ['-p', 'mutation.plugin', *arguments]
    with (copy.parent / 'output.txt').open('w') as output:
        try:
            code = subprocess.run(
                command,
                cwd=copy,
                env={**environment(tree, copy), **(more or {})},
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                timeout=limit,
            ).returncode
        except subprocess.TimeoutExpired:
            code = -1
    return code, [json.loads(row) for row in report.read_text().splitlines()]


def make_map(tree: Path, mutants: Sequence[Mutant], arguments: Sequence[str]) -> dict[str, Any]:
    """Run a suite once; return its tests with their times, and the tests of each mutant."""
    places = {mutant.id: places_of(tree, mutant) for mutant in mutants}
    with copied(tree) as copy:
        data = copy.parent / 'coverage'
        settings = copy.parent / 'settings.ini'
        files = sorted({copy / name for lines in places.values() for name in lines})
        settings.write_text(
            f'[run]\ndata_file = {data}\nparallel = true\n'
            'context = ${FUZZYCNC_MUTANTS_CONTEXT-}\n'
            'disable_warnings = no-data-collected\n'
            'include =\n' + ''.join(f'    {file}\n' for file in files)
        )
        more = {'COVERAGE_PROCESS_START': str(settings)}
        code, report = pytest(tree, copy, arguments, more=more)
        if code not in (0, 1):
            output = (copy.parent / 'output.txt').read_text()
            raise SystemExit(
                f'{output}\nmutants: expected the suite to run but pytest gave {code}'
            )
        combine = [sys.executable, '-m', 'coverage', 'combine', '-q', f'--rcfile={settings}']
        subprocess.run(combine, cwd=copy, check=True)
        found = contexts(data, copy, places)
    durations: dict[str, float] = defaultdict(float)
    users: dict[str, set[str]] = defaultdict(set)
    for row in report:
        if 'fixtures' in row:
            for name in row['fixtures']:
                users[f'fixture {name}'].add(row['test'])
        elif '::' in row['test']:
            durations[row['test']] += row['duration']
    for test in durations:
        users[f'test {test}'].add(test)
        users[f'file {test.split("::")[0]}'].add(test)
    sharing = files_with_caches(tree, durations)
    tests: dict[str, list[str]] = {}
    for name, labels in found.items():
        reached = {test for label in labels for test in users[label]}
        shared = {test.split('::')[0] for test in reached} & sharing
        reached |= {test for file in shared for test in users[f'file {file}']}
        tests[name] = sorted(reached, key=lambda test: (durations[test], test))
    failed = sorted({row['test'] for row in report if row.get('outcome') == 'failed'})
    return {
        'arguments': list(arguments),
        'durations': {test: round(time, 4) for test, time in sorted(durations.items())},
        'failed': failed,
        'tests': tests,
    }


def places_of(tree: Path, mutant: Mutant) -> dict[str, Lines]:
    """Return the files and lines whose tests may notice a mutant; None for a whole file.

    What runs on import has run before any test, so that its users are those whose files name it.
    """
    line = find(tree, mutant)
    if not mutant.owner:
        return {mutant.file: (line + mutant.lines[0], line + mutant.lines[1])}
    word = re.compile(rf'\b{re.escape(mutant.owner)}\b')
    files: dict[str, Lines] = {mutant.file: None}
    for file in sorted((tree / PACKAGE).rglob('*.py')):
        if file.name != '__init__.py' and word.search(file.read_text(encoding='utf-8')):
            files[file.relative_to(tree).as_posix()] = None
    return files


def contexts(data: Path, copy: Path, places: dict[str, dict[str, Lines]]) -> dict[str, set[str]]:
    """Return the contexts in which each mutant's places ran."""
    from coverage import CoverageData

    measured = CoverageData(str(data))
    measured.read()
    found: dict[str, set[str]] = {}
    for name, files in places.items():
        found[name] = set()
        for file, lines in files.items():
            for number, labels in measured.contexts_by_lineno(str(copy / file)).items():
                if lines is None or lines[0] <= number <= lines[1]:
                    found[name].update(labels)
    return found


def files_with_caches(tree: Path, tests: Iterable[str]) -> set[str]:
    """Return the test files that keep results from one test to the next."""
    files = {test.split('::')[0] for test in tests}
    return {file for file in files if re.search(r'\bcache\b', (tree / file).read_text())}

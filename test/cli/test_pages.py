# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every `fuzzycnc` command that README and docs show is run, in the order of its page.

A page starts in a copy of `examples/`.  `fuzzycnc up` without an end, or watched or operated, runs
beside the commands that follow it, until the next one or the end of the page.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import IO

import pytest

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md')))
ELSEWHERE = {
    'demo --scenario linuxcnc': 'needs LinuxCNC: test/qualification runs it',
    'demo --scenario shift': 'takes minutes: test/graph runs a short one',
    'import-csv spindle_thermal.csv': 'a recording of others: test/cli/models runs it',
    'train spindle ': 'the same',
    'evaluate spindle ': 'the same',
    'papers ': 'takes half a minute: test/papers computes the same',
    'sensors ': 'needs sensors and a night: test/cli/sensors runs those of the page',
    'machine identify emps.csv': 'a recording of others: test/core/identify runs it',
    'machine new mill.yaml --linuxcnc-ini ~': 'an INI file of the reader',
    'operate status  # ': 'needs a DDS with security, which the wheels do not have',
    'operate activate  # ': 'the same',
    'operate probe X=3um@': 'needs a predictor that runs: test/cli/live reads such values',
    'servo tune --on-machine': 'needs a machine and a key that is held: test/graph has both',
    'pareto butterfly': 'takes half a minute: test/studies runs it',
    'fleet evaluate shop --dask': 'needs a scheduler of Dask: test/cli/fleet starts one',
}
"""Beginnings of commands that are not run here, and why."""

GIVEN = {
    'docs/how-to/scaling.md': ['examples', 'model', 'archive'],
    'docs/how-to/integration.md': ['model'],
    'docs/how-to/live-page.md': ['model'],
    'docs/explanation/methods/servo.md': ['axis'],
}
"""What readers have before they come to a page, beside the examples."""

LONG = {
    'docs/explanation/methods/deformation.md',
    'docs/explanation/methods/feedrate.md',
    'docs/explanation/methods/servo.md',
    'docs/how-to/fleet.md',
    'docs/how-to/integration.md',
    'docs/how-to/learning.md',
    'docs/how-to/linuxcnc.md',
    'docs/how-to/live-page.md',
    'docs/how-to/scaling.md',
    'docs/how-to/security.md',
    'docs/how-to/your-sensors.md',
    'docs/how-to/your-probe.md',
    'docs/reference/bags.md',
    'docs/reference/machine-file.md',
    'docs/tutorials/first-part.md',
    'docs/tutorials/try-it.md',
    'docs/tutorials/your-own-recording.md',
}
"""Pages whose commands take more than some seconds, or start nodes."""

SETTLE = 4.0
"""Time [s] in which nodes that were started report, and what is wrong with them shows."""


def label(page: Path) -> str:
    """Return a page's path in the repository."""
    return str(page.relative_to(ROOT))


def statements(text: str) -> list[str]:
    """Return the shell statements of a page that call fuzzycnc or copy files; loops are one."""
    found: list[str] = []
    for language, body in re.findall(r'^```(\w*)\n(.*?)^```', text, re.M | re.S):
        if language not in ('', 'sh'):
            continue
        joined = re.sub(r'\\\n\s*', '', body)
        if re.search(r'^\$ ', joined, re.M):  # commands among what they print
            joined = '\n'.join(re.findall(r'^\$ (.*)$', joined, re.M))
        parts = re.findall(r'^for [\s\S]*?^done$|^.+$', joined, re.M)
        ours = re.compile(r'fuzzycnc |cp |for .*\n *fuzzycnc ')
        found += [part.strip() for part in parts if ours.match(part)]
    return found


def here(statement: str) -> bool:
    """Return whether a statement is to be run by these tests."""
    return not any(statement.startswith(f'fuzzycnc {beginning}') for beginning in ELSEWHERE)


SHOWN = {label(page): statements(page.read_text(encoding='utf-8')) for page in PAGES}
RUN = [page for page, lines in SHOWN.items() if any(map(here, lines))]


def test_no_reason_is_left_over():
    lines = [line for lines in SHOWN.values() for line in lines]
    left = [name for name in ELSEWHERE if not any(f'fuzzycnc {name}' in line for line in lines)]
    assert not left
    assert LONG <= set(RUN)
    assert GIVEN.keys() <= set(RUN)
    assert len(lines) > 60


class Reader:
    """Somebody who types the commands of a page."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder = folder
        programs = folder.parent / 'bin'
        programs.mkdir()
        command = programs / 'fuzzycnc'
        command.write_text(
            f"#!/bin/sh\nexec {sys.executable} -c 'import sys; from fuzzycnc_ros.start import "
            'fuzzycnc; sys.argv[0] = "fuzzycnc"; sys.exit(fuzzycnc())\' "$@"\n'
        )
        command.chmod(0o755)
        self._environment = {
            **os.environ,
            'PATH': f'{programs}:{os.environ["PATH"]}',
            'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}',
            'ROS_DOMAIN_ID': str(domain),
            'COLUMNS': '100',
            'XDG_CONFIG_HOME': str(folder.parent / 'config'),
        }
        self._beside: subprocess.Popen[bytes] | None = None
        self._log = folder.parent / 'beside.log'

    def start(
        self, statement: str, output: int | IO[bytes] = subprocess.PIPE
    ) -> subprocess.Popen[bytes]:
        """Type a statement."""
        return subprocess.Popen(
            ['bash', '-ec', statement],
            cwd=self.folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    def type(self, statement: str, following: str = '') -> None:
        """Run a statement; it must end well."""
        lasting = re.match(r'fuzzycnc (?:up|record)\b', statement)
        ends = re.search('--rate|--lockstep', statement) and not re.search(
            'operate|watch', following
        )
        if lasting or 'fuzzycnc up' in statement:
            self.leave()  # a machine has one graph
        if lasting and not ends:
            with self._log.open('wb') as output:
                self._beside = self.start(statement, output)
            self._settle(statement)
            return
        process = self.start(statement)
        said = process.communicate(timeout=500)[0].decode()
        assert process.returncode == 0, f'{statement}\n{said}'
        assert 'Traceback' not in said, f'{statement}\n{said}'

    def _settle(self, statement: str) -> None:
        """Wait until what runs beside has been up for a while, and its nodes have reported."""
        assert self._beside is not None
        begin = started = time.monotonic()
        graph = 'fuzzycnc up' in statement
        settled = SETTLE if graph else 2.0 * SETTLE  # what records does not say that it began
        while time.monotonic() - begin < 120.0:
            said = self._log.read_text()
            if self._beside.poll() is not None:
                pytest.fail(f'{statement}: ended with {self._beside.returncode}\n{said}')
            if graph and 'all started' not in said:
                started = time.monotonic()  # slow on a busy computer
            if time.monotonic() - started > settled:
                return
            time.sleep(0.1)
        pytest.fail(f'{statement}: not started within 120 s\n{said}')

    def leave(self) -> None:
        """End what runs beside, as by Ctrl-C; it must end well."""
        if self._beside is None:
            return
        process, self._beside = self._beside, None
        os.killpg(process.pid, signal.SIGINT)
        process.wait(timeout=60)
        said = self._log.read_text()
        assert process.returncode in (0, 130), f'{process.args}\n{said}'
        assert 'Traceback' not in said, f'{process.args}\n{said}'

    def close(self) -> None:
        """End what is left after a failure."""
        if self._beside is not None:
            os.killpg(self._beside.pid, signal.SIGKILL)
            self._beside.wait()


@pytest.fixture
def reader(tmp_path, domain):
    """A reader in a copy of the examples."""
    shutil.copytree(ROOT / 'examples', tmp_path / 'examples')
    found = Reader(tmp_path / 'examples', domain)
    yield found
    found.close()


def give(reader: Reader, page: str) -> None:
    """Put what a reader has before the page into the folder."""
    things = GIVEN.get(page, [])
    if {'model', 'archive', 'examples'} & set(things):
        for day in ('monday', 'tuesday', 'wednesday'):
            reader.type(
                f'fuzzycnc import-csv {day}.csv --out recordings/{day} --time t --speed rpm '
                "--temperature 't*' --displacement y=Y:um --displacement z=Z:um"
            )
        reader.type('fuzzycnc train recordings/monday recordings/tuesday --out mill.json')
        shutil.copy(reader.folder / 'mill.json', reader.folder / 'mill_1.json')
    if 'axis' in things:
        built_in = ROOT / 'fuzzycnc_ros' / 'machine_file' / 'built_in'
        shutil.copy(built_in / 'lathe.yaml', reader.folder / 'tuned.yaml')
    if 'archive' in things:
        shutil.copytree(
            reader.folder / 'recordings' / 'wednesday', reader.folder / 'archive' / '2026-03-04'
        )


@pytest.mark.parametrize(
    'page', [pytest.param(page, marks=pytest.mark.slow if page in LONG else ()) for page in RUN]
)
def test_commands_of_a_page_work(reader, page):
    give(reader, page)
    lines = list(filter(here, SHOWN[page]))
    for statement, following in zip(lines, [*lines[1:], ''], strict=True):
        reader.type(statement, following)
    reader.leave()

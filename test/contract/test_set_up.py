# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The set-up: what it installs, how it shows its progress, how it ends and goes on."""

import io
import itertools
import os
import re
import select
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
try:
    import setup_env
    import setup_jobs
    import setup_lock
finally:
    sys.path.remove(str(ROOT / 'tools'))

LOCK = ROOT / 'requirements' / 'environment.txt'
INTERPRETERS = [(3, 10, 13), (3, 11, 7), (3, 12, 1), (3, 13, 0)]


class Terminal(io.StringIO):
    """A stream that can rewrite its line."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def signals():
    with setup_jobs.Signals() as caught:
        yield caught
    signal.signal(signal.SIGINT, signal.default_int_handler)


def python(script: str) -> list[str]:
    return [sys.executable, '-c', script]


def said(stream: io.StringIO, job, line: str) -> str:
    """Return what is shown when a job prints a line."""
    before = len(stream.getvalue())
    job.read(line)
    return stream.getvalue()[before:]


def has_ended(pid: int) -> bool:
    """Return whether a process ends within ten seconds."""
    try:
        handle = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([handle], [], [], 10.0)[0])
    finally:
        os.close(handle)


def carry_out(signals, *jobs, progress=None):
    """Run jobs, with their progress kept from the terminal."""
    progress = progress or setup_jobs.Progress(io.StringIO())
    setup_jobs.run(jobs, ROOT, dict(os.environ), progress, signals)


@pytest.mark.parametrize('version', INTERPRETERS)
def test_the_lock_is_read_as_pip_reads_it(version, monkeypatch):
    requirements = pytest.importorskip('packaging.requirements')
    monkeypatch.setattr(sys, 'version_info', version)
    environment = {
        'implementation_name': 'cpython',
        'platform_python_implementation': 'CPython',
        'python_full_version': '.'.join(map(str, version)),
        'sys_platform': sys.platform,
    }
    wanted = set()
    for line in LOCK.read_text().replace('\\\n', '').splitlines():
        if line[:1].isalpha():
            given = requirements.Requirement(line.partition(' --hash')[0])
            if given.marker is None or given.marker.evaluate(environment):
                wanted.add((given.name, str(given.specifier)[2:]))
    read = setup_lock.entries(LOCK)
    assert {(entry.name, entry.version) for entry in read} == wanted
    assert all('--hash=sha256:' in entry.text for entry in read)


def test_a_marker_of_another_kind_is_not_guessed():
    with pytest.raises(NameError, match='platform_release'):
        setup_lock.applies('platform_release == "6.1"')


def test_what_is_installed_later_is_in_the_lock_and_not_needed_for_messages():
    locked = {entry.name for entry in setup_lock.entries(LOCK)}
    assert locked >= setup_env.LATER
    build = (ROOT / 'msg_defs' / 'pyproject.toml').read_text()
    assert not {name for name in setup_env.LATER if f'"{name}' in build}


def test_slices_hold_every_entry_once():
    entries = setup_lock.entries(LOCK)
    parts = setup_lock.slices(entries, 36)
    assert sorted(e.name for part in parts for e in part) == sorted(e.name for e in entries)
    assert max(map(len, parts)) <= 36
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
    assert setup_lock.slices([], 36) == []


def test_half_installed_packages_are_installed_again(tmp_path):
    for name, record in (
        ('Whole_Thing-1.2', 'a.py,,\nWhole_Thing-1.2.dist-info/INSTALLER,,\n'),
        ('torn-3.0', 'b.py,,\ntorn-3.0.dist-info/RECORD,,\n'),
        ('barely-4.0', None),
    ):
        folder = tmp_path / f'{name}.dist-info'
        (folder / 'licenses').mkdir(parents=True)
        (folder / 'licenses' / 'LICENSE').write_text('')
        (folder / 'METADATA').write_text('')
        if record is not None:
            (folder / 'RECORD').write_text(record)
    assert setup_lock.held(tmp_path) == {('whole-thing', '1.2')}
    assert [path.name for path in tmp_path.iterdir()] == ['Whole_Thing-1.2.dist-info']


def test_a_terminal_gets_one_line_rewritten():
    stream = Terminal()
    progress = setup_jobs.Progress(stream)
    progress.begin('locked dependencies')
    progress.step('locked dependencies', 37, 112, 'scipy')
    progress.step('messages', 12, 61, unit=' files')
    lines = stream.getvalue().split('\r\x1b[K')
    assert '\n' not in stream.getvalue()
    assert lines[-2] == 'set-up: locked dependencies 37 of 112 (scipy)'
    both = 'set-up: locked dependencies 37 of 112 (scipy); messages 12 of 61 files'
    assert both.startswith(lines[-1])
    progress.end('locked dependencies', 12.4)
    assert 'set-up: locked dependencies: 12 s\n' in stream.getvalue()


def test_a_log_gets_sparse_lines():
    stream, now = io.StringIO(), [0.0]
    progress = setup_jobs.Progress(stream, lambda: now[0])
    progress.begin('messages')
    for done in range(61):
        now[0] = 0.5 * done
        progress.step('messages', done, 61, unit=' files')
    progress.end('messages', 30.0)
    assert stream.getvalue().splitlines() == [
        'set-up: messages ...',
        'set-up: messages 20 of 61 files',
        'set-up: messages 40 of 61 files',
        'set-up: messages 60 of 61 files',
        'set-up: messages: 30 s',
    ]


def test_jobs_wait_for_those_they_need(tmp_path, signals):
    read: list[str] = []
    path = tmp_path / 'made'
    first = setup_jobs.Job('first', python(f'open({str(path)!r}, "w").write("made")'))
    second = setup_jobs.Job(
        'second', python(f'print(open({str(path)!r}).read(), end="")'), [first], read.append
    )
    carry_out(signals, second, first)
    assert read == ['made']


def test_a_failed_job_shows_its_output_and_ends_the_others(signals, capfd):
    ready = python('print("up", flush=True); import time; time.sleep(600)')
    failing = setup_jobs.Job('bad', python('print("the reason"); raise SystemExit(3)'))
    with pytest.raises(setup_jobs.JobError, match='bad failed, see above'):
        carry_out(signals, setup_jobs.Job('long', ready), failing)
    assert 'the reason' in capfd.readouterr().err


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_job_with_all_that_it_started(number, signals):
    pids: list[int] = []

    def started(line: str) -> None:
        if line:
            pids.append(int(line))
            os.kill(os.getpid(), number)

    script = (
        'import subprocess, sys\n'
        'child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])\n'
        'print(child.pid, flush=True)\n'
        'child.wait()\n'
    )
    with pytest.raises(setup_jobs.Interrupted) as caught:
        carry_out(signals, setup_jobs.Job('long', python(script), read=started))
    assert caught.value.args == (number,)
    assert has_ended(pids[0])


def test_a_job_that_ignores_the_request_is_killed(signals, monkeypatch):
    monkeypatch.setattr(setup_jobs, 'PATIENCE', 0.2)
    script = (
        'import signal, time\n'
        'signal.signal(signal.SIGTERM, signal.SIG_IGN)\n'
        'print("deaf", flush=True)\n'
        'time.sleep(600)\n'
    )

    def heard(line: str) -> None:
        if line:
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(setup_jobs.Interrupted):
        carry_out(signals, setup_jobs.Job('deaf', python(script), read=heard))


@pytest.mark.parametrize(
    ('line', 'shown'),
    [
        ('[12/61] Building C object a.c.o', 'messages (fuzzycnc_msgs) 12 of 61 files'),
        ('  [ 45%] Building C object a.c.o', 'messages (fuzzycnc_msgs) 45 of 100 %'),
    ],
)
def test_the_compiler_run_tells_how_far_it_is(tmp_path, signals, line, shown):
    environment = setup_env.Environment(tmp_path, LOCK, signals)
    stream = io.StringIO()
    environment.progress = setup_jobs.Progress(stream)
    job = environment.messages('install')
    job.read(line)
    assert stream.getvalue() == f'set-up: {shown}\n'
    assert job.environment['SKBUILD_BUILD_DIR'] == str(tmp_path / 'messages')


def test_dependencies_that_are_there_are_not_installed_again(tmp_path, signals):
    environment = setup_env.Environment(tmp_path, LOCK, signals)
    stream = io.StringIO()
    environment.progress = setup_jobs.Progress(stream, itertools.count(0.0, 60.0).__next__)
    entries = setup_lock.entries(LOCK)
    for entry in entries[:-2]:
        folder = environment.site_packages() / f'{entry.name}-{entry.version}.dist-info'
        folder.mkdir(parents=True)
        (folder / 'RECORD').write_text(f'{folder.name}/INSTALLER,,\n')
    sooner, later = environment._installations()
    (job,) = sooner + later
    listed = Path(job.command[-1]).read_text()
    assert listed == ''.join(entry.text for entry in entries[-2:])
    total = len(entries)
    assert f'{total - 1} of {total} (ros-rcl)' in said(stream, job, 'Collecting ros-rcl==9.2 (a)')
    from_folder = 'Processing /a/types_pyyaml-6.0-py3-none-any.whl (from -r /b/apsw.txt (line 1))'
    assert f'{total} of {total} (types_pyyaml)' in said(stream, job, from_folder)


@pytest.mark.slow
def test_the_wheel_holds_what_ros_looks_for(tmp_path):
    command = ['-m', 'pip', 'wheel', '--quiet', '--no-deps', '--no-build-isolation']
    done = subprocess.run(
        [sys.executable, *command, '--wheel-dir', str(tmp_path), str(ROOT)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob('fuzzycnc_ros-*.whl')
    with zipfile.ZipFile(wheel) as archive:
        names = {
            re.sub(r'^[^/]+\.data/data/', '', item.filename): item for item in archive.infolist()
        }
        script = archive.read(names['lib/fuzzycnc_ros/compensator']).decode()
        entry_points = next(name for name in names if name.endswith('/entry_points.txt'))
        text = archive.read(entry_points).decode()
    assert script == '#!/bin/sh\nexec "${0%/*}/../../bin/compensator" "$@"\n'
    for name in re.findall(r'^(\w+) = ', text, re.M):
        assert names[f'lib/fuzzycnc_ros/{name}'].external_attr >> 16 & 0o111, name
    for path in (ROOT / 'params').iterdir():
        assert f'share/fuzzycnc_ros/params/{path.name}' in names
    assert 'share/ament_index/resource_index/packages/fuzzycnc_ros' in names
    assert 'share/fuzzycnc_ros/package.xml' in names
    assert {'fuzzycnc_ros/py.typed', 'fuzzycnc_ros/cli/main.py'} <= names.keys()
    assert not {name for name in names if name.startswith(('test/', 'tools/'))}

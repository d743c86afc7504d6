# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The set-up: its stages, how it ends and goes on, and the wheel it builds."""

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
finally:
    sys.path.remove(str(ROOT / 'tools'))

LOCKS = ROOT / 'requirements'


def python(script: str) -> list[str]:
    return [sys.executable, '-c', script]


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


@pytest.fixture
def environment(tmp_path, monkeypatch):
    """An environment whose uv is a script that prints its arguments and settings to a file."""
    folder = tmp_path / 'env'
    (folder / 'bin').mkdir(parents=True)
    (folder / 'bin' / 'python').symlink_to(sys.executable)
    uv = folder / 'bin' / 'uv'
    uv.write_text(f'#!/bin/sh\necho "$UV_DEFAULT_INDEX|$VIRTUAL_ENV|$*" >>{tmp_path}/called\n')
    uv.chmod(0o755)
    monkeypatch.delenv('UV_DEFAULT_INDEX', raising=False)
    monkeypatch.setenv('PIP_CONFIG_FILE', os.devnull)
    return setup_env.Environment(folder, LOCKS / 'floor.txt')


@pytest.mark.parametrize('name', ['environment', 'floor', 'docs', 'uv'])
def test_each_package_of_a_lock_has_a_version_and_hashes(name):
    entries = re.findall(r'^\w.*(?:\n +.*)*', (LOCKS / f'{name}.txt').read_text(), re.M)
    assert entries
    for entry in entries:
        assert re.match(r'[\w.-]+(\[[\w,]+\])?==\S+', entry), entry
        assert '--hash=sha256:' in entry, entry


def test_a_stage_leaves_its_stamp_only_when_it_is_finished(environment, capfd):
    stage = environment.stage('messages (fuzzycnc_msgs)', 'inputs')
    with pytest.raises(setup_env.SetupError, match=r'messages .* failed, see above'), stage:
        setup_env.run(stage.name, python('print("the reason"); raise SystemExit(3)'))
    assert 'the reason' in capfd.readouterr().out
    assert not stage.is_current()
    with stage:
        setup_env.run(stage.name, python('pass'))
    assert re.search(r'set-up: messages \(fuzzycnc_msgs\): \d+ s\n', capfd.readouterr().err)
    assert environment.stage('messages (fuzzycnc_msgs)', 'inputs').is_current()
    assert not environment.stage('messages (fuzzycnc_msgs)', 'other inputs').is_current()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('deaf', [False, True])
def test_a_signal_ends_a_command_with_all_that_it_started(number, deaf, tmp_path):
    """The command tells its child's number and sends the signal to the set-up."""
    pids = tmp_path / 'pids'
    ignore = 'import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); ' if deaf else ''
    child = (
        f'import os, subprocess, sys; {ignore}'
        'child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]); '
        f'open({str(pids)!r}, "w").write(str(child.pid)); '
        f'os.kill(os.getppid(), {int(number)}); child.wait()'
    )
    script = (
        f'import signal, sys; sys.path.insert(0, {str(ROOT / "tools")!r}); import setup_env\n'
        f'setup_env.PATIENCE = 0.5\n'
        f'signal.signal({int(number)}, setup_env.terminate)\n'
        f'setup_env.run("stage", [sys.executable, "-c", {child!r}])\n'
    )
    done = subprocess.run(python(script), capture_output=True, text=True, check=False)
    assert done.returncode == 128 + number, done.stderr
    assert 'set-up: interrupted' in done.stderr
    assert has_ended(int(pids.read_text()))


@pytest.mark.parametrize('name', ['PIP_INDEX_URL', 'UV_DEFAULT_INDEX', ''])
def test_uv_asks_the_index_that_pip_would_ask(environment, name, monkeypatch, tmp_path):
    monkeypatch.delenv('PIP_INDEX_URL', raising=False)
    if name:
        monkeypatch.setenv(name, 'https://packages.example.org/simple')
    environment.uv('stage', 'pip', 'list')
    index, folder, arguments = (tmp_path / 'called').read_text().strip().split('|')
    assert index == ('https://packages.example.org/simple' if name else '')
    assert folder == str(environment.folder)
    assert arguments.endswith('pip list')


def test_messages_are_compiled_again_when_a_definition_changes(environment, monkeypatch, tmp_path):
    definitions = tmp_path / 'msg_defs' / 'msg'
    definitions.mkdir(parents=True)
    (definitions / 'Speed.msg').write_text('float64 speed\n')
    monkeypatch.setattr(setup_env, 'ROOT', tmp_path)
    monkeypatch.setattr(setup_env, 'check_tools', lambda: None)
    called = tmp_path / 'called'
    environment.ensure_messages('')
    environment.ensure_messages('')
    assert called.read_text().count('--reinstall') == 1
    (definitions / 'Speed.msg').write_text('float32 speed\n')
    environment.ensure_messages('')
    assert called.read_text().count('--reinstall') == 2


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
    assert script.startswith('#!/bin/sh\n')
    assert script.endswith('from fuzzycnc_ros.start import compensator\n\ncompensator()\n')
    assert re.findall(r'^(\w+) = ', text, re.M) == ['fuzzycnc']
    for path in (ROOT / 'params').glob('*.yaml'):
        assert names[f'lib/fuzzycnc_ros/{path.stem}'].external_attr >> 16 & 0o111, path.stem
    for path in (ROOT / 'params').iterdir():
        assert f'share/fuzzycnc_ros/params/{path.name}' in names
    assert 'share/ament_index/resource_index/packages/fuzzycnc_ros' in names
    assert 'share/fuzzycnc_ros/package.xml' in names
    assert {'fuzzycnc_ros/py.typed', 'fuzzycnc_ros/cli/main.py'} <= names.keys()
    assert not {name for name in names if name.startswith(('test/', 'tools/'))}

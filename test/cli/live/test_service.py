# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc service`: the units that are written, shown and removed."""

import os
import shutil
import stat
import subprocess
import sys

import pytest

from fuzzycnc_ros.cli.live.service_units import PAGE, passed_on, unit_name
from fuzzycnc_ros.cli.live.supervision import ProcessState, Supervised
from fuzzycnc_ros.cli.live.supervision_run import COMING_BACK, silent_nodes
from fuzzycnc_ros.cli.main import run
from fuzzycnc_ros.graph.bring_up import NODE_STOP, RECORDER_STOP, NodeSpec

MODEL = 'a "good" $model 50%.json'
"""A name in which systemd sees more than letters."""


@pytest.fixture
def units(tmp_path, monkeypatch):
    """The folder of a user's units, who works in an empty one."""
    monkeypatch.setenv('XDG_CONFIG_HOME', str(tmp_path / 'config'))
    monkeypatch.setenv('ROS_DOMAIN_ID', '7')
    monkeypatch.setenv('ROS_STATIC_PEERS', '')
    work = tmp_path / 'my 100% work'
    (work / 'bags').mkdir(parents=True)
    monkeypatch.chdir(work)
    return tmp_path / 'config' / 'systemd' / 'user'


def install(*more):
    return run(['service', 'install', '--machine', 'mill_1', *more])


def settings(file):
    """Return the settings of a unit; of those that stand several times all."""
    found = {}
    for line in file.read_text().splitlines():
        name, equals, value = line.partition('=')
        if equals and not line.startswith('#'):
            found.setdefault(name, []).append(value)
    return found


def test_a_service_is_written_but_not_started(units, capsys):
    assert install('--', '--model', MODEL, '--autostart') == 0
    assert [file.name for file in units.iterdir()] == ['fuzzycnc-mill_1.service']
    said = capsys.readouterr().out
    assert 'type: systemctl --user enable --now fuzzycnc-mill_1.service' in said
    found = settings(units / 'fuzzycnc-mill_1.service')
    assert found['Type'] == ['notify']
    assert found['Restart'] == ['on-failure']
    assert found['KillMode'] == ['mixed']
    assert found['Environment'].count('ROS_DOMAIN_ID=7') == 1
    assert not any('ROS_STATIC_PEERS' in value for value in found['Environment'])
    assert found['ExecStart'] == [
        f'{sys.executable} -m fuzzycnc_ros.cli.main up --machine mill_1 '
        '--state-directory "%S/fuzzycnc/mill_1" '
        '--model "a \\"good\\" $$model 50%%.json" --autostart'
    ]
    assert found['WorkingDirectory'] == [f'{os.getcwd().replace("%", "%%")}']


def test_a_service_has_more_time_to_end_than_what_it_runs(units):
    assert install('--record', 'bags', '--page') == 0
    for name, least in (
        ('fuzzycnc-mill_1', NODE_STOP + RECORDER_STOP),
        ('fuzzycnc-mill_1-record', RECORDER_STOP),
        ('fuzzycnc-page', RECORDER_STOP),  # it waits for what it records
    ):
        (stop,) = settings(units / f'{name}.service')['TimeoutStopSec']
        assert float(stop) > least, name


def test_no_two_machines_share_a_unit():
    """Not even those whose name is the last word of a unit of another."""
    words = ('mill', 'record', 'page', 'graph')
    machines = [*words, *(f'{a}/{b}' for a in words for b in words), 'shop_mill', 'shop/mill']
    names = [unit_name(machine, part) for machine in machines for part in ('', 'record')]
    assert len({PAGE, *names}) == 1 + len(names)
    assert unit_name('mill') == 'fuzzycnc-mill.service'
    assert unit_name('shop/mill', 'record') == 'fuzzycnc-shop-mill-record.service'


def test_a_recording_has_a_bag_for_each_start(units):
    words = ['--record', 'bags', '--record-options', '--split-duration 1h']
    assert install(*words) == 0
    (line,) = settings(units / 'fuzzycnc-mill_1-record.service')['ExecStart']
    assert '--split-duration 1h' in line
    shell = line.replace('%%', '%').replace('$$', '$').replace('\\"', '"').partition('"exec ')[2]
    told = subprocess.run(
        ['/bin/sh', '-c', f'printf "%s\\n" {shell[:-1]}'], capture_output=True, text=True
    ).stdout.splitlines()
    assert told[:4] == [sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'record']
    folder, name = os.path.split(told[-1])
    assert folder == f'{os.getcwd()}/bags'
    assert name.startswith('mill_1-20')


@pytest.mark.parametrize('system', [False, True])
def test_systemd_takes_the_units(units, tmp_path, system, monkeypatch, capsys):
    analyze = shutil.which('systemd-analyze')
    if analyze is None:
        pytest.skip('expected systemd-analyze in PATH but found none: apt-get install systemd')
    words = ['--record', 'bags', '--page=8700', *(['--system', '--run-as', 'root'] * system)]
    assert install(*words, '--dry-run', '--', '--model', MODEL) == 0
    assert not units.exists()
    folder = tmp_path / 'written'
    folder.mkdir()
    file = None
    for line in capsys.readouterr().out.splitlines():
        if line.startswith('# /'):
            file = folder / os.path.basename(line)
            file.touch()
        else:
            file.write_text(file.read_text() + line + '\n')
    names = [unit_name('mill_1'), unit_name('mill_1', 'record'), 'fuzzycnc-page.service']
    assert sorted(file.name for file in folder.iterdir()) == sorted(names)
    scope = '--system' if system else '--user'
    environment = {**os.environ, 'XDG_RUNTIME_DIR': str(tmp_path)}
    done = subprocess.run(
        [analyze, scope, 'verify', '--recursive-errors=no', *map(str, folder.iterdir())],
        capture_output=True,
        text=True,
        env=environment,
    )
    assert (done.returncode, done.stderr) == (0, '')


@pytest.mark.parametrize(
    ('words', 'expected'),
    [
        (['--', '--modell', 'x'], 'No such option: --modell'),
        (['--', '--page'], 'expected none of --machine, --record, --page'),
        (['--', '--rate', 'fast'], '--rate'),
        (['--record', 'nowhere'], '--record: expected a folder but found none at'),
        (['--record', 'bags', '--record-options', '--split'], 'No such option: --split'),
        (['--record-options', '--split-size 1GB'], 'expected --record, too'),
        (['--run-as', 'anna'], 'expected --system, too'),
    ],
)
def test_what_would_not_start_is_refused_before_it_is_written(units, capsys, words, expected):
    assert install(*words) == 2
    assert expected in capsys.readouterr().err
    assert not units.exists()


@pytest.mark.parametrize(
    'words',
    [
        ('--record', 'bags', '--record-options', '--ship sftp://mill:s3same@host/a'),
        ('--record', 'bags', '--record-options', "'--ship=s3://shop/a?key=s3same'"),
    ],
)
def test_no_secret_reaches_a_unit(units, capsys, words):
    """Everybody reads units, and the list of processes."""
    assert install(*words) != 0
    assert install(*words, '--dry-run') != 0
    said = ''.join(capsys.readouterr())
    assert 'expected a URL without a password' in said
    assert 's3same' not in said
    assert not units.exists()


def test_units_are_shown_and_removed(units, capsys):
    assert install('--record', 'bags', '--page') == 0
    assert run(['service', 'show', '--machine', 'mill_1']) == 0
    said = capsys.readouterr().out
    assert said.count('[Service]') == 3
    assert run(['service', 'remove', '--machine', 'mill_1']) == 0
    assert [file.name for file in units.iterdir()] == ['fuzzycnc-page.service']
    assert run(['service', 'remove', '--machine', 'mill_1', '--with-page']) == 0
    assert not [*units.iterdir()]
    assert run(['service', 'show', '--machine', 'mill_1']) == 2
    assert 'expected units of mill_1 but found none' in capsys.readouterr().err
    assert (units / '../../../my 100% work/bags').is_dir()


def test_a_unit_of_somebody_else_is_left_alone(units, capsys):
    units.mkdir(parents=True)
    other = units / 'fuzzycnc-mill_1-record.service'
    other.write_text('[Service]\nExecStart=/bin/true\n')
    assert install('--record', 'bags') == 2
    assert 'move it away' in capsys.readouterr().err
    assert [*units.iterdir()] == [other]
    assert run(['service', 'remove', '--machine', 'mill_1']) == 0
    assert other.exists()


def test_now_has_systemctl_do_it(units, tmp_path, monkeypatch, capsys):
    programs = tmp_path / 'programs'
    programs.mkdir()
    calls = tmp_path / 'calls'
    fake = programs / 'systemctl'
    fake.write_text(
        f'#!/bin/sh\necho "$*" >> {calls}\n'
        'case "$*" in *disable*) echo refused >&2; exit 1;; esac\n'
    )
    fake.chmod(fake.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv('PATH', f'{programs}:/usr/bin:/bin')
    assert install('--now') == 0
    name = 'fuzzycnc-mill_1.service'
    assert calls.read_text().splitlines() == [
        '--user daemon-reload',
        f'--user enable --now {name}',
    ]
    assert run(['service', 'remove', '--machine', 'mill_1', '--now']) == 2
    assert 'refused' in capsys.readouterr().err
    assert (units / name).exists()


def test_libraries_that_a_python_has_set_for_itself_are_not_passed_on():
    shell = {'LD_LIBRARY_PATH': '/opt/ros/lib', 'HOME': '/root', 'ROS_DISTRO': 'jazzy'}
    assert passed_on(shell) == {'LD_LIBRARY_PATH': '/opt/ros/lib', 'ROS_DISTRO': 'jazzy'}
    own = {**shell, '_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1'}
    assert passed_on(own) == {'ROS_DISTRO': 'jazzy'}


class Views:
    """Stands for what nodes say of themselves."""

    def __init__(self, **heard_at):
        self.heard_at = heard_at

    def view(self, machine, node):
        from fuzzycnc_ros.cli.live.supervision_monitor import NodeView

        return NodeView(heard_at=self.heard_at.get(node, 0.0))


def supervised(name, **more):
    graph = type('Graph', (), {'machine': 'mill'})()
    return Supervised(graph, (NodeSpec(name, {}),), set(), **more)


@pytest.mark.ros
def test_nodes_that_hang_or_were_given_up_are_silent():
    now = 1000.0
    views = Views(compensator=now - 1.0, recorder=now - 60.0)
    well = supervised('compensator')
    hanging = supervised('recorder')
    unheard = supervised('thermal_predictor')
    assert silent_nodes([well], views, now) == []
    assert silent_nodes([well, hanging], views, now) == ['mill/recorder']
    assert silent_nodes([unheard], views, now) == ['mill/thermal_predictor']
    begun = [now - 0.5 * COMING_BACK]
    assert silent_nodes([supervised('thermal_predictor', begun=begun)], views, now) == []
    late = supervised('thermal_predictor', begun=[now - 2.0 * COMING_BACK])
    assert silent_nodes([late], views, now) == ['mill/thermal_predictor']
    gone = supervised('recorder', state=ProcessState.GIVEN_UP)
    assert silent_nodes([gone], views, now) == ['mill/recorder']
    ending = supervised('recorder', state=ProcessState.WAITING)
    assert silent_nodes([ending], views, now) == []

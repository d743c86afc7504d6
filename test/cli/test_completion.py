# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What shells are told when somebody presses Tab, by the protocol that their scripts use."""

import os
import subprocess
import sys

import pytest

from fuzzycnc_ros.cli import options
from fuzzycnc_ros.cli.axes import position, servo, servo_axis
from fuzzycnc_ros.cli.completion import join_bash_words
from fuzzycnc_ros.cli.main import COMMANDS
from fuzzycnc_ros.cli.programs import advise, pareto, schedule

SHELLS = ('bash', 'zsh', 'fish')


@pytest.fixture
def proposed(monkeypatch, capsys, tmp_path):
    """Return what bash is told for a line whose last word is being typed."""
    from fuzzycnc_ros.cli.main import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'argv', ['fuzzycnc'])
    monkeypatch.setenv('_FUZZYCNC_COMPLETE', 'complete_bash')

    def ask(line: str) -> list[str]:
        words = line.split(' ')
        monkeypatch.setenv('COMP_WORDS', '\n'.join(words))
        monkeypatch.setenv('COMP_CWORD', str(len(words) - 1))
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == 0
        return capsys.readouterr().out.split()

    return ask


def test_commands_are_proposed_without_loading_any(root):
    script = (
        'import sys, fuzzycnc_ros.cli.main as command\n'
        'try:\n'
        '    command.main()\n'
        'except SystemExit:\n'
        '    heavy = {"numpy", "rich", "scipy", "sklearn", "rosbags", "rclpy"}\n'
        '    print("heavy:", *sorted(heavy & set(sys.modules)))'
    )
    asked = {'_FUZZYCNC_COMPLETE': 'complete_bash', 'COMP_WORDS': 'fuzzycnc', 'COMP_CWORD': '1'}
    done = subprocess.run(
        [sys.executable, '-c', script],
        env={**os.environ, 'PYTHONPATH': str(root), **asked},
        capture_output=True,
        text=True,
        check=False,
    )
    *names, last = done.stdout.splitlines()
    assert (names, last, done.stderr) == (list(COMMANDS), 'heavy:', '')


@pytest.mark.parametrize(
    ('line', 'wanted'),
    [
        ('fuzzycnc si', ['simulate']),
        ('fuzzycnc servo st', ['stability']),
        ('fuzzycnc train --mod', ['--model', '--models']),
        (
            'fuzzycnc demo --scenario ',
            ['thermal', 'learn', 'axis', 'contour', 'pattern', 'shift', 'linuxcnc'],
        ),
        ('fuzzycnc demo --scenario = sh', ['shift']),
        ('fuzzycnc train --model lag', ['lag_ridge', 'lag_ridge_speed', 'lag_ridge_drives']),
        ('fuzzycnc compare --models anfis,mlp', ['anfis,mlp', 'anfis,mlp_speed']),
        ('fuzzycnc compare --machine ', ['grinder']),
        ('fuzzycnc evaluate --start 5 --j', ['--jobs', '--json']),
        ('fuzzycnc simulate --duties T2,T', ['T2,T1', 'T2,T3']),
        ('fuzzycnc servo compare --controllers pid,cas', ['pid,cascade']),
        ('fuzzycnc servo stability --controller l', ['linear_tangent']),
        ('fuzzycnc position --controller fixed_universe_', ['fixed_universe_paper']),
        ('fuzzycnc position --sensor ', ['grating', 'encoder']),
        ('fuzzycnc schedule --method j', ['jerk_limited']),
        ('fuzzycnc advise --corners ', ['none', 'feed', 'split']),
        ('fuzzycnc soft train --features p', ['physical', 'paper']),
        ('fuzzycnc machine show ball', ['ballscrew']),
        ('fuzzycnc machine ex', ['excite']),
        ('fuzzycnc machine excite x.ngc --machine-file ball', ['ballscrew']),
        ('fuzzycnc machine excite x.ngc --acc', ['--acceleration']),
        ('fuzzycnc papers l', ['lin2021', 'long2014']),
        ('fuzzycnc schema ', ['devices', 'control', 'machine', 'broker', 'thermal-test', 'probe']),
        ('fuzzycnc operate activate comp', ['compensator']),
        ('fuzzycnc operate set compensator.off', ['compensator.offset_max=']),
        ('fuzzycnc up --nodes compensator,sensor', ['compensator,sensor_selector']),
        ('fuzzycnc import-csv --speed-unit r', ['rpm', 'rad/s']),
    ],
)
def test_bash_is_told_what_fits(proposed, line, wanted):
    assert proposed(line) == wanted


def test_files_of_the_right_kind_are_proposed_beside_the_built_in_machines(proposed, tmp_path):
    (tmp_path / 'mine.yaml').touch()
    (tmp_path / 'mill.txt').touch()
    (tmp_path / 'machines').mkdir()
    assert proposed('fuzzycnc machine show m') == ['mill', 'machines/', 'mine.yaml']


@pytest.mark.parametrize(
    ('shell', 'asked', 'wanted'),
    [
        ('zsh', {'_TYPER_COMPLETE_ARGS': 'fuzzycnc demo --scenario co'}, '(("contour"))'),
        (
            'fish',
            {
                '_TYPER_COMPLETE_ARGS': 'fuzzycnc demo --scenario co',
                '_TYPER_COMPLETE_FISH_ACTION': 'get-args',
            },
            'contour',
        ),
    ],
)
def test_other_shells_are_told_too(proposed, monkeypatch, capsys, shell, asked, wanted):
    from fuzzycnc_ros.cli.main import main

    monkeypatch.setenv('_FUZZYCNC_COMPLETE', f'complete_{shell}')
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        main()
    assert wanted in capsys.readouterr().out


@pytest.mark.parametrize('shell', SHELLS)
def test_the_script_of_each_shell_is_shown_and_installed(
    fuzzycnc, monkeypatch, tmp_path, capsys, shell
):
    monkeypatch.setenv('HOME', str(tmp_path))
    monkeypatch.setattr('typer._completion_shared._get_shell_name', lambda: shell)
    monkeypatch.setattr('typer.completion._get_shell_name', lambda: shell)
    with pytest.raises(SystemExit) as end:
        fuzzycnc('--show-completion')
    script = capsys.readouterr().out
    assert (end.value.code, f'complete_{shell}' in script) == (0, True)
    with pytest.raises(SystemExit) as end:
        fuzzycnc('--install-completion')
    assert end.value.code == 0
    files = [path for path in tmp_path.rglob('*') if path.is_file()]
    assert any(script.strip() in path.read_text() for path in files)


def test_bash_cuts_an_option_at_its_sign_and_other_words_stay():
    line = {'COMP_WORDS': 'fuzzycnc\ndemo\n--out\n=\na\n--scenario\n=\nco', 'COMP_CWORD': '7'}
    join_bash_words(line)
    assert line == {'COMP_WORDS': 'fuzzycnc demo --out a --scenario co', 'COMP_CWORD': '5'}
    line = {'COMP_WORDS': "fuzzycnc\ninfo\n'my bag'", 'COMP_CWORD': '2'}
    before = dict(line)
    join_bash_words(line)
    assert line == before


def test_words_that_the_command_line_keeps_by_itself_are_those_of_the_sources():
    from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
    from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
    from fuzzycnc_ros.core.servo import axis_control
    from fuzzycnc_ros.simulation.thermal.duties import DUTIES
    from fuzzycnc_ros.studies.contour.contouring import CONTOURING_PATHS
    from fuzzycnc_ros.studies.pareto.pareto import KNOBS
    from fuzzycnc_ros.studies.programs.advice import CORNERS

    methods = FeedrateSchedulerConfig.__dataclass_fields__['method'].metadata['choices']
    sensors = LatheAxisConfig.__dataclass_fields__['sensor'].metadata['choices']
    assert options.DUTIES == tuple(DUTIES)
    assert set(pareto.METHODS) == set(KNOBS)
    assert pareto.CURVES == CONTOURING_PATHS
    assert advise.CORNER_CHOICES == CORNERS
    assert set(schedule.METHODS) == set(methods)
    assert servo.SETTINGS == tuple(axis_control.SETTINGS)
    further = (*axis_control.UNIVERSES, axis_control.DISTURBANCE)
    assert servo.SEARCHED == (*servo.SETTINGS, *further)
    assert servo_axis.CHOICES == axis_control.LATHE_CONTROLLERS
    assert set(position.MACHINE_CHOICES) == set(axis_control.AXIS_CONTROLLERS)
    assert position.SENSORS == sensors

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import os
import shlex
import signal
import subprocess
import sys

import pytest
import typer
from processes import HANG, start, wait_for

from fuzzycnc_ros import __version__
from fuzzycnc_ros.cli.application import CommandGroup, manual
from fuzzycnc_ros.cli.main import APPLICATION, COMMANDS


def test_help_lists_every_command_with_its_whole_summary(fuzzycnc):
    outcome = fuzzycnc('--help')
    assert outcome.code == 0
    assert all(name in outcome.out for name in COMMANDS)
    listed = outcome.out.split('Try:')[1]
    assert '...' not in listed
    words = ' '.join(listed.split())
    for name, later in COMMANDS.items():
        assert f'{name} {later.help}' in words
        command = later.load()
        text = manual(command.help if isinstance(command, CommandGroup) else command.__doc__)
        assert ' '.join(text.split('\n\n')[0].split()) == later.help


def test_no_arguments_show_the_help(fuzzycnc):
    assert fuzzycnc().out == fuzzycnc('--help').out


@pytest.mark.parametrize('name', COMMANDS)
def test_every_manual_has_an_example_on_a_line_of_its_own(fuzzycnc, name):
    loaded = COMMANDS[name].load()
    below = loaded.commands if isinstance(loaded, CommandGroup) else ()
    for words in ((name,), *((name, other) for other in below)):
        outcome = fuzzycnc(*words, '--help')
        assert outcome.code == 0
        lines = [line for line in outcome.out.splitlines() if line.startswith('      fuzzycnc ')]
        whole = ' '.join(['fuzzycnc', *words])
        assert any(f'{line.strip()} '.startswith(f'{whole} ') for line in lines), whole


@pytest.mark.parametrize('name', COMMANDS)
def test_every_option_says_what_it_is_and_its_default(name):
    found = typer.main.get_command(APPLICATION.typer).get_command(None, name)
    for command in (found, *getattr(found, 'commands', {}).values()):
        for item in command.params:
            if item.name == 'help':
                continue
            where = f'{command.name} {item.name}'
            assert item.help, where
            hidden = item.default in (None, False, '', (), []) or item.required
            assert hidden or item.show_default or 'default' in item.help, where


def test_types_of_options_are_no_texts():
    """Ubuntu 24.04's typer (0.9) drops what stands behind `Annotated` in a text."""
    for name, later in COMMANDS.items():
        loaded = later.load()
        found = loaded.commands.values() if isinstance(loaded, CommandGroup) else [loaded]
        for function in found:
            texts = [key for key, of in function.__annotations__.items() if isinstance(of, str)]
            assert not texts, f'{name}: {function.__module__}: {texts}'


def test_manual_keeps_the_lines_of_indented_paragraphs_only():
    text = manual("""Do it.

        One line,
        another.

            fuzzycnc a
            fuzzycnc b
        """)
    assert text == 'Do it.\n\nOne line,\nanother.\n\n\b\n    fuzzycnc a\n    fuzzycnc b'


def test_version(fuzzycnc):
    assert fuzzycnc('--version').out == f'fuzzycnc {__version__}\n'


def test_help_loads_nothing_heavy():
    script = (
        'import sys, fuzzycnc_ros.cli.main as command\n'
        'command.run(["--help"])\n'
        "heavy = {'numpy', 'rich', 'scipy', 'sklearn', 'matplotlib', 'rosbags', 'mcap', 'rclpy'}\n"
        'print(*sorted(heavy & set(sys.modules)))'
    )
    done = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, check=False
    )
    assert (done.stdout.splitlines()[-1], done.stderr) == ('', '')


@pytest.mark.parametrize(
    ('typed', 'proposed'),
    [
        ('trian', "; did you mean 'train'?; see `fuzzycnc --help`"),
        ('machine idnetify', "; did you mean 'identify'?; see `fuzzycnc machine --help`"),
        ('measure', "No such command 'measure'; see `fuzzycnc --help`"),
        ('--verson', '--version'),
    ],
)
def test_of_an_unknown_command_the_nearest_is_proposed(refused, typed, proposed):
    refused(*typed.split(), naming=[typed.split()[-1], proposed])


@pytest.mark.parametrize(
    ('typed', 'said'),
    [
        ('--rate 0,5', "'--rate': expected a valid number but found '0,5'; decimals take a point"),
        ('--rate many', "'--rate': expected a valid number but found 'many'; see"),
    ],
)
def test_what_is_no_number_is_shown(refused, typed, said):
    refused('up', *typed.split(), naming=[said])


def test_misspelt_option_gets_a_proposal(refused):
    refused('simulate', '--sede', '3', naming=['--sede', '--seed', 'fuzzycnc simulate --help'])


@pytest.mark.parametrize(
    ('typed', 'wrong'),
    [('replay', 'BAG'), ('servo tune --axis', '--axis'), ('up --rate', '--rate')],
)
def test_what_is_missing_is_in_the_manual_of_the_command(refused, typed, wrong):
    command = ' '.join(word for word in typed.split() if not word.startswith('-'))
    refused(*typed.split(), naming=[wrong, f'; see `fuzzycnc {command} --help`'])


@pytest.mark.parametrize('place', [0, 1, 2])
def test_debug_shows_the_traceback_wherever_it_stands(fuzzycnc, place):
    words = ['info', 'nothing_here']
    words.insert(place, '--debug')
    outcome = fuzzycnc(*words)
    assert outcome.code == 2
    assert 'Traceback' in outcome.err
    assert outcome.err.splitlines()[-1].startswith('error: nothing_here')


def test_interrupt_ends_with_130_and_one_line(fuzzycnc, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr('fuzzycnc_ros.replay.replay.replay', interrupted)
    outcome = fuzzycnc('replay', 'shift')
    assert outcome.code == 130
    assert outcome.err.split() == ['interrupted']


def test_ctrl_c_in_the_middle_of_work(tmp_path, root):
    command = [sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'simulate', '--seeds', '1000']
    environment = {**os.environ, 'PYTHONPATH': str(root)}
    pipes = {'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, 'text': True}
    with start([*command, '--out', 'shift'], cwd=tmp_path, env=environment, **pipes) as process:
        calibration = tmp_path / 'shift_calibration'
        wait_for(lambda: calibration.exists() or process.poll() is not None, 'it works')
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=HANG)
    assert process.returncode == 130
    assert (out, err.splitlines()[-1]) == ('', 'interrupted')
    assert 'Traceback' not in err


GROUPS = ('servo', 'soft')
"""Commands that have commands of their own."""


def commands_in(path):
    """Return the command lines of a page, continued lines joined."""
    text = path.read_text().replace('\\\n', ' ')
    return [line.strip() for line in text.splitlines() if line.strip().startswith('fuzzycnc ')]


@pytest.mark.parametrize(
    'page', ['docs/tutorials/your-own-recording.md', 'docs/reference/bags.md']
)
def test_command_lines_in_the_docs_use_options_that_exist(fuzzycnc, root, page):
    lines = commands_in(root / page)
    assert lines
    for line in lines:
        _, *words = shlex.split(line, comments=True)
        names = words[: 1 + (words[0] in GROUPS)]
        help_text = fuzzycnc(*names, '--help').out
        options = [word.partition('=')[0] for word in words if word.startswith('--')]
        assert [option for option in options if f'{option} ' not in help_text] == [], line


def test_a_fault_of_the_programme_is_one_line_too(refused, monkeypatch):
    def broken(*_, **__):
        raise TypeError('two\nlines')

    monkeypatch.setattr('fuzzycnc_ros.replay.replay.replay', broken)
    refused('replay', 'shift', naming=['TypeError: two lines', '--debug'])


def test_a_missing_library_is_named_with_its_remedy(refused, monkeypatch, bag, model):
    monkeypatch.setitem(sys.modules, 'jinja2', None)
    refused(
        'evaluate', bag(), '--model', model, '--report', 'r.html', naming=['jinja2', 'install']
    )


def test_output_into_a_folder_that_is_not_there(refused):
    refused('simulate', '--json', 'no/such.json', naming=['no/such.json', 'existing folder'])

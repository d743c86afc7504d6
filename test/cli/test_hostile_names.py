# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Names that would steer a terminal or a page are shown as they are, in every command."""

import io
import json
import unicodedata
from html.parser import HTMLParser
from pathlib import Path

import fuzzing.raw_bags as raw
import pytest
from rich import table as rich_table
from rich.progress import Progress
from small_recordings import warm_up

from fuzzycnc_ros.cli import console
from fuzzycnc_ros.cli.terminal import Description, Terminal
from fuzzycnc_ros.core.names import CONTROLS
from fuzzycnc_ros.studies.page.table import Column, Table

TITLE, CLEAR, TURNED, MARKUP = '\x1b]0;title\x07', '\x1b[2J', '\u202egnp', '[red]'
SHOWN = (r'\x1b]0;title\x07', r'\x1b[2J', r'\u202egnp', MARKUP)
SENSORS = {
    't1': f't1{TITLE}{MARKUP}',
    't2': f't2{CLEAR}',
    't3': f't3{TURNED} 温度 <i>&amp; $\\bad$',
}
CHANNEL = f'dz{TITLE}{CLEAR}{TURNED}[/red]{MARKUP}\x9b7m'


def controls(text: str) -> list[str]:
    """Return the lines with a control character besides their ends."""
    return [
        line
        for line in text.split('\n')
        if any(unicodedata.category(character) in CONTROLS for character in line)
    ]


@pytest.fixture
def hostile(fuzzycnc, table):
    """A bag made of a table whose columns have names that steer terminals, and what was said."""
    file = table('log.csv', {SENSORS.get(k, k): v for k, v in warm_up().items() if k != 'dz'} | {
        CHANNEL: warm_up()['dz']
    })  # fmt: skip
    options = ('--time', 't', '--temperature', 't*', '--displacement', f'{CHANNEL}=Z:um')
    return Path('log'), fuzzycnc('import-csv', file, '--out', 'log', *options)


def test_import_train_evaluate_replay_and_the_page(fuzzycnc, hostile):
    bag, imported = hostile
    said = [
        imported,
        fuzzycnc('info', bag),
        fuzzycnc('train', bag, '--out', 'm.json', '--json', 'train.json'),
        fuzzycnc('evaluate', bag, '--model', 'm.json', '--report', 'page.html'),
        fuzzycnc('replay', '--hash', bag),
    ]
    assert [outcome.code for outcome in said] == [0] * len(said), said[3]
    for outcome in said:
        assert not controls(outcome.out + outcome.err)
    for outcome in said[2:4]:
        assert all(text in outcome.out for text in SHOWN)
    # Figures keep the names as they are: JSON spells out by itself.
    trained = json.loads(Path('train.json').read_text())
    assert set(trained['sensors']) <= set(SENSORS.values())
    page = Path('page.html').read_text()
    assert not controls(page)
    assert all(text in page for text in SHOWN)
    tags = Tags()
    tags.feed(page)
    assert 'i' not in tags.seen
    assert r'$\bad$' in page


class Tags(HTMLParser):
    """Collects the names of all elements."""

    def __init__(self):
        super().__init__()
        self.seen = set()

    def handle_starttag(self, tag, attrs):
        self.seen.add(tag)


def test_topics_types_and_attachments(fuzzycnc, tmp_path):
    kind = f'std_msgs/msg/String{CLEAR}'
    file = raw.mcap(
        tmp_path / 'bag.mcap',
        [
            raw.schema(1, kind),
            raw.channel(1, f'/a{TITLE}{MARKUP}\nproblem: none'),
            raw.message(1, 10**9),
            raw.attachment(f'note{TURNED}\x7f', b'{}'),
        ],
    )
    outcome = fuzzycnc('info', file)
    assert not controls(outcome.out + outcome.err)
    assert all(text in outcome.out + outcome.err for text in SHOWN), outcome
    assert '\nproblem: none' not in outcome.out
    for words in (
        ('info', '--repair', file, 'whole'),
        ('replay', file),
        ('replay', '--hash', file),
    ):
        outcome = fuzzycnc(*words)
        assert outcome.out + outcome.err
        assert not controls(outcome.out + outcome.err)


@pytest.mark.parametrize('debug', [(), ('--debug',)])
def test_errors(fuzzycnc, debug):
    for words in (
        ('info', f'none{TITLE}{TURNED}'),
        ('train', f'none{CLEAR}{MARKUP}', '--out', 'm.json'),
        ('import-csv', 'none.csv', '--out', 'o', f'--{TITLE}'),
    ):
        outcome = fuzzycnc(*words, *debug)
        assert outcome.code == 2
        assert not controls(outcome.err)
        assert '\\x1b' in outcome.err


NAME = f'T1{TITLE}{CLEAR}{TURNED}{MARKUP}[bold]:smile:'
SHOWN_NAME = f'T1{"".join(SHOWN)}[bold]:smile:'


def test_a_table_on_a_terminal(monkeypatch):
    file = io.StringIO()
    terminal = Terminal(file=file, width=200, color_system=None, force_terminal=True)
    monkeypatch.setattr('sys.stdout.isatty', lambda: True, raising=False)
    monkeypatch.setattr('fuzzycnc_ros.cli.terminal.Terminal', lambda: terminal)
    columns = (Column(NAME, 'group', numeric=False), Column('n'))
    console.show(Table(f'title {NAME}', columns, ((f'{NAME}\n', '1'),)))
    shown = file.getvalue()
    assert shown.count(SHOWN_NAME) == 3
    assert not controls(shown)


def test_a_live_table_on_a_terminal():
    """As that of `fuzzycnc up`, whose cells are plain text for rich to read."""
    file = io.StringIO()
    shown = rich_table.Table('trouble', box=None)
    shown.add_row(NAME, style='red')
    Terminal(file=file, width=200, color_system=None, force_terminal=True).print(shown)
    assert r'T1\x1b]0;title\x1b[2J\u202egnp[red' in file.getvalue()
    assert not controls(file.getvalue())


def test_lines_and_bars_on_a_terminal():
    file = io.StringIO()
    terminal = Terminal(file=file, width=200, color_system=None, force_terminal=True)
    terminal.print(NAME, style='yellow')
    # What no terminal shows, such as a bell, rich leaves out of plain text by itself.
    without_bell = SHOWN_NAME.replace('\\x07', '')
    assert file.getvalue() == f'{without_bell}\n'
    file.truncate(0)
    with Progress(Description(), console=terminal) as bar:
        bar.add_task(NAME)
    assert SHOWN_NAME in file.getvalue()
    assert TITLE not in file.getvalue()
    assert TURNED not in file.getvalue()

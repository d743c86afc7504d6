# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import io
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fuzzycnc_ros.cli.console import (
    check_at_least,
    check_folder,
    check_new,
    fits_terminal,
    fitting,
    show,
    words,
    write_json,
    write_text,
)
from fuzzycnc_ros.studies.page.table import Column, Table

GROUPS = [f'T{run} {axis}' for run in (2, 3) for axis in 'YZ']
TABLE = Table(
    'Residual',
    (
        Column('Model', numeric=False),
        *(Column(figure, group) for group in GROUPS for figure in ('max', 'rms')),
    ),
    (
        ('Uncompensated', *(f'{number}.5' for number in range(11, 19))),
        ('As applied on the machine', *(f'{number}.25' for number in range(21, 29))),
    ),
    strong=frozenset({(1, 1), (0, 8)}),
    highlight=frozenset({1}),
)


def printed(table: Table, width: int) -> tuple[int, str]:
    """Return the parts of a table on a terminal of some width, and their text."""
    console = Console(file=io.StringIO(), width=width)
    parts = fitting(table, partial(fits_terminal, console=console))
    for part in parts:
        console.print(part.to_rich())
    return len(parts), console.file.getvalue()


@pytest.mark.parametrize('width', [60, 80, 100, 200])
def test_no_figure_is_cut_short_however_narrow_the_terminal(width):
    _, text = printed(TABLE, width)
    assert '…' not in text
    assert all(number in text for row in TABLE.rows for number in row[1:])
    assert all(word in text for row in TABLE.rows for word in row[0].split())


def test_a_table_that_fits_stays_whole():
    assert printed(TABLE, 200)[0] == 1
    assert printed(TABLE, 80)[0] == 2
    assert fitting(TABLE, lambda part: True) == [TABLE]


def test_parts_hold_whole_runs_where_they_can():
    parts = fitting(TABLE, partial(fits_terminal, console=Console(width=75)))
    assert [[c.group for c in part.columns[1:]] for part in parts] == [
        ['T2 Y', 'T2 Y', 'T2 Z', 'T2 Z'],
        ['T3 Y', 'T3 Y', 'T3 Z', 'T3 Z'],
    ]


def test_parts_keep_groups_and_emphasis():
    parts = fitting(TABLE, partial(fits_terminal, console=Console(width=45)))
    assert [part.columns[1].group for part in parts] == GROUPS
    assert parts[0].strong == {(1, 1)}
    assert parts[-1].strong == {(0, 2)}
    assert all(part.highlight == {1} for part in parts)


LONG = Table(
    'Nodes',
    (Column('Node', numeric=False), Column('Rate [1/s]'), Column('Trouble', numeric=False)),
    (
        ('compensator', '10.0', 'the predictor is silent; ' * 6 + 'the offsets ramp to zero'),
        ('thermal_predictor', '0.1', ''),
    ),
)
UNGROUPED = Table(
    'Figures',
    (Column('Case', numeric=False), *(Column(f'quantity {n} [um]') for n in range(12))),
    (('step', *(f'{n}.25' for n in range(12))),),
)
HASHES = Table(
    'Hashes',
    (Column('Topic', numeric=False), Column('SHA-256', numeric=False)),
    (('/mill/compensation_applied', 64 * 'f'),),
)


@pytest.mark.parametrize('columns', [80, 100])
@pytest.mark.parametrize('table', [TABLE, LONG, UNGROUPED, HASHES])
def test_in_a_pipe_a_line_has_as_many_characters_as_columns(monkeypatch, capsys, table, columns):
    monkeypatch.setenv('COLUMNS', str(columns))
    show(table)
    lines = capsys.readouterr().out.splitlines()
    wide = max(table.least_width(), columns) if table is HASHES else columns
    assert max(map(len, lines)) <= wide
    text = ' '.join(' '.join(lines).split())
    numbers = [row[c] for row in table.rows for c, col in enumerate(table.columns) if col.numeric]
    assert all(number in text.split() for number in numbers)
    assert all(word in text for row in table.rows for cell in row for word in cell.split())


def test_without_columns_a_pipe_has_a_hundred(monkeypatch, capsys):
    monkeypatch.delenv('COLUMNS', raising=False)
    show(LONG)
    assert 80 < max(map(len, capsys.readouterr().out.splitlines())) <= 100


def test_text_takes_several_lines_on_a_terminal_too():
    parts, text = printed(LONG, 100)
    assert parts == 1
    assert '…' not in text
    assert all(word in text for word in LONG.rows[0][2].split())


def test_a_table_of_one_column_is_shown():
    table = Table('Names', (Column('Name', numeric=False),), (('a',),))
    assert fitting(table, lambda part: False) == [table]


def test_figures_that_json_does_not_know_become_null(tmp_path):
    path = tmp_path / 'f.json'
    write_json(path, {'a': float('nan'), 'b': (np.float64(1.5), np.inf), 3: Path('x')})
    assert json.loads(path.read_text()) == {'a': None, 'b': [1.5, None], '3': 'x'}


def test_a_file_is_replaced_as_a_whole_or_not_at_all(tmp_path):
    path = tmp_path / 'f.txt'
    write_text(path, 'old')
    with pytest.raises(UnicodeEncodeError):
        write_text(path, 'new' * 10_000 + '\udc80')
    assert path.read_text() == 'old'
    assert [item.name for item in tmp_path.iterdir()] == ['f.txt']
    write_text(path, 'new')
    assert path.read_text() == 'new'


def test_checks_name_the_output_and_the_remedy(tmp_path):
    with pytest.raises(ValueError, match='it exists; choose another one or add --force'):
        check_new(tmp_path, 'add --force')
    with pytest.raises(ValueError, match='expected an existing folder'):
        check_folder(tmp_path / 'a' / 'b')
    with pytest.raises(ValueError, match='--seeds: expected 1 or more but found 0'):
        check_at_least('--seeds', 0, 1)
    with pytest.raises(ValueError, match='found nan'):
        check_at_least('--duration', float('nan'), 0.0)
    for check in (check_new, check_folder):
        check(None)
        check(tmp_path / 'new')


def test_words_may_be_repeated_or_joined_by_commas():
    assert words(['a, b', 'c', '', ',d']) == ('a', 'b', 'c', 'd')

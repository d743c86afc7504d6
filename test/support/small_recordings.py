# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Small recordings to run the command line on; a `conftest.py` imports the fixtures by name."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from kept import kept


def warm_up(rows: int = 120, interval: float = 60.0) -> dict[str, np.ndarray]:
    """Return the columns of a machine that warms up and cools down."""
    time = interval * np.arange(rows)
    half = time[-1] / 2
    heat = np.where(time < half, 1 - np.exp(-time / 1800), np.exp(-(time - half) / 1800))
    rng = np.random.default_rng(1)
    columns = {'t': time}
    for number, gain in enumerate((8.0, 5.0, 3.0), start=1):
        columns[f't{number}'] = 20.0 + gain * heat + 0.05 * rng.standard_normal(rows)
    columns['dz'] = 12.0 * heat + 0.1 * rng.standard_normal(rows)
    return columns


def write_table(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """Write columns as a CSV file."""
    lines = [','.join(columns)]
    lines += [
        ','.join(f'{value:.6f}' for value in row)
        for row in np.column_stack(list(columns.values()))
    ]
    path.write_text('\n'.join(lines) + '\n')
    return path


@pytest.fixture
def table(tmp_path):
    """Write a CSV recording: `table()`, or with other columns."""

    def write(name: str = 'log.csv', columns: dict[str, np.ndarray] | None = None, **warming):
        return write_table(tmp_path / name, columns or warm_up(**warming))

    return write


IMPORT = ('--time', 't', '--temperature', 't*', '--displacement', 'dz=Z:um')
"""Options that read the table."""


@pytest.fixture
def bag(fuzzycnc, table):
    """Return a bag of the table, and make others: `bag('other', rows=60)`."""

    def imported(name: str = 'log', *options, **warming) -> Path:
        file = table(f'{name}.csv', **warming)
        outcome = fuzzycnc('import-csv', file, '--out', name, *IMPORT, *options)
        assert outcome.code == 0, outcome
        return Path(name)

    return imported


@kept
def model_text() -> str:
    """Return a model trained on the table."""
    from fuzzycnc_ros.cli.main import run

    with TemporaryDirectory() as name:
        folder = Path(name)
        file = write_table(folder / 'training.csv', warm_up())
        assert run(['import-csv', str(file), '--out', str(folder / 'training'), *IMPORT]) == 0
        out = folder / 'model.json'
        assert run(['train', str(folder / 'training'), '--out', str(out)]) == 0
        return out.read_text(encoding='utf-8')


@pytest.fixture
def model(bag):
    """Return a model trained on the table, beside the bag of it."""
    bag('training')
    path = Path('model.json')
    path.write_text(model_text(), encoding='utf-8')
    return path

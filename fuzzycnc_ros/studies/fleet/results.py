# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The table of a fleet: a row per bag, model and channel, in a Parquet file."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fuzzycnc_ros.files.atomic import whole_file
from fuzzycnc_ros.studies.requirement import require

Row = dict[str, Any]

ROWS = 2000
"""Rows that are held before they are written together."""

TEXT, WHOLE, NUMBER = 'string', 'int64', 'float64'

COLUMNS: dict[str, tuple[str, str]] = {
    'bag': (TEXT, 'Name of the bag.'),
    'path': (TEXT, 'Its path.'),
    'bag_sha256': (TEXT, 'Hash of its content.'),
    'machine': (TEXT, 'Machine that it is of.'),
    'begin': ('timestamp', 'Time of its first message; from 1970 where it counts from a start.'),
    'duration_s': (NUMBER, 'From its first message to its last [s].'),
    'model': (TEXT, 'What the model is called.'),
    'model_hash': (TEXT, 'SHA-256 of the text of the model file.'),
    'channel': (TEXT, 'Displacement channel; absent where nothing could be judged.'),
    'axis': (TEXT, 'Axis of the channel.'),
    'candidate': (TEXT, 'What of the model predicts the channel.'),
    'samples': (WHOLE, 'Samples that were measured and judged.'),
    'uncompensated_rms_um': (NUMBER, 'Root mean square thermal error [um].'),
    'uncompensated_max_um': (NUMBER, 'Largest thermal error [um].'),
    'rms_um': (NUMBER, 'RMS residual of the model [um]; infinite: diverged.'),
    'max_um': (NUMBER, 'Largest residual [um].'),
    'held_out_rms_um': (NUMBER, 'Residual on held-out samples of its training [um].'),
    'in_domain': (NUMBER, 'Share of the samples in the domain of the training [-].'),
    'covered': (NUMBER, 'Share of the residuals within the band of two standard deviations [-].'),
    'band_um': (NUMBER, 'Root mean square half width of that band [um].'),
    'independent': (NUMBER, 'How many independent residuals those are as good as [-].'),
    'band_ratio': (NUMBER, 'Root mean square of the residuals over the deviation [-].'),
    'trained_on': (NUMBER, 'Share of the samples that the model was trained on [-].'),
    'warm': ('texts', 'Inputs of the model that did not start cold.'),
    'sensors': (
        'sensors',
        'Sensors of the bag: shares of samples that are missing, that other sensors stand in for '
        'and that straight lines bridge [-].',
    ),
    'version': (TEXT, 'Version of fuzzycnc that computed the row, and of its code.'),
    'problem': (TEXT, 'Why nothing could be judged.'),
}
"""Column -> kind and meaning."""


def schema() -> Any:
    """Return the columns as Arrow has them.

    Raises
    ------
    ModuleNotFoundError
        If pyarrow is not installed; the message says how to install it.
    """
    arrow = require('pyarrow')
    share = [(name, arrow.float64()) for name in ('missing', 'substituted', 'bridged')]
    kinds = {
        TEXT: arrow.string(),
        WHOLE: arrow.int64(),
        NUMBER: arrow.float64(),
        'timestamp': arrow.timestamp('ns', tz='UTC'),
        'texts': arrow.list_(arrow.string()),
        'sensors': arrow.list_(arrow.struct([('sensor', arrow.string()), *share])),
    }
    return arrow.schema(
        [
            arrow.field(name, kinds[kind], metadata={'description': text})
            for name, (kind, text) in COLUMNS.items()
        ]
    )


class TableWriter:
    """Takes rows and writes them in blocks, so that memory does not grow."""

    def __init__(self, file: Any) -> None:
        self._arrow, self._schema = require('pyarrow'), schema()
        self._file = file
        self._rows: list[Row] = []

    def add(self, rows: Sequence[Row]) -> None:
        """Take some rows."""
        self._rows += rows
        if len(self._rows) >= ROWS:
            self.flush()

    def flush(self) -> None:
        """Write what was taken."""
        if self._rows:
            self._file.write_table(self._arrow.Table.from_pylist(self._rows, self._schema))
            self._rows = []


@contextmanager
def new_table(path: Path) -> Iterator[TableWriter]:
    """Write a Parquet file as a whole: after an error or a kill it is the old one or none.

    Raises
    ------
    OSError
        If it cannot be written.
    ModuleNotFoundError
        If pyarrow is not installed; the message says how to install it.
    """
    parquet, columns = require('pyarrow.parquet'), schema()
    with whole_file(path) as draft:
        with parquet.ParquetWriter(draft, columns, compression='zstd') as file:
            writer = TableWriter(file)
            yield writer
            writer.flush()


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a table that `fuzzycnc fleet evaluate` wrote.

    Raises
    ------
    ValueError
        If it is no such table.
    OSError
        If it cannot be read.
    ModuleNotFoundError
        If pyarrow is not installed; the message says how to install it.
    """
    arrow, parquet = require('pyarrow'), require('pyarrow.parquet')
    try:
        table = parquet.read_table(path)
    except (arrow.ArrowInvalid, arrow.ArrowNotImplementedError) as error:
        raise ValueError(f'{path}: expected a Parquet file but {_first_line(error)}') from None
    missing = [name for name in COLUMNS if name not in table.column_names]
    if missing:
        raise ValueError(
            f'{path}: expected a table of `fuzzycnc fleet evaluate` but it has no '
            f'{", ".join(missing)}; evaluate the bags anew'
        )
    index = table.schema.get_field_index('begin')
    # Python's own times end at microseconds; nanoseconds would need pandas.
    table = table.set_column(index, 'begin', table['begin'].cast(arrow.int64()))
    rows: list[Row] = table.to_pylist()
    return rows


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]

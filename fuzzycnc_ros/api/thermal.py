# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal error: read recordings, train, predict, compare and plot.

Examples
--------
>>> from fuzzycnc_ros import thermal
>>> from fuzzycnc_ros.simulation.thermal.duties import record_runs
>>> first, second = record_runs(['T1', 'T2']).values()
>>> model = thermal.train([first], candidates=['lag_ridge'])
>>> judged = thermal.evaluate(model, second)
>>> residual = thermal.residual(model, second)
>>> residual.shape == second.displacement.shape
True
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.bags.runs import read_run as read_bag
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.remedies import options_as
from fuzzycnc_ros.core.thermal.fit import evaluate, train_model
from fuzzycnc_ros.core.thermal.fit.comparison import HeldOut, judge, splits
from fuzzycnc_ros.core.thermal.model import ThermalModel, load_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.files.atomic import write_text
from fuzzycnc_ros.papers.thermal import ALL_CONTENDERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

__all__ = [
    'compare',
    'evaluate',
    'load_model',
    'plot_residual',
    'plot_run',
    'read_run',
    'residual',
    'save_model',
    'to_dataframe',
    'train',
]

train = train_model


def read_run(path: str | os.PathLike[str], **options: Any) -> ThermalRun:
    r"""Read a recording: a bag, or a CSV file with one row per sample.

    Parameters
    ----------
    path : path
        A bag (folder or file), or a file that ends in `.csv`.
    **options
        Of a bag those of `fuzzycnc_ros.bags.runs.read_run`, such as `start`, `stop` and
        `namespace`; of a CSV file those of `fuzzycnc_ros.bags.csv_mapping.CsvMapping`, such as
        `time`, `temperatures` and `displacements`.

    Returns
    -------
    ThermalRun
        Time [s], temperatures [degC] and displacements [m].

    Raises
    ------
    BagError
        If the bag cannot be read or used.
    CsvError
        If the file cannot be used; the message names line and column.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fuzzycnc_ros import thermal
    >>> rows = ['time,spindle,z'] + [f'{60 * k},{20 + 0.1 * k},{0.2 * k}' for k in range(60)]
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / 'monday.csv'
    ...     _ = path.write_text('\n'.join(rows))
    ...     run = thermal.read_run(path, temperatures=['spindle'], displacements=['z=Z:um'])
    >>> run.sensor, run.displacement.shape
    (('spindle',), (60, 1))
    """
    source = Path(path)
    if source.suffix.lower() != '.csv':
        return read_bag(source, **options)
    from fuzzycnc_ros.bags.csv_import import read_csv
    from fuzzycnc_ros.bags.csv_mapping import CsvMapping

    with options_as(_argument):
        return read_csv(source, CsvMapping(**options)).run()


def save_model(model: ThermalModel, path: str | os.PathLike[str]) -> None:
    """Write a model as a file, as `fuzzycnc train` does, for nodes, commands and `load_model`.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    write_text(Path(path), model.to_json())


_ARGUMENTS = {
    'temperature': 'temperatures',
    'displacement': 'displacements',
    'speed': 'spindle_speed',
    'speed-unit': 'spindle_speed_unit',
    'no-header': 'header=False',
    'zero': 'zero=True',
}
"""Options of `fuzzycnc import-csv` -> arguments that are called otherwise."""


def _argument(option: str) -> str:
    return _ARGUMENTS.get(option, option.replace('-', '_'))


def to_dataframe(run: ThermalRun) -> DataFrame:
    """Return a run as a pandas table, indexed by time [s].

    Columns are (quantity, name): `temperature` [degC] by sensor, `displacement` [m] by channel
    and, where they were recorded, `spindle_speed` [rad/s] and `drive` by name, see `ThermalRun`.

    Raises
    ------
    ModuleNotFoundError
        If pandas is not installed.

    Examples
    --------
    >>> from fuzzycnc_ros import thermal
    >>> from fuzzycnc_ros.simulation.thermal.duties import record_runs
    >>> table = thermal.to_dataframe(record_runs(['T1'])['T1'])
    >>> table.columns[0]
    ('temperature', 'T1')
    """
    import pandas

    columns = [('temperature', name) for name in run.sensor]
    columns += [('displacement', name) for name in run.channel]
    values = [run.temperature, run.displacement]
    if run.spindle_speed is not None:
        columns.append(('spindle_speed', ''))
        values.append(run.spindle_speed[:, np.newaxis])
    columns += [('drive', name) for name in run.drives]
    values += [column[:, np.newaxis] for column in run.drives.values()]
    return pandas.DataFrame(
        np.hstack(values),
        index=pandas.Index(run.time, name='time'),
        columns=pandas.MultiIndex.from_tuples(columns, names=['quantity', 'name']),
    )


def compare(
    runs: Sequence[ThermalRun], candidates: Iterable[str] = ('static_ridge', 'lag_ridge')
) -> list[HeldOut]:
    """Train every candidate on all runs but one, and judge it on that one, for each run.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Runs of one machine; a single one is cut into stretches.
    candidates : iterable of str
        Names, as `fuzzycnc_ros.papers.names.COMPARED` lists them.

    Returns
    -------
    list of HeldOut
        What was held out, and the residuals of each candidate and of no compensation there.
    """
    names = tuple(candidates)
    return [judge(split, candidates=names, contenders=ALL_CONTENDERS) for split in splits(runs)]


def residual(model: ThermalModel, run: ThermalRun, candidate: str | None = None) -> Array:
    """Return what a model leaves of the thermal error, shape (n, c) [m]; NaN without a probe.

    Parameters
    ----------
    model : ThermalModel
        Has the channels of the run.
    run : ThermalRun
        Sampled at the interval of the model.
    candidate : str, optional
        Another model in the file than the chosen one.

    Examples
    --------
    >>> from fuzzycnc_ros import thermal
    >>> from fuzzycnc_ros.simulation.thermal.duties import record_runs
    >>> first, second = record_runs(['T1', 'T2']).values()
    >>> model = thermal.train([first], candidates=['lag_ridge'])
    >>> left = thermal.residual(model, second)
    >>> bool(abs(left).max() < 0.5 * abs(second.displacement).max())
    True
    """
    at = [run.channel.index(name) for name in model.channel]
    return np.asarray(run.displacement[:, at] - model.predict(run, candidate))


def plot_run(run: ThermalRun, axes: Axes, sensors: Sequence[str] = ()) -> Axes:
    """Draw the displacements of a run [um] over time [min], and temperatures on a second scale.

    Parameters
    ----------
    run : ThermalRun
        The run.
    axes : matplotlib.axes.Axes
        What is drawn on.
    sensors : sequence of str
        Sensors whose temperatures [degC] are drawn, dashed; none by default.

    Returns
    -------
    matplotlib.axes.Axes
        The same.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from fuzzycnc_ros import thermal
    >>> from fuzzycnc_ros.simulation.thermal.duties import record_runs
    >>> axes = thermal.plot_run(record_runs(['T1'])['T1'], Figure().subplots())
    >>> len(axes.lines)
    2
    """
    _lines(axes, run.time, dict(zip(run.channel, 1e6 * run.displacement.T, strict=True)))
    axes.set_ylabel('displacement [µm]')
    if sensors:
        other = axes.twinx()
        for name in sensors:
            other.plot(
                run.time / 60.0, run.temperature[:, run.sensor.index(name)], '--', label=name
            )
        other.set_ylabel('temperature [°C]')
        other.legend(loc='lower right')
    axes.set_title(run.name)
    return axes


def plot_residual(model: ThermalModel, run: ThermalRun, axes: Axes) -> Axes:
    """Draw what a model leaves of the thermal error [um] over time [min], and the error in grey.

    Parameters
    ----------
    model : ThermalModel
        Has the channels of the run.
    run : ThermalRun
        Sampled at the interval of the model; it should be none of its training.
    axes : matplotlib.axes.Axes
        What is drawn on.

    Returns
    -------
    matplotlib.axes.Axes
        The same.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from fuzzycnc_ros import thermal
    >>> from fuzzycnc_ros.simulation.thermal.duties import record_runs
    >>> first, second = record_runs(['T1', 'T2']).values()
    >>> model = thermal.train([first], candidates=['lag_ridge'])
    >>> axes = thermal.plot_residual(model, second, Figure().subplots())
    >>> len(axes.lines)
    4
    """
    at = [run.channel.index(name) for name in model.channel]
    axes.plot(run.time / 60.0, 1e6 * run.displacement[:, at], color='0.7', linewidth=1.0)
    left = residual(model, run)
    _lines(axes, run.time, dict(zip(model.channel, 1e6 * left.T, strict=True)))
    axes.set_ylabel('residual [µm], without compensation in grey')
    axes.set_title(run.name)
    return axes


def _lines(axes: Axes, time: Array, lines: Mapping[str, Array]) -> None:
    for name, values in lines.items():
        axes.plot(time / 60.0, values, label=name)
    axes.set_xlabel('time [min]')
    axes.legend(loc='upper left')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
r"""Thousands of bags of many machines: judge them with any executor, and see what they say.

Examples
--------
>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from fuzzycnc_ros import fleet, thermal
>>> from fuzzycnc_ros.bags.csv_import import import_csv
>>> from fuzzycnc_ros.bags.csv_mapping import CsvMapping
>>> rows = ['time,spindle,z'] + [f'{60 * k},{20 + 0.1 * k},{0.2 * k}' for k in range(60)]
>>> mapping = CsvMapping(temperatures=['spindle'], displacements=['z=Z:um'])
>>> with TemporaryDirectory() as name:
...     folder = Path(name)
...     _ = (folder / 'monday.csv').write_text('\n'.join(rows))
...     _ = import_csv(folder / 'monday.csv', folder / 'monday', mapping)
...     model = thermal.train([thermal.read_run(folder / 'monday')], candidates=['static_ridge'])
...     _ = (folder / 'mill.json').write_text(model.to_json())
...     summary = fleet.evaluate([folder / 'monday'], [folder / 'mill.json'], folder / 'o.parquet')
...     condition = fleet.condition(folder / 'o.parquet')
>>> summary.rows, condition.bags
(1, 1)
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.studies.fleet.condition import ShopCondition, shop_condition
from fuzzycnc_ros.studies.fleet.evaluation import FleetSummary, evaluate_fleet, read_models
from fuzzycnc_ros.studies.fleet.in_flight import IN_FLIGHT, Crew, only
from fuzzycnc_ros.studies.fleet.results import read_rows

__all__ = ['ShopCondition', 'condition', 'evaluate']

Place = str | os.PathLike[str]


def evaluate(
    bags: Iterable[Place],
    models: Iterable[Place],
    out: Place,
    *,
    executor: Executor | None = None,
    in_flight: int = IN_FLIGHT,
    **options: Any,
) -> FleetSummary:
    """Judge bags with models and write a Parquet table, a row per bag, model and channel.

    Parameters
    ----------
    bags : iterable of path
        Bags, folders of bags, or patterns.
    models : iterable of path
        Model files, or folders of models that are called as their machines.
    out : path
        Table to write.
    executor : Executor, optional
        Who judges, such as a `ProcessPoolExecutor`, or what `get_executor(pure=False)` of a
        client of Dask returns; this process if absent.
    in_flight : int
        Bags that it has at a time, about twice as many as workers.
    **options
        Those of `fuzzycnc_ros.studies.fleet.evaluation.evaluate_fleet`: `machine_by`, `cache`
        and `tell`.

    Returns
    -------
    FleetSummary
        How many were judged, and what could not be used.

    Raises
    ------
    ValueError
        If there is no usable model, a pattern fits nothing, or the workers are gone.
    ModuleNotFoundError
        If pyarrow is not installed; the message says how to install it.
    """
    found, broken = read_models([Path(place) for place in models])
    crew = None if executor is None else Crew(only(executor), in_flight)
    named = find_bags([Path(place) for place in bags])
    summary = evaluate_fleet(named, found, Path(out), crew=crew, **options)
    summary.problems[:0] = broken
    return summary


def condition(table: Place) -> ShopCondition:
    """Return which machine drifts, which model is stale, which sensor fails, most urgent first.

    Parameters
    ----------
    table : path
        Table that `evaluate` wrote.

    Raises
    ------
    ValueError
        If it is no such table, or empty.
    """
    return shop_condition(read_rows(Path(table)))

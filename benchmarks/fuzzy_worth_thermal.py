# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the fuzzy parts of the thermal systems are worth, held out, on machines of many kinds.

Two tables, a line per machine (the machines are those of `thermal_machines.py`):

- sensors: lagged ridge on five sensors chosen by fuzzy clustering, and on five of the largest
  plain correlation with the displacements, over lagged ridge on all sensors;
- models: stable grey, ANFIS, stable grey with ANFIS on its residual and the hybrid filter network,
  over lagged ridge, all on the sensors that training takes by itself.

A figure is the residual's root mean square over that of the reference, the geometric mean over the
channels, and in brackets the lowest and highest of single held-out runs: below 1 the part is worth
having.  A `+` means better, a `-` worse than the reference by more than chance, a t-test over the
logarithms of the runs' ratios at 95 % on either side.

Run with `python benchmarks/fuzzy_worth_thermal.py [--recordings DIR] [--markdown FILE]`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import stdtrit
from thermal_machines import (
    CONFIDENCE,
    Failure,
    Piece,
    asked,
    geometric_mean,
    in_processes,
    show,
    sorted_out,
    table,
)

from fuzzycnc_ros.cli.console import write_json
from fuzzycnc_ros.cli.workers import Progress
from fuzzycnc_ros.core.thermal.fit import evaluate
from fuzzycnc_ros.core.thermal.fit.training import SENSORS_MAX, at_interval, train_model
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun

CHOSEN = 5
"""Sensors that are chosen."""

PLAIN = 'lag_ridge'
MODELS = ('stable_grey', 'anfis', 'grey_anfis', 'hybrid_network')
SELECTIONS = ('clusters', 'correlation')
HEADS = {
    'clusters': '5 by fuzzy clusters',
    'correlation': '5 by correlation',
    'stable_grey': 'Stable grey',
    'anfis': 'ANFIS',
    'grey_anfis': 'Grey + ANFIS',
    'hybrid_network': 'Hybrid network',
}


@dataclass(frozen=True, eq=False)
class HeldOutRun:
    """Mean square residuals of a held-out run.

    Parameters
    ----------
    machine, name : str
        The machine, and the run or stretch.
    count : ndarray, shape (c,)
        Number of measured samples.
    sensors, models : mapping of str to ndarray, shape (c,)
        Mean square residual [m^2] of lagged ridge by its sensors ('all', and each selection),
        and of each model, infinite where it diverged.
    """

    machine: str
    name: str
    count: np.ndarray
    sensors: dict[str, np.ndarray]
    models: dict[str, np.ndarray]


def judge_piece(piece: Piece, progress: Progress) -> HeldOutRun | Failure:
    """Train everything without a run and judge it on that run."""
    split, runs = piece.split, piece.split.training
    by_itself = 'all' if len(runs[0].sensor) <= SENSORS_MAX else 'clusters'
    sensors, models = {}, {}
    try:
        for name in ('all', *SELECTIONS):
            training = by_correlation(runs, piece.interval) if name == 'correlation' else runs
            model = train_model(
                training,
                candidates=(PLAIN,),
                compared=MODELS if name == by_itself else (),
                sensors='clusters' if name == 'clusters' else 'all',
                n_clusters=CHOSEN,
                interval=piece.interval,
                spindle_speed=False,
                progress=progress,
            )
            judged = evaluate(model, split.held_out, start=split.start, stop=split.stop)
            with np.errstate(over='ignore'):
                square = {row: rms**2 for row, rms in judged.rms.items()}
            sensors[name] = square[PLAIN]
            if name == by_itself:
                infinite = np.full(len(judged.channel), np.inf)
                models = {row: square.get(row, infinite) for row in (PLAIN, *MODELS)}
    except ThermalDataError as error:
        return Failure(piece.machine, split.name, str(error))
    count = np.isfinite(judged.measured).sum(axis=0)
    return HeldOutRun(piece.machine, split.name, count, sensors, models)


def by_correlation(runs: Sequence[ThermalRun], interval: float) -> list[ThermalRun]:
    """Return runs with the sensors whose rises go most with the displacements."""
    even = [at_interval(run, interval) for run in runs]
    rise = np.concatenate([run.rise() for run in even])
    moved = np.concatenate([run.displacement for run in even])
    strength = np.zeros(rise.shape[1])
    for channel in moved.T:
        measured = np.isfinite(channel)
        own, other = rise[measured], channel[measured]
        covariance = (own - own.mean(axis=0)).T @ (other - other.mean())
        spread = own.std(axis=0)
        strength += np.abs(covariance) / np.where(spread > 0.0, spread, np.inf) / other.std()
    kept = np.sort(np.argsort(-strength, kind='stable')[:CHOSEN])
    names = tuple(runs[0].sensor[column] for column in kept)
    return [replace(run, sensor=names, temperature=run.temperature[:, kept]) for run in runs]


@dataclass(frozen=True)
class Worth:
    """A residual over that of the reference: pooled, of single runs, and what chance says."""

    ratio: float
    lowest: float
    highest: float
    verdict: str

    def __str__(self) -> str:
        if not np.isfinite(self.ratio):
            return 'diverged'
        return f'{self.ratio:.2f} ({self.lowest:.2f} to {self.highest:.2f}) {self.verdict:1}'


def worth(
    counts: np.ndarray, squares: Sequence[np.ndarray], reference: Sequence[np.ndarray]
) -> Worth:
    """Compare mean square residuals (runs, c) of a part with those of the reference.

    Parameters
    ----------
    counts : ndarray, shape (runs, c)
        Measured samples.
    squares, reference : sequence of ndarray, shape (c,)
        Mean square residual of each run [m^2]; NaN where nothing was measured.
    """
    own, other = np.array(squares), np.array(reference)
    measured = counts > 0
    with np.errstate(invalid='ignore', over='ignore', divide='ignore'):
        weight = counts.astype(float)
        pooled = [
            np.sqrt(np.where(measured, weight * item, 0.0).sum(axis=0)) for item in (own, other)
        ]
        ratio = geometric_mean(pooled[0] / pooled[1])
        logs = np.where(measured, 0.5 * np.log(own / other), np.nan)
    each = np.array([np.nanmean(row) for row in logs if np.isfinite(row).any()])
    if not np.isfinite(each).all() or not np.isfinite(ratio):
        return Worth(np.inf, np.nan, np.nan, '-')
    verdict = ''
    if len(each) > 1:
        limit = stdtrit(len(each) - 1, CONFIDENCE) * each.std(ddof=1) / np.sqrt(len(each))
        verdict = '+' if each.mean() < -limit else '-' if each.mean() > limit else ''
    return Worth(ratio, float(np.exp(each.min())), float(np.exp(each.max())), verdict)


def worths(held_out: Sequence[HeldOutRun]) -> dict[str, Worth]:
    """Return the worth of every part on a machine."""
    counts = np.array([item.count for item in held_out])
    found = {}
    for name in SELECTIONS:
        squares = [item.sensors[name] for item in held_out]
        found[name] = worth(counts, squares, [item.sensors['all'] for item in held_out])
    for name in MODELS:
        squares = [item.models[name] for item in held_out]
        found[name] = worth(counts, squares, [item.models[PLAIN] for item in held_out])
    return found


def worth_table(found: dict[str, dict[str, Worth]], names: Sequence[str]) -> list[str]:
    """Return a line per machine, and the geometric mean over those where a part holds."""
    lines = [[machine, *(str(parts[name]) for name in names)] for machine, parts in found.items()]
    means = ['geometric mean']
    for name in names:
        ratios = [parts[name].ratio for parts in found.values()]
        finite = [ratio for ratio in ratios if np.isfinite(ratio)]
        some = f' of {len(finite)}' if len(finite) < len(ratios) else ''
        means.append(f'{geometric_mean(finite):.2f}{some}' if finite else 'diverged')
    return table(('Machine', *(HEADS[name] for name in names)), [*lines, means], text=(0,))


def document(
    found: dict[str, dict[str, Worth]],
    held_out: Sequence[HeldOutRun],
    failures: Sequence[Failure],
) -> dict[str, Any]:
    """Return all figures for a JSON file."""
    return {
        'machines': {
            machine: {name: vars(item) for name, item in parts.items()}
            for machine, parts in found.items()
        },
        'held_out': [
            {
                'machine': item.machine,
                'run': item.name,
                'samples': item.count.tolist(),
                'sensors_rms_um': {
                    name: (1e6 * np.sqrt(value)).tolist() for name, value in item.sensors.items()
                },
                'models_rms_um': {
                    name: (1e6 * np.sqrt(value)).tolist() for name, value in item.models.items()
                },
            }
            for item in held_out
        ],
        'left_out': [vars(item) for item in failures],
    }


def main() -> None:
    """Print the tables and write them to files."""
    options, shop = asked('What the fuzzy parts are worth, on all machines at hand.')
    held_out, failures, left_out = sorted_out(in_processes(judge_piece, shop, options.jobs))
    names = dict.fromkeys(item.machine for item in held_out)
    by_machine = {
        name: worths([item for item in held_out if item.machine == name]) for name in names
    }
    lines = ['Lagged ridge on five sensors over lagged ridge on all:', '']
    lines += worth_table(by_machine, SELECTIONS)
    lines += ['', 'Models over lagged ridge, on the sensors that training takes by itself:', '']
    lines += worth_table(by_machine, MODELS)
    if left_out:
        lines += ['', *left_out]
    show(lines, options.markdown)
    write_json(options.json, document(by_machine, held_out, failures))


if __name__ == '__main__':
    main()

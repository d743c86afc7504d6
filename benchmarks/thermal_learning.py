# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a machine leaves that was never calibrated, only probed: one table of all machines.

Each machine's runs follow each other in their order, as in a shop; what was learnt is carried from
run to run.  Probes have noise of their own, drawn by seed.  Printed is, per channel, the median
over the seeds of the root mean square error, the geometric mean over the runs, of

- the machine as it is ('none') and the last probe held without any model,
- what the runs before have taught, without the run's probes, and with them,
- the same from the fifth run on, for machines with six runs or more,

and the share of samples in the band and its half width over the error, in each part of a run.

Run with `python benchmarks/thermal_learning.py [--recordings DIR] [--markdown FILE]`.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from thermal_recordings import Machine, machines

from fuzzycnc_ros.cli.console import progress_bar, write_text
from fuzzycnc_ros.studies.thermal.learnt import PHASES, LearntRun, learn_runs

NOISE = 0.3e-6
ROWS = ('uncompensated', 'held', 'carried', 'learnt')
COLUMNS = ('none', 'held', 'before probes', 'learnt', 'from run 5 on')
BAND = ('covered', 'half_width')
SETTLED, RUNS = 4, 6
EVERY = (3600.0, 1800.0)

RowsOf = Callable[[Machine, float, int], list[tuple[str, ...]]]
"""Returns a machine's rows, probed at a time [s], with so many seeds."""


def follow(machine: Machine, every: float, seeds: int) -> list[list[LearntRun]]:
    """Return the runs of a machine for each seed; a simulated one has recordings of its own."""
    return [
        list(learn_runs(runs, every, noise=NOISE, seed=seed))
        for runs in machine.sets
        for seed in range(seeds if len(machine.sets) == 1 else 1)
    ]


def level(found: list[list[LearntRun]], name: str, begin: int = 0) -> np.ndarray:
    """Return the geometric mean over runs [um], in the median over seeds, by channel."""
    logs = [[np.log(1e6 * item.rms[name]) for item in runs[begin:]] for runs in found]
    return np.median([np.exp(np.mean(each, axis=0)) for each in logs], axis=0)


def mean_of(found: list[list[LearntRun]], name: str, phase: str) -> np.ndarray:
    """Return the mean over seeds and the runs that have a phase, by channel; NaN if none has."""
    values = np.array([getattr(item, name)[phase] for runs in found for item in runs])
    count = np.isfinite(values).sum(axis=0)
    return np.where(count, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)


def rows_of(machine: Machine, every: float, seeds: int) -> list[tuple[str, ...]]:
    """Return a machine's rows of the table, one per channel."""
    found = follow(machine, every, seeds)
    levels = [level(found, name) for name in ROWS]
    many = len(found[0]) >= RUNS
    settled = level(found, 'learnt', SETTLED) if many else np.full(len(levels[0]), np.nan)
    bands = [[mean_of(found, name, phase) for name in BAND] for phase in PHASES]
    rows = []
    for c, channel in enumerate(found[0][0].channel):
        cells = [f'{value[c]:.2f}' for value in (*levels, settled)]
        cells += [f'{100.0 * held[c]:.0f} % x {width[c]:.1f}' for held, width in bands]
        rows.append((f'{machine.name} {channel}', f'{every / 60.0:g} min', *cells))
    return rows


def arguments(description: str, seeds: int) -> argparse.Namespace:
    """Return recordings, machines, seeds and file that were asked for."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('--recordings', type=Path, action='append', default=[], metavar='DIR')
    parser.add_argument('--machine', action='append', default=[], metavar='NAME')
    parser.add_argument('--seeds', type=int, default=seeds, metavar='N')
    parser.add_argument('--markdown', type=Path, metavar='FILE')
    return parser.parse_args()


def show(header: Sequence[str], rows: Sequence[Sequence[str]], file: Path | None) -> None:
    """Print a table, and write it to a file where one is asked for."""
    lines = ['| ' + ' | '.join(cells) + ' |' for cells in (header, *rows)]
    lines.insert(1, '|' + ' --- |' * len(header))
    text = '\n'.join(lines).replace('nan', '-') + '\n'
    print(text, end='')
    if file is not None:
        write_text(file, text)


def all_rows(options: argparse.Namespace, rows_of: RowsOf) -> list[tuple[str, ...]]:
    """Return the rows of all machines that were asked for, at each time between two probes."""
    rows = []
    with progress_bar('learning') as tell:
        known = machines(options.recordings, 3, options.machine)
        for number, machine in enumerate(known):
            for part, every in enumerate(EVERY):
                tell(machine.name, 2 * number + part, 2 * len(known))
                rows += rows_of(machine, every, options.seeds)
    return rows


def main() -> None:
    """Print the table."""
    options = arguments('Learning from probes, on all machines.', 20)
    rows = all_rows(options, rows_of)
    show(('machine', 'probed', *COLUMNS, *PHASES), rows, options.markdown)


if __name__ == '__main__':
    main()

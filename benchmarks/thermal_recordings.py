# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The machines that thermal models are compared on: simulated ones and recorded ones.

Recordings come from folders, one per machine, that hold its runs as bags or as CSV files.  A CSV
file is one run; its header line names `t_s` (time [s]), `rpm` (spindle speed, may be left out),
`T:<sensor>` (temperatures [degC]), `D:<channel>` (displacements [um]) and `C:<drive>` (what else a
control told, such as `C:axis_speed/X`, see `ThermalRun`).  An empty cell was not measured.
Displacements count from the mean of their first three minutes, as with `fuzzycnc import-csv
--zero`.
"""

import csv
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import pi
from pathlib import Path

import numpy as np

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.core.thermal.fit.comparison import Split, splits
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.simulation.thermal.duties import record_runs
from fuzzycnc_ros.simulation.thermal.grinder_runs import record_grinder

DATA = Path(os.environ.get('FUZZYCNC_DATA', Path(__file__).parents[2] / 'shared' / 'data'))
SPINDLE = DATA / 'spindle-thermal' / 'spindle_thermal.csv'

INTERVAL_MIN = 60.0
"""Interval of the models [s]; a machine that was recorded more slowly keeps its own."""
ZEROED = 180.0
"""Time over which the zero of a displacement is averaged [s]."""
RPM = 2.0 * pi / 60.0
MICROMETRE = 1e-6


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine and what was recorded on it.

    Parameters
    ----------
    name : str
        Name of the machine.
    sets : tuple of tuple of ThermalRun
        Runs that are held out of one another; a simulated machine has a set per seed, all of
        which count as the one machine that they are.
    """

    name: str
    sets: tuple[tuple[ThermalRun, ...], ...]

    @property
    def interval(self) -> float:
        """Interval that models of this machine can have [s]."""
        steps = [float(np.median(np.diff(run.time))) for runs in self.sets for run in runs]
        return max(INTERVAL_MIN, *steps)

    def splits(self) -> list[Split]:
        """Return what is held out in turn, for all sets."""
        return [split for runs in self.sets for split in splits(runs, (), self.interval)]


def machines(folders: Sequence[Path], seeds: int, wanted: Sequence[str]) -> list[Machine]:
    """Return the machines at hand.

    Parameters
    ----------
    folders : sequence of Path
        Folders with a folder per machine.
    seeds : int
        Number of recordings of each simulated machine, each with noise of its own.
    wanted : sequence of str
        Names of machines to keep; all if there is none.

    Raises
    ------
    ValueError
        If a machine that is wanted is not there, a name comes twice or a file cannot be read.
    """
    known: dict[str, Callable[[], Machine]] = {}
    if SPINDLE.exists():
        known['spindle'] = lambda: Machine('spindle', ((spindle_run(),),))
    for name, record in (('mill', record_runs), ('grinder', record_grinder)):
        known[name] = partial(simulated, name, record, seeds)
    for place in (place for folder in folders for place in sorted(folder.iterdir())):
        if place.name in known:
            raise ValueError(
                f'{place}: expected machines of different names but found {place.name!r} twice; '
                'rename the folder'
            )
        if place.is_dir():
            known[place.name] = partial(read_machine, place)
    for name in wanted:
        if name not in known:
            raise ValueError(f'expected machines among {", ".join(known)} but found {name!r}')
    return [make() for name, make in known.items() if not wanted or name in wanted]


def simulated(name: str, record: Callable[..., Mapping[str, ThermalRun]], seeds: int) -> Machine:
    """Return a simulated machine with all its runs, recorded with several seeds."""
    return Machine(name, tuple(tuple(record(seed=seed).values()) for seed in range(seeds)))


def spindle_run() -> ThermalRun:
    """Return the public spindle recording, `data/data.xlsx` of CAIVIAC/FL_THERMAL."""
    table = np.genfromtxt(SPINDLE, delimiter=',', names=True)
    sensor = tuple(f't{number}' for number in range(1, 17))
    channel = tuple(f'ch{number}' for number in range(1, 6))
    return ThermalRun(
        name='spindle',
        time=table['t'],
        sensor=sensor,
        temperature=np.column_stack([table[name] for name in sensor]),
        channel=channel,
        axis=('X', 'X', 'Y', 'Y', 'Z'),
        displacement=MICROMETRE * np.column_stack([table[name] for name in channel]),
        spindle_speed=table['rpm'] * RPM,
    )


def read_machine(folder: Path) -> Machine:
    """Read all runs of a folder, CSV files or bags.

    Raises
    ------
    ValueError
        If there are none, or one cannot be read.
    """
    tables = sorted(folder.glob('*.csv'))
    runs = [read_table(path) for path in tables] or [
        read_run(bag.path, name=bag.name) for bag in find_bags([folder])
    ]
    return Machine(folder.name, (tuple(runs),))


def read_table(path: Path) -> ThermalRun:
    """Read a run from a CSV file.

    Raises
    ------
    ValueError
        If its header lacks a time, a temperature or a displacement.
    """
    with path.open(newline='', encoding='utf-8') as file:
        header = next(csv.reader(file), [])
    sensor = [name for name in header if name.startswith('T:')]
    channel = [name for name in header if name.startswith('D:')]
    if 't_s' not in header or not sensor or not channel:
        raise ValueError(
            f'{path}: expected a header with t_s, T:<sensor> and D:<channel> but found '
            f'{", ".join(header)}'
        )
    values = np.genfromtxt(path, delimiter=',', skip_header=1, ndmin=2)
    column = dict(zip(header, values.T, strict=True))
    time = column['t_s']
    displacement = np.column_stack([_zeroed(time, column[name]) for name in channel])
    names = tuple(name[2:] for name in channel)
    return ThermalRun(
        name=path.stem,
        time=time,
        sensor=tuple(name[2:] for name in sensor),
        temperature=np.column_stack([column[name] for name in sensor]),
        channel=names,
        axis=tuple(name.upper() if name.upper() in ('X', 'Y', 'Z') else 'Z' for name in names),
        displacement=MICROMETRE * displacement,
        spindle_speed=column['rpm'] * RPM if 'rpm' in column else None,
        drives={name[2:]: column[name] for name in header if name.startswith('C:')},
    )


def _zeroed(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return a displacement against the mean of its first three minutes of measurements."""
    measured = np.isfinite(values)
    if not measured.any():
        return values
    first = measured & (time <= time[measured][0] + ZEROED)
    return values - values[first].mean()

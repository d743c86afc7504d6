# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Doubts about recordings: false alarms on sound ones, and faults that are missed.

    python benchmarks/thermal_doubts.py --seeds 1 --lathes 10

prints the table of docs/explanation/methods/recorded-runs.md in a few minutes.  Sound recordings
are those at hand: the spindle of CAIVIAC/FL_THERMAL cut into its four cycles, three days of the
examples, the simulated mill and grinder with several seeds, and lathes made up at random, whose
heat comes from spindle, drives and hall in changing shares.  Every fault is put into each of them.
"""

import argparse
import csv
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import pi
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from thermal_recordings import SPINDLE, spindle_run

from fuzzycnc_ros.bags.csv_import import ImportReport, import_csv
from fuzzycnc_ros.bags.csv_mapping import CsvMapping
from fuzzycnc_ros.cli.models.recorded_runs import doubt_lines
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.core.thermal.spacing import reference_rows
from fuzzycnc_ros.simulation.thermal.duties import record_runs
from fuzzycnc_ros.simulation.thermal.grinder_runs import record_grinder

EXAMPLES = Path(__file__).parents[1] / 'examples'
CYCLES = (31, 1951, 3871, 5791, 7711)
"""Rows of the spindle recording between which its cycles lie."""
FIRST_LATHE = 2000
"""Seed of the first lathe; those below it served to choose the limits."""
Fault = Callable[[ThermalRun, np.random.Generator], ThermalRun]


@dataclass(frozen=True)
class Trial:
    """What is put into a recording, and what then has to be said.

    Parameters
    ----------
    doubt : str
        What is doubted.
    fault : str
        What was put in; empty for something sound that looks like it.
    change : callable
        Puts it in.
    says : str
        Part of the sentence that has to come, or must not.
    cell : str
        What the file has where there is no reading.
    """

    doubt: str
    fault: str
    change: Fault
    says: str
    cell: str = ''


def zeroed(run: ThermalRun) -> ThermalRun:
    """Return a run whose displacements begin at zero."""
    first = run.displacement[: reference_rows(run.time)]
    return replace(run, displacement=run.displacement - np.nanmean(first, axis=0))


def spindle_cycles() -> list[ThermalRun]:
    """Return the four cycles of the spindle."""
    run = spindle_run()
    return [
        replace(
            run,
            name=f'cycle {number + 1}',
            **{
                field: getattr(run, field)[first:end]
                for field in ('time', 'temperature', 'displacement', 'spindle_speed')
            },
        )
        for number, (first, end) in enumerate(pairwise(CYCLES))
    ]


def example_days() -> list[ThermalRun]:
    """Return the three days of the examples."""
    runs = []
    for day in ('monday', 'tuesday', 'wednesday'):
        table = np.genfromtxt(EXAMPLES / f'{day}.csv', delimiter=',', names=True)
        sensor = tuple(name for name in table.dtype.names if name[0] == 't' and name != 't')
        runs.append(
            ThermalRun(
                name=day,
                time=table['t'],
                sensor=sensor,
                temperature=np.column_stack([table[name] for name in sensor]),
                channel=('y', 'z'),
                axis=('Y', 'Z'),
                displacement=1e-6 * np.column_stack([table['y'], table['z']]),
            )
        )
    return runs


def lathe(seed: int) -> list[ThermalRun]:
    """Return the runs of a made-up lathe: six bodies in contact, heated by three sources."""
    rng = np.random.default_rng(seed)
    bodies, sensors, channels = 6, int(rng.choice([4, 6, 8])), ('X', 'Z')
    to_air = 1.0 / np.exp(rng.uniform(np.log(600.0), np.log(4.0 * 3600.0), bodies))
    contact = np.triu(np.exp(rng.uniform(np.log(1 / 7200), np.log(1 / 900), (bodies, bodies))), 1)
    contact *= rng.random((bodies, bodies)) < 0.5
    contact += contact.T
    source = rng.choice(bodies, 3, replace=False)
    power = rng.uniform(10.0, 40.0, 3) * to_air[source]
    place, share = rng.integers(0, bodies, sensors), rng.uniform(0.5, 1.0, sensors)
    growth = rng.normal(0.0, 3e-6, (bodies, len(channels)))
    runs = []
    for number in range(int(rng.choice([3, 4, 6]))):
        count = int(rng.uniform(180, 480))
        time = 60.0 * np.arange(count)
        duty = np.zeros((count, 3))
        main = rng.integers(0, 3)
        for column in range(3):
            row, on = 0, rng.random() < (0.9 if column == main else 0.4)
            while row < count:
                length = int(rng.uniform(15, 120))
                duty[row : row + length, column] = on * rng.choice([0.0, 0.3, 0.6, 1.0])
                row += length
        phase, swing = rng.uniform(0.0, 2.0 * pi), rng.uniform(0.5, 2.5)
        hall = swing * (np.sin(2.0 * pi * time / 86400.0 + phase) - np.sin(phase))
        rise = np.zeros((count, bodies))
        for row in range(1, count):
            now = rise[row - 1].copy()
            for _ in range(4):
                flow = to_air * (hall[row] - now) + contact @ now - contact.sum(axis=1) * now
                flow[source] += power * duty[row]
                now += 15.0 * flow
            rise[row] = now
        noise = rng.normal(0.0, 0.05, (count, sensors)) + rng.normal(0.0, 0.3, sensors)
        read = share * rise[:, place] + (1.0 - share) * hall[:, np.newaxis] + noise
        moved = rise @ growth + rng.normal(0.0, 0.1e-6, (count, len(channels)))
        runs.append(
            ThermalRun(
                name=f'run {number + 1}',
                time=time,
                sensor=tuple(f't{column + 1}' for column in range(sensors)),
                temperature=rng.uniform(17.0, 27.0) + read,
                channel=channels,
                axis=channels,
                displacement=moved,
            )
        )
    return runs


def machines(seeds: int, lathes: int) -> Iterator[tuple[str, list[ThermalRun]]]:
    """Yield kind and runs of each machine, displacements zeroed."""
    if SPINDLE.exists():
        yield 'spindle', [zeroed(run) for run in spindle_cycles()]
    yield 'examples', [zeroed(run) for run in example_days()]
    for seed in range(seeds):
        yield 'mill', [zeroed(run) for run in record_runs(seed=seed).values()]
        yield 'grinder', [zeroed(run) for run in record_grinder(seed=seed).values()]
    for seed in range(FIRST_LATHE, FIRST_LATHE + lathes):
        yield 'lathes', [zeroed(run) for run in lathe(seed)]


# What is put into a single recording.


def same(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Return the recording as it is."""
    return run


def fast_sensor(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Let one sensor sit on a heater: 12 K up and down within a minute, again and again."""
    temperature = run.temperature.copy()
    on = (run.time // 2700.0 % 2.0 == 1.0) * 12.0
    temperature[:, rng.integers(0, temperature.shape[1])] += on
    return replace(run, temperature=temperature)


def slower(factor: float) -> Fault:
    """Return what writes the times in another unit."""

    def change(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
        return replace(run, time=run.time * factor)

    return change


def fahrenheit(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Write the temperatures in degF."""
    return replace(run, temperature=np.minimum(run.temperature * 1.8 + 32.0, 120.0))


def offset(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Begin with 30 to 100 % of the range of each channel."""
    span = np.nanmax(run.displacement, axis=0) - np.nanmin(run.displacement, axis=0)
    size = rng.uniform(0.3, 1.0, len(span)) * rng.choice([-1.0, 1.0], len(span))
    return replace(run, displacement=run.displacement + size * span)


def silent(rows: slice) -> Fault:
    """Return what takes readings of one sensor away; a trial says what the cells hold."""

    def change(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
        temperature = run.temperature.copy()
        temperature[rows, rng.integers(0, temperature.shape[1])] = np.nan
        return replace(run, temperature=temperature)

    return change


def spike(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Put 8 K on a single reading."""
    temperature = run.temperature.copy()
    row, column = (int(rng.integers(0, size)) for size in temperature.shape)
    temperature[row, column] += 8.0
    return replace(run, temperature=temperature)


NONE, TAKEN = 'a value is no reading', 'taken as missing'
ALONE = (
    Trial('times are in another unit', '', same, '--time-unit'),
    Trial('times are in another unit', '', fast_sensor, '--time-unit'),
    Trial('times are in another unit', 'min read as s', slower(1 / 60), '--time-unit min'),
    Trial('times are in another unit', 'h read as s', slower(1 / 3600), '--time-unit'),
    Trial('times are in another unit', 'ms read as s', slower(1000.0), '--time-unit ms'),
    Trial('temperatures are in another unit', '', same, '--temperature-unit'),
    Trial('temperatures are in another unit', 'degF read as degC', fahrenheit, 'unit degF'),
    Trial(NONE, '', same, TAKEN),
    Trial(NONE, '85 degC in the first row', silent(slice(1)), 'DS18B20', '85.0'),
    Trial(NONE, '0 degC in four rows', silent(slice(4)), TAKEN, '0.0'),
    Trial(NONE, '0 degC throughout', silent(slice(None)), TAKEN, '0'),
    Trial(NONE, '-127 degC now and then', silent(slice(9, None, 20)), TAKEN, '-127'),
    Trial('a single value stands alone', '', same, 'stands alone'),
    Trial('a single value stands alone', '8 K on one reading', spike, 'stands alone'),
    Trial('displacements do not begin at zero', '', same, '--zero'),
    Trial('displacements do not begin at zero', '30 to 100 % of the range', offset, '--zero'),
)


# What is put into one of the runs of a machine.


def warm_sensor(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Let one sensor begin 20 K warmer, and cool down with a time constant of 20 min."""
    temperature = run.temperature.copy()
    temperature[:, rng.integers(0, temperature.shape[1])] += 20.0 * np.exp(-run.time / 1200.0)
    return replace(run, temperature=temperature)


def broken_sensor(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Let one sensor read 20 K too much."""
    temperature = run.temperature.copy()
    temperature[:, rng.integers(0, temperature.shape[1])] += 20.0
    return replace(run, temperature=temperature)


def turned(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Turn the sign of all channels round."""
    return replace(run, displacement=-run.displacement)


def one_turned(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Turn the sign of one channel round."""
    sign = np.ones(run.displacement.shape[1])
    sign[rng.integers(0, len(sign))] = -1.0
    return replace(run, displacement=run.displacement * sign)


def exchanged(run: ThermalRun, rng: np.random.Generator) -> ThermalRun:
    """Exchange the columns of two channels."""
    order = np.arange(run.displacement.shape[1])
    order[[0, -1]] = order[[-1, 0]]
    return replace(run, displacement=run.displacement[:, order])


OFF = 'against the other sensors'
TURNED = 'against what the other runs predict'
TOGETHER = (
    Trial('a sensor is far off in some runs', '', same, OFF),
    Trial('a sensor is far off in some runs', '', warm_sensor, OFF),
    Trial('a sensor is far off in some runs', '20 K in one run', broken_sensor, OFF),
    Trial('a run has the other sign', '', same, TURNED),
    Trial('a run has the other sign', 'all channels of one run', turned, TURNED),
    Trial('a run has the other sign', 'one channel of one run', one_turned, TURNED),
    Trial('none looks for it', 'two channels of one run exchanged', exchanged, TURNED),
)


def imported(run: ThermalRun, folder: Path, cell: str) -> ImportReport:
    """Write a run as CSV file and import it."""
    file, bag = folder / 'run.csv', folder / f'bag{len(list(folder.iterdir()))}'
    sensors = [f't{column}' for column in range(len(run.sensor))]
    channels = [f'd{column}' for column in range(len(run.channel))]
    with file.open('w', newline='', encoding='utf-8') as stream:
        writer = csv.writer(stream)
        writer.writerow(['time', *sensors, *channels])
        for row in np.column_stack([run.time, run.temperature, 1e6 * run.displacement]):
            writer.writerow([cell if np.isnan(value) else f'{value:.10g}' for value in row])
    return import_csv(
        file,
        bag,
        CsvMapping(
            temperatures=sensors,
            displacements=[
                f'{name}={axis}:um' for name, axis in zip(channels, run.axis, strict=True)
            ],
        ),
    )


def said_alone(trial: Trial, runs: Sequence[ThermalRun], rng: np.random.Generator) -> list[bool]:
    """Return for each run whether its import says what the trial is about."""
    found = []
    for run in runs:
        with TemporaryDirectory() as folder:
            try:
                report = imported(trial.change(run, rng), Path(folder), trial.cell)
                lines = (*report.doubts, *report.remarks)
            except ValueError as error:  # a refusal that names the remedy is as good
                lines = (str(error),)
        found.append(any(trial.says in line for line in lines))
    return found


def said_together(
    trial: Trial, runs: Sequence[ThermalRun], rng: np.random.Generator
) -> list[bool]:
    """Return for each run whether it is named once the fault is in it; once for a sound set."""
    if trial.change is same:
        return [any(trial.says in line for line in doubt_lines(runs))]
    found = []
    for place, run in enumerate(runs):
        changed = [*runs[:place], trial.change(run, rng), *runs[place + 1 :]]
        lines = [line for line in doubt_lines(changed) if trial.says in line]
        named = [line for line in lines if line.startswith((f'{run.name}:', f'{run.name} or'))]
        found.append(bool(lines) if not trial.fault else bool(named) and named == lines)
    return found


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('--seeds', type=int, default=1, help='recordings of mill and grinder')
    options.add_argument('--lathes', type=int, default=10, help='made-up lathes')
    given = options.parse_args()
    known = list(machines(given.seeds, given.lathes))
    kinds = list(dict.fromkeys(kind for kind, _ in known))
    print(f'| doubt | put in | | {" | ".join(kinds)} |')
    print(f'|---|---|---|{"---|" * len(kinds)}')
    for trial in (*ALONE, *TOGETHER):
        tell = said_alone if trial in ALONE else said_together
        total: Counter[str] = Counter()
        wrong: Counter[str] = Counter()
        for number, (kind, runs) in enumerate(known):
            spoken = tell(trial, runs, np.random.default_rng(number))
            total[kind] += len(spoken)
            wrong[kind] += sum(item is not bool(trial.fault) for item in spoken)
        what = trial.fault or {
            same: 'nothing', fast_sensor: 'a fast sensor', warm_sensor: 'a sensor that begins warm'
        }.get(trial.change, '')  # fmt: skip
        counted = 'missed' if trial.fault else 'false alarms'
        cells = ' | '.join(f'{wrong[kind]} of {total[kind]}' for kind in kinds)
        print(f'| {trial.doubt} | {what} | {counted} | {cells} |', flush=True)


if __name__ == '__main__':
    main()

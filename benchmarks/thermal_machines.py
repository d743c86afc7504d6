# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a user's `fuzzycnc train` gets on machines of many kinds: leave-one-run-out, one table.

Every run is held out in turn: sensors, settings, the model of each channel, its band and its
domain come from the other runs alone.  Machines are the public spindle recording in FUZZYCNC_DATA,
held out by thermal cycles, the simulated mill and grinder with several seeds, and any number of
folders of recordings (see `thermal_recordings.py` for their layout).  Printed are, per machine and
channel:

- what is left without compensation ('none'), by the plain baselines least squares, static ridge
  and lagged ridge, by the default and by the default without the spindle speed; the default over
  the best plain baseline, which is picked with hindsight; whether the default is worse than no
  compensation by more than chance, a one-sided t-test over the held-out runs at 95 %, and on how
  many runs it is worse at all;
- the share of held-out samples within two standard deviations, and the half width of this band
  over the residual, both root mean square;
- the share of good held-out samples that the model calls outside its domain (false alarms), and
  of made-up bad ones that it calls inside (misses): random walks of the same step and length in
  all sensors, the same run begun where it is warmest, and one sensor 5 K off from the middle on.

Run with `python benchmarks/thermal_machines.py [--recordings DIR] [--markdown FILE]`.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit
from thermal_recordings import Machine, machines

from fuzzycnc_ros.cli.console import progress_bar, write_json, write_text
from fuzzycnc_ros.cli.models.many_bags import cores
from fuzzycnc_ros.cli.workers import Progress, in_workers
from fuzzycnc_ros.core.thermal.candidate import BASELINES, UNCOMPENSATED
from fuzzycnc_ros.core.thermal.fit import evaluate
from fuzzycnc_ros.core.thermal.fit.comparison import Split
from fuzzycnc_ros.core.thermal.fit.training import at_interval, train_model
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.run import SAMPLES_MIN, ThermalDataError, ThermalRun, drivers_of

SEEDS = 3
CONFIDENCE = 0.95
"""Confidence at which the default is called worse than no compensation [-]."""
OFFSET = 5.0
"""Error of a sensor in the third kind of bad run [K]."""
COOLING = 1 / 3
"""Share of a run that has to be left when it is begun at its warmest point [-]."""

DEFAULT, NO_SPEED = 'default', 'default_no_speed'
ROWS = (UNCOMPENSATED, *BASELINES, DEFAULT, NO_SPEED)
BAD = ('random_walk', 'warm_start', 'sensor_offset')


@dataclass(frozen=True, eq=False)
class Piece:
    """A run of a machine to hold out: name of the machine, split, interval of the model [s]."""

    machine: str
    split: Split
    interval: float


@dataclass(frozen=True, eq=False)
class HeldOutRun:
    """What came of a held-out run.

    Parameters
    ----------
    machine, name : str
        The machine, and the run or stretch.
    channel : tuple of str, length c
        Channels.
    chosen : tuple of str, length c
        Model that the default took in each channel.
    count : ndarray, shape (c,)
        Number of measured samples.
    mean_square : mapping of str to ndarray, shape (c,)
        Mean square residual of each row [m^2], infinite where it diverged.
    covered : ndarray, shape (c,)
        Share of the measured samples within two standard deviations [-].
    half_width : ndarray, shape (c,)
        Root mean square of two standard deviations over the measured samples [m].
    inside : mapping of str to float
        Share of samples in the domain [-], none after a warm start: of the held-out ones ('good')
        and of each kind of bad run; NaN where it could not be made up.
    """

    machine: str
    name: str
    channel: tuple[str, ...]
    chosen: tuple[str, ...]
    count: np.ndarray
    mean_square: dict[str, np.ndarray]
    covered: np.ndarray
    half_width: np.ndarray
    inside: dict[str, float]


@dataclass(frozen=True)
class Failure:
    """A held-out run that could not be judged, and why."""

    machine: str
    name: str
    reason: str


def judge_piece(piece: Piece, progress: Progress) -> HeldOutRun | Failure:
    """Train without a run, as `fuzzycnc train` does by itself, and judge on it."""
    split = piece.split
    options: dict[str, Any] = {'interval': piece.interval, 'progress': progress}
    try:
        model = train_model(split.training, **options)
        judged = evaluate(model, split.held_out, start=split.start, stop=split.stop)
        speed = drivers_of([at_interval(run, piece.interval) for run in split.training])
        without = (
            evaluate(
                train_model(split.training, spindle_speed=False, **options),
                split.held_out,
                start=split.start,
                stop=split.stop,
            )
            if speed
            else judged
        )
    except ThermalDataError as error:
        return Failure(piece.machine, split.name, str(error))
    rms = {name: judged.rms[name] for name in ROWS[:-1] if name in judged.rms}
    rms[NO_SPEED] = without.rms[DEFAULT]
    even = at_interval(split.held_out, model.interval)
    window = even.inside(split.start, split.stop)
    with np.errstate(over='ignore'):
        return HeldOutRun(
            machine=piece.machine,
            name=split.name,
            channel=judged.channel,
            chosen=judged.default,
            count=np.array(judged.samples),
            mean_square={name: value**2 for name, value in rms.items()},
            covered=judged.covered,
            half_width=judged.half_width,
            inside={'good': judged.in_domain, **bad_runs_inside(model, even, window)},
        )


def bad_runs_inside(model: ThermalModel, run: ThermalRun, window: np.ndarray) -> dict[str, float]:
    """Return the share of samples in the domain for each kind of bad run."""
    rng = np.random.default_rng(len(run.time))
    step = np.diff(run.temperature, axis=0).std(axis=0)
    walk = step * rng.standard_normal(run.temperature.shape)
    walk[0] = 0.0
    wandering = replace(run, temperature=run.temperature[0] + np.cumsum(walk, axis=0))
    off = []
    rows = np.flatnonzero(window)
    late = rows[len(rows) // 2 :]
    for sensor in run.columns(model.inputs):
        shifted = run.temperature.copy()
        shifted[late, sensor] += OFFSET
        off.append(share_inside(model, replace(run, temperature=shifted), late))
    return {
        'random_walk': share_inside(model, wandering, rows),
        'warm_start': warm_start_inside(model, run, rows),
        'sensor_offset': float(np.mean(off)),
    }


def warm_start_inside(model: ThermalModel, run: ThermalRun, rows: np.ndarray) -> float:
    """Return the share in the domain of a run that is begun where it is warmest."""
    last = rows[int((1.0 - COOLING) * len(rows))]
    warmth = run.temperature[rows[0] : last + 1, run.columns(model.inputs)].mean(axis=1)
    start = rows[0] + int(np.argmax(warmth))
    stop = rows[-1] + 1
    if stop - start < SAMPLES_MIN:
        return float('nan')
    warm = run.window(run.time[start], run.time[stop - 1])
    return share_inside(model, warm, np.arange(stop - start))


def share_inside(model: ThermalModel, run: ThermalRun, rows: np.ndarray) -> float:
    """Return the share of some samples of a run that a model calls inside its domain."""
    if model.warmth(run.reference()[run.columns(model.inputs)]):
        return 0.0
    return float(model.in_domain(model.rises(run)[rows]).mean())


class MachineFigures:
    """All held-out runs of a machine, pooled over the samples of each channel."""

    def __init__(self, held_out: Sequence[HeldOutRun]) -> None:
        self.name, self.channel = held_out[0].machine, held_out[0].channel
        self._held_out = held_out
        self._weight = np.array([item.count for item in held_out], dtype=float)
        self._share = self._weight / self._weight.sum(axis=0)
        self.rms = {name: self._pooled(name) for name in ROWS}
        best = np.min([self.rms[name] for name in BASELINES], axis=0)
        self.ratio = self.rms[DEFAULT] / best
        self.ratio_no_speed = self.rms[NO_SPEED] / best
        self.coverage = self._mean([item.covered for item in held_out])
        self.half_width = np.sqrt(self._mean([item.half_width**2 for item in held_out]))
        self.width_ratio = self.half_width / self.rms[DEFAULT]
        loss = [self._loss(c) for c in range(len(self.channel))]
        self.worse = [beyond_chance(item) for item in loss]
        self.worse_runs = [int((item > 0.0).sum()) for item in loss]

    @property
    def runs(self) -> int:
        """Number of held-out runs."""
        return len(self._held_out)

    def chosen(self, channel: int) -> str:
        """Return which models the default took in a channel, the most frequent first."""
        counts = Counter(item.chosen[channel] for item in self._held_out)
        return ', '.join(f'{name} {count}' for name, count in counts.most_common())

    def inside(self, kind: str) -> float:
        """Return the mean share of samples in the domain over the held-out runs."""
        shares = [item.inside[kind] for item in self._held_out if np.isfinite(item.inside[kind])]
        return float(np.mean(shares)) if shares else float('nan')

    def _pooled(self, row: str) -> np.ndarray:
        """Return the root mean square residual; infinite where a row is missing in a run."""
        infinite = np.full(len(self.channel), np.inf)
        each = [item.mean_square.get(row, infinite) for item in self._held_out]
        return np.sqrt(self._mean(each))

    def _mean(self, each: Sequence[np.ndarray]) -> np.ndarray:
        """Return the mean over all samples of what was measured."""
        return np.where(self._weight > 0, self._share * np.array(each), 0.0).sum(axis=0)

    def _loss(self, channel: int) -> np.ndarray:
        """Return by how much the default is worse than no compensation, (runs,) [m^2]."""
        return np.array(
            [
                item.mean_square[DEFAULT][channel] - item.mean_square[UNCOMPENSATED][channel]
                for item in self._held_out
                if item.count[channel]
            ]
        )


def beyond_chance(loss: np.ndarray) -> bool:
    """Return whether losses (runs,) are above zero by more than chance."""
    if not np.isfinite(loss).all():
        return True
    if len(loss) < 2:
        return False
    limit = stdtrit(len(loss) - 1, CONFIDENCE) * loss.std(ddof=1) / np.sqrt(len(loss))
    return bool(loss.mean() > limit)


def geometric_mean(values: Sequence[float]) -> float:
    """Return the geometric mean."""
    return float(np.exp(np.mean(np.log(values))))


def residual_table(figures: Sequence[MachineFigures]) -> list[str]:
    """Return the residuals of all rows, a line per machine and channel."""
    heads = ['Machine', 'Channel', 'Runs', 'None', 'Least squares', 'Static ridge']
    heads += ['Lagged ridge', 'Default', 'Default, no speed', 'Default / best plain']
    heads += ['Worse than none, runs', 'Chosen']
    lines = []
    for item in figures:
        for c, channel in enumerate(item.channel):
            cells = [item.name, channel, str(item.runs)]
            cells += [micrometres(item.rms[row][c]) for row in ROWS]
            worse = 'YES' if item.worse[c] else 'no'
            cells += [f'{item.ratio[c]:.2f}', f'{worse}, {item.worse_runs[c]}', item.chosen(c)]
            lines.append(cells)
    return table(heads, lines, text=(0, 1, 10, 11))


def band_table(figures: Sequence[MachineFigures]) -> list[str]:
    """Return coverage and width of the bands, a line per machine and channel."""
    heads = ('Machine', 'Channel', 'Covered [%]', 'Half width [µm]', 'Half width / rms')
    lines = [
        [
            item.name,
            channel,
            f'{100.0 * item.coverage[c]:.1f}',
            micrometres(item.half_width[c]),
            f'{item.width_ratio[c]:.1f}',
        ]
        for item in figures
        for c, channel in enumerate(item.channel)
    ]
    return table(heads, lines, text=(0, 1))


def domain_table(figures: Sequence[MachineFigures]) -> list[str]:
    """Return false alarms and misses of the domain, a line per machine."""
    heads = ['Machine', 'False alarms [%]', 'Missed: random walk [%]']
    heads += ['Missed: warm start [%]', 'Missed: sensor 5 K off [%]']
    lines = [
        [
            item.name,
            f'{100.0 * (1.0 - item.inside("good")):.1f}',
            *(f'{100.0 * item.inside(kind):.1f}' for kind in BAD),
        ]
        for item in figures
    ]
    return table(heads, lines, text=(0,))


def summary(figures: Sequence[MachineFigures]) -> dict[str, Any]:
    """Return what the tables come to."""
    ratios = [float(ratio) for item in figures for ratio in item.ratio]
    bands = [(item.coverage[c], item.width_ratio[c]) for item in figures for c in each(item)]
    return {
        'ratio_over_channels': geometric_mean(ratios),
        'ratio_over_machines': geometric_mean([geometric_mean(item.ratio) for item in figures]),
        'ratio_over_machines_no_speed': geometric_mean(
            [geometric_mean(item.ratio_no_speed) for item in figures]
        ),
        'ratio_max': max(ratios),
        'channels': len(ratios),
        'channels_above_1_10': sum(ratio > 1.10 for ratio in ratios),
        'channels_worse_than_none': sum(sum(item.worse) for item in figures),
        'runs_worse_than_none': sum(sum(item.worse_runs) for item in figures),
        'channels_covered_90_to_98': sum(0.90 <= covered <= 0.98 for covered, _ in bands),
        'channels_wider_than_3_rms': sum(width > 3.0 for _, width in bands),
    }


def each(item: MachineFigures) -> range:
    """Return the numbers of a machine's channels."""
    return range(len(item.channel))


def summary_lines(figures: Sequence[MachineFigures]) -> list[str]:
    """Return the summary for people."""
    found = summary(figures)
    count = found['channels']
    return [
        f'- default over the best plain baseline, geometric mean: '
        f'{found["ratio_over_channels"]:.3f} over {count} channels, '
        f'{found["ratio_over_machines"]:.3f} over {len(figures)} machines '
        f'({found["ratio_over_machines_no_speed"]:.3f} without the spindle speed)',
        f'- largest ratio {found["ratio_max"]:.2f}; above 1.10 on '
        f'{found["channels_above_1_10"]} of {count} channels',
        f'- worse than no compensation beyond chance on {found["channels_worse_than_none"]} of '
        f'{count} channels, at all on {found["runs_worse_than_none"]} of '
        f'{sum(item.runs * len(item.channel) for item in figures)} channels of single runs',
        f'- band holds 90 to 98 % on {found["channels_covered_90_to_98"]} of {count} channels, '
        f'is wider than 3 times the residual on {found["channels_wider_than_3_rms"]}',
    ]


def document(
    figures: Sequence[MachineFigures], held_out: Sequence[HeldOutRun], failures: Sequence[Failure]
) -> dict[str, Any]:
    """Return all figures for a JSON file, lengths in micrometres."""
    return {
        'summary': summary(figures),
        'machines': {
            item.name: {
                'runs': item.runs,
                'channels': {
                    channel: {
                        'rms_um': {row: 1e6 * item.rms[row][c] for row in ROWS},
                        'ratio': item.ratio[c],
                        'ratio_no_speed': item.ratio_no_speed[c],
                        'worse_than_none': item.worse[c],
                        'runs_worse_than_none': item.worse_runs[c],
                        'chosen': item.chosen(c),
                        'coverage': item.coverage[c],
                        'half_width_um': 1e6 * item.half_width[c],
                        'half_width_over_rms': item.width_ratio[c],
                    }
                    for c, channel in enumerate(item.channel)
                },
                'in_domain': {kind: item.inside(kind) for kind in ('good', *BAD)},
            }
            for item in figures
        },
        'held_out': [
            {
                'machine': item.machine,
                'run': item.name,
                'chosen': dict(zip(item.channel, item.chosen, strict=True)),
                'rms_um': {
                    row: (1e6 * np.sqrt(value)).tolist() for row, value in item.mean_square.items()
                },
                'coverage': item.covered.tolist(),
                'half_width_um': (1e6 * item.half_width).tolist(),
                'in_domain': item.inside,
            }
            for item in held_out
        ],
        'left_out': [vars(item) for item in failures],
    }


def micrometres(length: float) -> str:
    """Return a length in micrometres."""
    if not np.isfinite(length) or length > 1e-3:
        return 'diverged'
    return f'{1e6 * length:.2f}'


def table(heads: Sequence[str], lines: Sequence[Sequence[str]], text: Sequence[int]) -> list[str]:
    """Return a Markdown table whose columns are aligned, those of text to the left."""
    rows = [list(heads), *map(list, lines)]
    width = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    marks = [
        '-' * size if column in text else '-' * (size - 1) + ':'
        for column, size in enumerate(width)
    ]

    def line(cells: Sequence[str]) -> str:
        padded = [
            cell.ljust(size) if column in text else cell.rjust(size)
            for column, (cell, size) in enumerate(zip(cells, width, strict=True))
        ]
        return f'| {" | ".join(padded)} |'

    return [line(heads), line(marks), *map(line, lines)]


def in_processes(
    work: Callable[[Any, Progress], Any], shop: Sequence[Machine], jobs: int
) -> list[Any]:
    """Hold every run of every machine out in turn, side by side."""
    pieces = [
        Piece(machine.name, split, machine.interval)
        for machine in shop
        for split in machine.splits()
    ]
    names = [f'{piece.machine} {piece.split.name}' for piece in pieces]
    with progress_bar('comparing') as tell:
        return in_workers(work, pieces, names, jobs, tell)


def arguments(description: str) -> argparse.ArgumentParser:
    """Return the options that benchmarks over machines share."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        '--recordings',
        type=Path,
        action='append',
        default=[],
        metavar='DIR',
        help='folder with a folder of bags or CSV files per machine; repeat for more',
    )
    parser.add_argument(
        '--machines', default='', metavar='NAME,...', help='only these (default: all)'
    )
    parser.add_argument(
        '--seeds', type=int, default=SEEDS, help='recordings of each simulated machine'
    )
    parser.add_argument('--jobs', type=int, default=cores(), help='processes side by side')
    parser.add_argument('--markdown', type=Path, metavar='FILE', help='write the tables there too')
    parser.add_argument('--json', type=Path, metavar='FILE', help='write all figures there')
    return parser


def asked(description: str) -> tuple[argparse.Namespace, list[Machine]]:
    """Return the options and the machines that they ask for; what is wrong ends the program."""
    parser = arguments(description)
    options = parser.parse_args()
    for name in ('seeds', 'jobs'):
        if getattr(options, name) < 1:
            parser.error(f'--{name}: expected at least 1 but found {getattr(options, name)}')
    try:
        wanted = [name for name in options.machines.split(',') if name]
        return options, machines(options.recordings, options.seeds, wanted)
    except (ValueError, OSError) as error:
        parser.error(str(error))


def sorted_out(found: Sequence[Any]) -> tuple[list[Any], list[Failure], list[str]]:
    """Return what was judged, what failed, and a line for each that did; none ends the program."""
    failures = [item for item in found if isinstance(item, Failure)]
    held_out = [item for item in found if not isinstance(item, Failure)]
    left_out = [f'- left out: {item.machine} {item.name}: {item.reason}' for item in failures]
    if not held_out:
        sys.exit('error: expected a run to judge on but found none\n' + '\n'.join(left_out))
    return held_out, failures, left_out


def show(lines: Sequence[str], markdown: Path | None) -> None:
    """Print lines, and write them to a file if there is one."""
    text = '\n'.join(lines) + '\n'
    print(text, end='')
    if markdown is not None:
        write_text(markdown, text)


def main() -> None:
    """Print the tables and write them to files."""
    options, shop = asked('Leave-one-run-out on all machines at hand.')
    held_out, failures, left_out = sorted_out(in_processes(judge_piece, shop, options.jobs))
    names = dict.fromkeys(item.machine for item in held_out)
    figures = [
        MachineFigures([item for item in held_out if item.machine == name]) for name in names
    ]
    lines = ['Residual on held-out runs, root mean square [µm]:', '', *residual_table(figures)]
    lines += ['', 'Band of two standard deviations on held-out runs:', '', *band_table(figures)]
    lines += ['', 'Domain on held-out runs:', '', *domain_table(figures)]
    show([*lines, '', *summary_lines(figures), *left_out], options.markdown)
    write_json(options.json, document(figures, held_out, failures))


if __name__ == '__main__':
    main()

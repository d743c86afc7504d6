# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Chosen feeds against constant ones on a real LinuxCNC: time, deviation and contour error.

LinuxCNC runs each program without a screen, and HAL's `sampler` records the commanded positions of
every servo period.  Deviation is their distance from the true curve, not from its points.  The
simulated loops of LinuxCNC's joints are ideal, so the commands are also followed here by the
axes of the simulated machine: contour error is what those leave.  Run with
`python benchmarks/bench_linuxcnc_feedrate.py [--json FILE] [--plot FILE.png]`, as a user who may
start LinuxCNC.  Runs that FILE has are not made again, so that it may be stopped and started.
"""

import argparse
import json
import os
import re
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, replace
from math import exp, log
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / 'test' / 'support'))
sys.path.insert(0, str(Path(__file__).parents[1]))

from equipment.linuxcnc_trace import Judged, Recorder, cut_of, judge
from linuxcnc_feedrate_programs import Variant, program_of

from fuzzycnc_ros.adapters.linuxcnc.recorder import recording
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.curves import CURVES
from fuzzycnc_ros.studies.page.table import Column, Table

FEEDS = {
    'butterfly': (1500.0, 3000.0, 6000.0, 12000.0),
    'infinity': (1500.0, 3000.0, 6000.0, 12000.0),
    'part': (800.0, 1500.0, 3000.0, 6000.0),
}
"""Constant feeds by path, the last one the upper bound of chosen ones [mm/min]."""
MODES = ('P0.01', 'P0.001', 'P0.01 Q0')
TOLERANCES = (10.0, 50.0, 100.0)
COMPARED = 50.0
"""Tolerance [um] for which settings are looked for that leave the same error or take as long."""
STEPS = (0.0, 10.0, 25.0, 50.0)
ACCELERATIONS = (500.0, 1000.0)
"""Limits of LinuxCNC under which chosen feeds run too [mm/s^2]."""
INI_ACCELERATION = 2500.0
"""Limit of X and Y in the INI file [mm/s^2]."""
TIMEOUT = 300.0
CLOSE, TRIES = 0.05, 6
"""A search ends that near to its target, in shares of it, or after so many runs."""
STOPPED = 75
"""Exit status where time was up before all runs were made."""


class Stand:
    """A LinuxCNC that is started when a run is needed, and what all runs have shown.

    Parameters
    ----------
    memory : Path or None
        JSON file with runs that have been made.
    seconds : float
        Time after which no new run begins [s].
    """

    def __init__(self, memory: Path | None, seconds: float) -> None:
        self._memory, self._end = memory, time.monotonic() + seconds
        self.found: dict[str, dict[str, float]] = {}
        self.asked: dict[str, Variant] = {}
        if memory is not None and memory.exists():
            self.found = json.loads(memory.read_text())
        self._recorder: Recorder | None = None
        self._ending = ExitStack()

    def run(self, variant: Variant) -> Judged:
        """Run a variant, if that has not been done."""
        known = self.found.get(variant.name)
        self.asked[variant.name] = variant
        if known is None:
            if time.monotonic() > self._end:
                raise TimeoutError
            text, path = program_of(variant)
            judged = judge(cut_of(self._record(text, variant.acceleration)[:, :2]), path)
            words = len(re.findall(r'F\d', text))
            load = os.getloadavg()[0]
            self.found[variant.name] = known = {**asdict(judged), 'words': words, 'load': load}
            print(f'{variant.name}: {judged.duration:.3f} s', file=sys.stderr, flush=True)
            if self._memory is not None:
                self._memory.write_text(json.dumps(self.found, indent=1))
        return Judged(**{name: known[name] for name in Judged.__dataclass_fields__})

    def close(self) -> None:
        """End LinuxCNC."""
        self._ending.close()

    def _record(self, text: str, acceleration: float) -> Array:
        if self._recorder is None:
            self._recorder = self._ending.enter_context(recording())
        for name in ('x', 'y', '0', '1'):
            limit = f'{acceleration or INI_ACCELERATION:.6f}'
            self._recorder.halcmd('setp', f'ini.{name}.max_acceleration', limit)
        return self._recorder.run(text, TIMEOUT)


def plain(path: str) -> list[Variant]:
    """Return the variants of a path that need no search."""
    feeds, found = FEEDS[path], []
    for mode in MODES if path in CURVES else MODES[::2]:
        main = mode == MODES[0]
        found += [Variant(path, 'lines', mode, feed) for feed in (feeds if main else feeds[1::2])]
        tolerances = TOLERANCES if main else TOLERANCES[:2]
        found += [Variant(path, 'lines', mode, feeds[-1], one) for one in tolerances]
    chosen = Variant(path, 'lines', MODES[0], feeds[-1], COMPARED)
    found += [replace(chosen, step=step) for step in STEPS]
    found += [replace(chosen, acceleration=limit) for limit in ACCELERATIONS]
    forms = {'chords': (0.0, *TOLERANCES), 'G5.2': (0.0, COMPARED)}
    for form, tolerances in (forms if path in CURVES else {'rests': (0.0, *TOLERANCES)}).items():
        found += [Variant(path, form, MODES[0], feeds[-1], one) for one in tolerances]
    return [*found, Variant(path, 'lines', 'G61', feeds[-1])]


def seek(
    stand: Stand,
    make: Callable[[float], Variant],
    value: Callable[[Judged], float],
    target: float,
    knob: float,
    power: float,
) -> Variant:
    """Turn a knob until a value is near its target.

    Parameters
    ----------
    make : callable
        Variant at a setting of the knob.
    value : callable
        What is to reach the target.
    knob : float
        First setting.
    power : float
        With which power of the knob the value goes, about.
    """
    points: list[tuple[float, float, Variant]] = []
    for _ in range(TRIES):
        variant = make(float(f'{knob:.4g}'))
        off = log(value(stand.run(variant)) / target)
        points = sorted([*points, (off, log(knob), variant)], key=lambda one: abs(one[0]))
        if abs(off) < CLOSE:
            break
        slope = power
        if len(points) > 1 and points[0][1] != points[1][1]:
            measured = (points[0][0] - points[1][0]) / (points[0][1] - points[1][1])
            slope = measured if 0.2 < measured / power < 5.0 else power
        knob = exp(points[0][1] - points[0][0] / slope)
    return points[0][2]


def compare(stand: Stand, path: str) -> list[tuple[str, Variant]]:
    """Return what leaves the same contour error as chosen feeds, and what takes as long."""
    mode, feeds = MODES[0], FEEDS[path]
    chosen = Variant(path, 'lines', mode, feeds[-1], COMPARED)
    ours = stand.run(chosen)
    constant = Variant(path, 'lines', mode, feeds[-1])
    slow = stand.run(replace(constant, feed=feeds[0]))

    def fed(feed: float) -> Variant:
        return replace(constant, feed=min(feed, feeds[-1]))

    def braked(acceleration: float) -> Variant:
        return replace(constant, acceleration=acceleration)

    def error(one: Judged) -> float:
        return one.contour

    def time_taken(one: Judged) -> float:
        return one.duration

    as_long = feeds[0] * slow.duration / ours.duration
    as_near = feeds[0] * (ours.contour / slow.contour) ** 0.5
    return [
        ('chosen feeds', chosen),
        ('constant feed, same time', seek(stand, fed, time_taken, ours.duration, as_long, -1.0)),
        ('lower acceleration, same error', seek(stand, braked, error, ours.contour, 300.0, 1.0)),
        ('constant feed, same error', seek(stand, fed, error, ours.contour, as_near, 2.0)),
    ]


def row(stand: Stand, variant: Variant) -> tuple[str, ...]:
    """Return the figures of a run as cells."""
    one = stand.run(variant)
    return (
        f'{one.duration:.2f}',
        f'{1e6 * one.deviation:.1f}',
        f'{1e6 * one.deviation_rms:.1f}',
        f'{1e6 * one.contour:.1f}',
        f'{1e6 * one.contour_rms:.1f}',
        f'{one.acceleration:.2f}',
        f'{one.jerk:.0f}',
        f'{stand.found[variant.name]["words"]:.0f}',
    )


def title(variant: Variant) -> tuple[str, str]:
    """Return how a variant is called in a table: its feeds, and how LinuxCNC takes them."""
    feeds = f'F{variant.feed:.0f}'
    if variant.tolerance:
        feeds = f'chosen for {variant.tolerance:g} um, step {variant.step:g} %'
    if variant.acceleration:
        feeds += f', {variant.acceleration:.0f} mm/s^2'
    mode = variant.mode if variant.mode == 'G61' else f'G64 {variant.mode}'
    return feeds, mode if variant.form == 'lines' else f'{mode}, {variant.form}'


def table(name: str, first: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    """Return a table of runs."""
    headings = ('time s', 'deviation um', 'rms', 'contour error um', 'rms', 'm/s^2', 'm/s^3', 'F')
    columns = tuple(Column(heading, numeric=False) for heading in first)
    return Table(name, columns + tuple(map(Column, headings)), tuple(rows))


def series(variant: Variant) -> str:
    """Return which kind of run a variant is in the plot."""
    if variant.mode == 'G61':
        return 'constant feed, G61'
    if variant.acceleration:
        return f'{"chosen" if variant.tolerance else "constant"} feed, lower acceleration'
    if not variant.tolerance:
        return 'constant feed' if variant.form == 'lines' else 'constant feed, other blocks'
    if variant.form != 'lines':
        return f'chosen feeds, {variant.form}'
    return 'chosen feeds' if variant.step == Variant.step else 'chosen feeds, other steps'


def plot(stand: Stand, target: Path) -> None:
    """Draw time against contour error and against deviation, all runs of each path."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    from fuzzycnc_ros.studies.page.drawing import CLUSTER_COLOURS, plot_style

    kinds = sorted({series(one) for one in stand.asked.values()})
    with plot_style():
        figure = Figure(figsize=(10.0, 5.8), layout='constrained')
        panels = figure.subplots(2, len(FEEDS)).flat
        handles: dict[str, object] = {}
        for index, axes in enumerate(panels):
            path = list(FEEDS)[index % len(FEEDS)]
            value = 'contour' if index < len(FEEDS) else 'deviation'
            for kind, colour, marker in zip(kinds, CLUSTER_COLOURS, 'osD^vP*XhH', strict=False):
                runs = [
                    (stand.found[name][value], stand.found[name]['duration'])
                    for name, one in stand.asked.items()
                    if one.path == path and series(one) == kind
                ]
                if runs:
                    error, time_taken = zip(*runs, strict=True)
                    (handles[kind],) = axes.plot(
                        [1e6 * one for one in error],
                        time_taken,
                        marker,
                        color=colour,
                        markersize=4.0,
                        alpha=0.8,
                    )
            axes.set(xscale='log', yscale='log', title=path if index < len(FEEDS) else '')
            axes.set_xlabel('contour error [um]' if value == 'contour' else 'deviation [um]')
            axes.set_ylabel('time [s]')
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter('{x:g}')
                axis.set_minor_formatter(NullFormatter())
        figure.legend(handles.values(), handles, loc='outside upper left', ncols=4)
        figure.savefig(target, dpi=120, facecolor='white')


def main() -> int:
    """Make all runs that are not known yet, and print tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--json', type=Path, help='runs that were made, and where new ones go')
    parser.add_argument('--plot', type=Path, help='picture of time against contour error')
    parser.add_argument('--seconds', type=float, default=1e9, help='time for new runs')
    arguments = parser.parse_args()
    stand = Stand(arguments.json, arguments.seconds)
    try:
        tables = []
        for path in FEEDS:
            rows = [(*title(one), *row(stand, one)) for one in plain(path)]
            tables.append(table(path, ('feeds', 'mode'), rows))
        for path in reversed(FEEDS):  # the longest runs last
            rows = [(what, title(one)[0], *row(stand, one)) for what, one in compare(stand, path)]
            name = f'{path}, G64 {MODES[0]}, feeds chosen for {COMPARED:g} um'
            tables.append(table(name, ('', 'setting'), rows))
    except TimeoutError:
        print(f'stopped after {arguments.seconds:g} s; start again to go on', file=sys.stderr)
        return STOPPED
    finally:
        stand.close()
    if arguments.plot is not None:
        plot(stand, arguments.plot)
    for one in tables:
        print(f'\n{one.to_text()}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

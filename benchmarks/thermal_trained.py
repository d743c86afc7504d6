# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a machine leaves that was calibrated and is probed now and then: one table.

A model is trained without what is judged, as `fuzzycnc train` does by itself; learning begins with
the prior in its file.  Each run is held out in turn (of a single run its thermal cycles), or with
`--train N` the first N runs are trained on and the others judged in their order.  Printed are, as
geometric means over channels and held-out runs,

- what hourly probes leave, and the same over the better of two plain filters of the model's
  prediction: an offset that each probe resets, and a Kalman filter of offset and gain,
- what is left without probes, over lagged ridge alone and over plain ridge alone,
- what the model alone leaves, over both,

and the share of samples in the band and its half width over the error, in each part of a run.

Run with `python benchmarks/thermal_trained.py [--machine NAME] [--recordings DIR] [--train N]`.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from thermal_learning import NOISE, show
from thermal_recordings import Machine, machines

from fuzzycnc_ros.cli.console import progress_bar
from fuzzycnc_ros.core.thermal.band import WIDTH
from fuzzycnc_ros.core.thermal.fit.comparison import Split
from fuzzycnc_ros.core.thermal.fit.training import at_interval, train_model
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.run import ThermalRun, speed_known

EVERY = 3600.0
FIRST = 4
LEARNT, UNPROBED, OFFSET, KALMAN = 'learnt', 'unprobed', 'offset', 'kalman'
MODEL, LAGGED, PLAIN = 'model', 'lag_ridge', 'static_ridge'
PHASES = (UNPROBED, 'first_four', 'later')

PRIOR = np.diag([4e-12, 0.02])
"""Variances of offset [m^2] and gain [-] before the first probe, of the Kalman filter."""
RATE = np.diag([0.05e-12 / 60.0, 1e-4 / 60.0])
"""Their growth with time [m^2/s, 1/s]."""


class Judged(NamedTuple):
    """Mean squares of a channel of a held-out run by row [m^2], and its bands.

    `inside`, `half` and `left` belong to the parts of the run: share of samples in the band,
    mean square of its half width and of what was left [m^2], each with the number of samples.
    """

    square: dict[str, float]
    inside: dict[str, float]
    half: dict[str, float]
    left: dict[str, float]
    count: dict[str, int]


class Kalman:
    """Offset and gain of one channel's prediction."""

    def __init__(self) -> None:
        self._state, self._covariance = np.zeros(2), PRIOR.copy()

    def corrected(self, predicted: float) -> float:
        """Return a prediction with offset and gain."""
        return predicted + float(np.array([1.0, predicted]) @ self._state)

    def update(self, predicted: float, measured: float, elapsed: float) -> None:
        """Learn from a probe, so long after the one before."""
        self._covariance = self._covariance + elapsed * RATE
        row = np.array([1.0, predicted])
        across = self._covariance @ row
        gain = across / (row @ across + NOISE * NOISE)
        self._state = self._state + gain * (measured - self.corrected(predicted))
        self._covariance = self._covariance - np.outer(gain, across)


def followed(
    model: ThermalModel, run: ThermalRun, inside: np.ndarray, seed: int
) -> Iterator[Judged]:
    """Let all ways follow a run, probed every hour while it is judged; yield each channel."""
    rise = model.rises(run)
    alone = {name: model.recursion(name).run(rise) for name in (LAGGED, PLAIN)}
    alone[MODEL] = model.recursion().run(rise)
    assert model.prior is not None
    share = np.array(model.prior.share)
    speeds = run.spindle_speed if speed_known(run) else np.zeros(len(run.time))
    learner, blind = (model.prior.learner(model.channel) for _ in range(2))
    channels = len(model.channel)
    kalman, offset = [Kalman() for _ in range(channels)], np.zeros(channels)
    shape = run.displacement.shape
    predicted = {name: np.full(shape, np.nan) for name in (LEARNT, UNPROBED, OFFSET, KALMAN)}
    deviation = {name: np.full(shape, np.nan) for name in (LEARNT, UNPROBED)}
    number = np.zeros(shape, dtype=np.int64)
    noise = NOISE * np.random.default_rng(seed).standard_normal(shape)
    due, taken = np.full(channels, run.time[inside][0] + EVERY), np.zeros(channels, dtype=int)
    probed_at = np.full(channels, run.time[0])
    for row, time in enumerate(run.time):
        by_model = alone[MODEL][row]
        for name, item in ((LEARNT, learner), (UNPROBED, blind)):
            item.step(rise[row, : len(model.inputs)], float(speeds[row]), time - run.time[0])
            expected, deviation[name][row] = item.predict()
            predicted[name][row] = share * by_model + expected
        predicted[OFFSET][row] = by_model + offset
        predicted[KALMAN][row] = [
            item.corrected(value) for item, value in zip(kalman, by_model, strict=True)
        ]
        number[row] = taken
        measured = run.displacement[row] + noise[row]
        probed = inside[row] & np.isfinite(measured) & (time >= due - 1.0)
        if not probed.any():
            continue
        learner.probe(
            np.where(probed, measured - share * by_model, np.nan), np.full(channels, NOISE)
        )
        for channel in np.flatnonzero(probed):
            kalman[channel].update(by_model[channel], measured[channel], time - probed_at[channel])
        offset = np.where(probed, measured - by_model, offset)
        due, taken = np.where(probed, time + EVERY, due), taken + probed
        probed_at = np.where(probed, time, probed_at)
    parts = {
        UNPROBED: (inside[:, np.newaxis] & np.ones(shape, dtype=bool), UNPROBED),
        'first_four': (inside[:, np.newaxis] & (number > 0) & (number <= FIRST), LEARNT),
        'later': (inside[:, np.newaxis] & (number > FIRST), LEARNT),
    }
    for channel in range(channels):
        truth = run.displacement[:, channel]
        counted = inside & np.isfinite(truth)
        if not counted.any():
            continue
        square = {
            name: float(np.mean((values[counted, channel] - truth[counted]) ** 2.0))
            for name, values in (predicted | alone).items()
        }
        found: tuple[dict[str, float], ...] = ({}, {}, {})
        count = {}
        for name, (rows, way) in parts.items():
            own = rows[:, channel] & counted
            if not own.any():
                continue
            left = predicted[way][own, channel] - truth[own]
            half = WIDTH * deviation[way][own, channel]
            count[name] = int(own.sum())
            for place, value in zip(
                found,
                (np.mean(np.abs(left) <= half), np.mean(half**2.0), np.mean(left**2.0)),
                strict=True,
            ):
                place[name] = float(value)
        yield Judged(square, *found, count)


def pieces(machine: Machine, train: int) -> list[Split]:
    """Return what is trained on and judged."""
    if not train:
        return machine.splits()
    return [
        Split(run.name, tuple(runs[:train]), run) for runs in machine.sets for run in runs[train:]
    ]


def judged(machine: Machine, train: int, seeds: int) -> list[Judged]:
    """Return all channels of all held-out runs."""
    found, known = [], {}
    for split in pieces(machine, train):
        key = tuple(id(run) for run in split.training)
        if key not in known:
            known = {key: train_model(split.training, interval=machine.interval)}
        model = known[key]
        run = at_interval(split.held_out, model.interval)
        inside = run.inside(split.start, split.stop)
        for seed in range(seeds):
            found += followed(model, run, inside, seed)
    return found


def row_of(name: str, found: Sequence[Judged]) -> tuple[str, ...]:
    """Return the row of a machine."""

    def mean(*names: str) -> float:
        squares = [min(item.square[name] for name in names) for item in found]
        return float(np.exp(0.5 * np.mean(np.log(squares))))

    hourly, unprobed = mean(LEARNT), mean(UNPROBED)
    filters = min(mean(OFFSET), mean(KALMAN))
    cells = [f'{1e6 * hourly:.2f}', f'{hourly / filters:.2f}', f'{1e6 * unprobed:.2f}']
    cells += [f'{unprobed / mean(LAGGED):.2f}', f'{unprobed / mean(PLAIN):.2f}']
    cells += [f'{mean(MODEL) / mean(LAGGED):.2f}', f'{mean(MODEL) / mean(PLAIN):.2f}']
    for part in PHASES:
        own = [item for item in found if part in item.count]
        weight = [item.count[part] for item in own]
        if not own:
            cells.append('-')
            continue
        inside = np.average([item.inside[part] for item in own], weights=weight)
        # Width over error of each channel, and the geometric mean over them.
        ratio = np.exp(0.5 * np.mean([np.log(item.half[part] / item.left[part]) for item in own]))
        cells.append(f'{100.0 * inside:.0f} % x {ratio:.1f}')
    return (name, *cells)


HEADER = (
    *('machine', 'hourly', 'over filters', 'unprobed', 'over `lag_ridge`', 'over ridge'),
    *('model alone over `lag_ridge`', 'over ridge', *PHASES),
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description='Calibrated machines, probed every hour.')
    parser.add_argument('--recordings', type=Path, action='append', default=[], metavar='DIR')
    parser.add_argument('--machine', action='append', default=[], metavar='NAME')
    parser.add_argument('--train', type=int, default=0, metavar='N')
    parser.add_argument('--first', type=int, default=0, metavar='N', help='use the first N runs')
    parser.add_argument('--seeds', type=int, default=3, metavar='N')
    parser.add_argument('--markdown', type=Path, metavar='FILE')
    options = parser.parse_args()
    rows = []
    with progress_bar('calibrated') as tell:
        known = machines(options.recordings, options.seeds, options.machine)
        for number, machine in enumerate(known):
            tell(machine.name, number, len(known))
            used = tuple(runs[: options.first or None] for runs in machine.sets)
            own = Machine(machine.name, used)
            seeds = options.seeds if len(own.sets) == 1 else 1
            rows.append(row_of(machine.name, judged(own, options.train, seeds)))
    show(HEADER, rows, options.markdown)


if __name__ == '__main__':
    main()

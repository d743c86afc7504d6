# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of strangers: recorded, identified and tuned by the documented way, judged on themselves.

Twenty axes drawn by a seeded generator that was written from mechanics alone
(`test/support/strangers`).  Each is recorded as `fuzzycnc machine excite` writes it, once by set
points through a loop that exists and once by duties; identified; tuned.  What is written is judged
on the true axis at half, nominal and one and a half times its gain, beside the untuned default of
the same file and the best of 64 trials on the true axis itself.

Seeds below 20, 26, 200 to 227, 500 to 502, 600 to 619 and 659 were looked at in development; the
others were not.  Prints a row for each and what was asked for beside what came out.  Run with
`python benchmarks/bench_strangers.py 20 40`; an axis takes two minutes or so.  `--trials 0` leaves
the trials on the true axis out, `--identify-only` all controllers; `--json FILE` keeps the rows.
`--on-machine` goes on from what is written with `servo tune --on-machine`, driven as the node
drives an axis.
"""

import os

# One thread each, set before numpy starts its pool: the searches share the processors.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import argparse
import json
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from math import exp, inf, isfinite, log
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test' / 'support'))
from benches.trial_bench import TriedAxis
from strangers.axes import PERIOD, Axis, draw, search_best, stable

from fuzzycnc_ros.core.identify.axis_data import IdentifiedAxis, identify_axis
from fuzzycnc_ros.core.identify.axis_fit import AxisRecording
from fuzzycnc_ros.core.identify.excitation import (
    ExcitationLimits,
    duty_program,
    position_program,
)
from fuzzycnc_ros.core.machine.machine_data import AxisData, AxisLimits
from fuzzycnc_ros.core.servo.axis_control import (
    AXIS_CONTROLLERS,
    SETTINGS,
    UNTUNED_CONTROLLER,
    make_axis_controller,
)
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.simulation.servo.axis_trials import TrialSearch
from fuzzycnc_ros.simulation.servo.axis_tuning import (
    AxisTuning,
    axis_cases,
    tune_controller,
    untuned_controllers,
)

GAINS = (0.5, 1.0, 1.5)
"""Factors on the true gain."""

TOLD, PERIODS = 4.0, 0.5
"""Ends of an interval up to which a dead time counts as told: their ratio, or the upper one in
periods."""

WAYS = ('duty', 'loop')
"""How an axis is recorded: by duties, or by set points through a loop that exists."""


class Driven:
    """A controller as the judge drives it: by set point, speed and reading."""

    def __init__(self, controller: AxisController) -> None:
        self._controller, self._speed, self._begun = controller, 0.0, False

    def step(self, setpoint: float, velocity: float, measured: float) -> float:
        """Return the duty of a period."""
        if not self._begun:
            self._controller.reset(measured)
            self._begun = True
        rise, self._speed = (velocity - self._speed) / PERIOD, velocity
        return self._controller.step(setpoint, measured, velocity, rise)


def recorded(axis: Axis, how: str) -> AxisRecording:
    """Return a recording of an axis as `machine excite` asks for it."""
    low, high = axis.truth['limits']
    limits = ExcitationLimits(
        low=0.8 * low,
        high=0.8 * high,
        velocity=axis.truth['speed_max'],
        acceleration=axis.truth['accel_max'],
    )
    if how == 'loop':
        _, commanded, actual, duty = axis.through_loop(position_program(limits, PERIOD), seed=1)
        return AxisRecording(duty, actual, PERIOD, commanded)
    series = duty_program(limits, PERIOD)
    _, actual, duty = axis.open_loop(series, seed=1)
    return AxisRecording(duty, actual, PERIOD, series)


def true_error(axis: Axis, data: AxisData, name: str, settings: dict[str, float]) -> float:
    """Return the geometric mean of the errors over the gains [m]; infinite if one is unstable."""
    found = []
    for gain in GAINS:
        make = partial(_driven, data, name, settings)
        good, rms, _ = stable(axis, make, gain)
        if not good:
            return inf
        found.append(log(rms))
    return exp(sum(found) / len(found))


def _driven(data: AxisData, name: str, settings: dict[str, float]) -> Driven:
    return Driven(make_axis_controller(data, name, settings))


def best_on_the_axis(axis: Axis, data: AxisData, trials: int) -> float:
    """Return the least error of trials on the true axis, over PID and cascade [m]."""
    if not trials:
        return inf
    bounds = {name: (low, high) for name, (low, high, _) in SETTINGS.items()}
    bounds['bandwidth'] = 0.05, bounds['bandwidth'][1]
    names = ('pid', 'cascade')
    return min(
        search_best(
            axis,
            lambda parameters, name=name: _driven(data, name, parameters),
            bounds,
            trials=trials // len(names),
        ).cost
        for name in names
    )


def tried(axis: Axis, data: AxisData) -> dict[str, Any]:
    """Return what trials on the axis itself find, from the controller that is there on.

    `tried` is its error [m], infinite where it is not stable; `tried_refused` why there is none.
    `largest` is how far the axis was ever from where it was told to be [m], `faults` how often the
    node gave it up.
    """
    itself = axis.copy()
    itself.reset(0.0, seed=2)
    data = replace(data, limits=replace(data.limits, vertical=axis.truth['vertical']))
    drive = TriedAxis(data, itself.step)
    try:
        found = TrialSearch(data, drive).run().tuned(data)
    except ValueError as error:
        return {'tried_refused': str(error), 'tried': inf}
    return {
        'tried_refused': '',
        'tried_by': found.controller,
        'tried': true_error(axis, data, found.controller, dict(found.settings)),
        'largest': drive.largest,
        'faults': len(drive.faults),
    }


def judged(piece: tuple[int, str, int, int, int, bool, bool]) -> dict[str, Any]:
    """Return the row of an axis: what is told, what is written, what it is worth."""
    seed, how, generations, population, trials, on_machine, identify_only = piece
    warnings.simplefilter('ignore')
    axis = draw(seed)
    truth = axis.truth
    row: dict[str, Any] = {'seed': seed, 'kind': truth['kind'], 'how': how, 'refused': ''}
    try:
        recording = recorded(axis, how)
    except RuntimeError:  # the generator has no loop that this axis could come with
        return row | {'skipped': True}
    low, high = truth['limits']
    limits = AxisLimits(
        velocity=truth['speed_max'],
        acceleration=truth['accel_max'],
        travel_low=low,
        travel_high=high,
    )
    found = identify_axis([recording])
    data = replace(found.data, limits=replace(limits, resonance=found.data.limits.resonance))
    row |= _told(found, truth) | {'flexible': truth['resonance_hz'] is not None}
    if identify_only:
        return row | {'untuned': inf, 'written': inf, 'best': inf, 'refused': 'not tuned'}
    plain = replace(data, knowledge=replace(data.knowledge, not_fit_for_control=''))
    row['untuned'] = true_error(axis, plain, UNTUNED_CONTROLLER, {})
    row['best'] = best_on_the_axis(axis, plain, trials)
    row['written'] = inf
    try:
        data.known_plant()
        tuned = [
            tune_controller(data, name, generations=generations, population=population)
            for name in AXIS_CONTROLLERS
        ]
        untuned = untuned_controllers(data, AXIS_CONTROLLERS)
        winner = AxisTuning((*tuned, *untuned), axis_cases(data, held_out=True)).tuned(data)
    except ValueError as error:
        row['refused'] = str(error)
        return row
    row['controller'], row['settings'] = winner.controller, dict(winner.settings)
    row['written'] = true_error(axis, data, winner.controller, dict(winner.settings))
    if on_machine:
        row |= tried(axis, winner)
    return row


def _told(found: IdentifiedAxis, truth: dict[str, Any]) -> dict[str, Any]:
    """Return what was stated of resonance and dead time, and whether it is true."""
    linear = found.linear
    if linear is None:
        return {'mode': 'unknown', 'mode_true': True, 'delay': 'unknown', 'delay_true': True}
    mode, late = linear.mode, linear.late
    resonance = truth['resonance_hz'] or inf
    # the force of a cylinder lags by its mode
    lag = truth['valve_lag'] if truth['kind'] == 'hydraulic' else truth['force_lag']
    delay = truth['dead_time'] + lag
    told = late.high <= TOLD * late.low or late.high < PERIODS * PERIOD
    row: dict[str, Any] = {
        'mode': f'{mode.low:.3g}-{mode.high:.3g}' if linear.resonance_known else 'unknown',
        'mode_true': mode.low <= resonance <= mode.high,
        'delay': f'{1e3 * late.low:.2g}-{1e3 * late.high:.2g}' if told else 'unknown',
        'delay_true': late.low <= delay <= late.high,
        'known_to': linear.known_to,
    }
    if linear.resonance_known:
        row['mode_width'] = mode.high / mode.low
    if told and late.low:
        row['delay_width'] = late.high / late.low
    return row


def row_text(row: dict[str, Any]) -> str:
    """Return the line of an axis; what is stated and wrong has a mark."""
    errors = ' '.join(f'{1e6 * row[key]:9.1f}' for key in ('untuned', 'written', 'best'))
    marks = [' ' if row['mode_true'] else '!', ' ' if row['delay_true'] else '!']
    tried = ''
    if 'tried' in row:
        tried = f' on the machine {1e6 * row["tried"]:.1f} {row["tried_refused"]}'
    return (
        f'{row["seed"]:3} {row["kind"]:20} {row["how"]:5} {row["mode"]:>12}{marks[0]} '
        f'{row["delay"]:>11}{marks[1]} {errors} {row.get("controller", "")} {row["refused"]}'
        f'{tried}'
    )


def shown(rows: list[dict[str, Any]]) -> None:
    """Print rows and what they amount to."""
    print(
        f'{"axis":24} {"how":5} {"mode [Hz]":>12} {"delay [ms]":>11} {"untuned":>9} '
        f'{"written":>9} {"trials":>9} [um]'
    )
    for row in rows:
        print(row_text(row))
    seeds = {row['seed'] for row in rows}
    for how in WAYS:
        here = [row for row in rows if row['how'] == how]
        kept = [row for row in here if not row['refused']]
        unstable = [row for row in kept if not isfinite(row['written'])]
        refused = [row for row in here if row['refused']]
        though = [row for row in refused if isfinite(row['untuned'])]
        worse = [row for row in kept if row['written'] > 1.1 * row['untuned']]
        both = [
            log(row['written'] / row['best'])
            for row in kept
            if isfinite(row['written']) and isfinite(row['best'])
        ]
        flexible = [row for row in here if row['flexible']]
        told = sum(row['delay_true'] for row in here), sum(row['mode_true'] for row in here)
        unknown = (
            sum(row['delay'] == 'unknown' for row in here),
            sum(row['mode'] == 'unknown' for row in flexible),
        )
        widths = [
            float(np.median([row[key] for row in here if key in row] or [inf]))
            for key in ('delay_width', 'mode_width')
        ]
        print(
            f'{how}: of {len(here)} written {len(kept)}, of these unstable {len(unstable)} (0); '
            f'refused {len(refused)} (3 of 20), of these the untuned default controls '
            f'{len(though)} (0); worse than it by more than 10 % {len(worse)} (0); '
            f'over trials on the true axis x{exp(float(np.mean(both))) if both else inf:.2f} '
            f'(1.30)'
        )
        print(
            f'{how}: intervals of dead time and resonance that hold the truth {told[0]} and '
            f'{told[1]} of {len(here)} (95 %); unknown {unknown[0]} of {len(here)} and '
            f'{unknown[1]} of {len(flexible)} that have one (half); ends of the others apart by '
            f'a factor of {widths[0]:.2f} and {widths[1]:.2f} in the median (2)'
        )
        _shown_tried(how, [row for row in kept if 'tried' in row])
    print(f'{len(seeds)} axes')


def _shown_tried(how: str, rows: list[dict[str, Any]]) -> None:
    """Print what trials on the machine amount to."""
    if not rows:
        return
    there = [row for row in rows if not row['tried_refused']]
    good = [row for row in there if isfinite(row['tried'])]
    both = [log(row['tried'] / row['best']) for row in good if isfinite(row['best'])]
    print(
        f'{how}, on the machine: of {len(rows)} tried {len(there)}, of these unstable '
        f'{len(there) - len(good)} (0); over trials on the true axis '
        f'x{exp(float(np.mean(both))) if both else inf:.2f} (1.10); faults of the node '
        f'{sum(row["faults"] for row in there)}'
    )


def main() -> int:
    """Judge the axes that are asked for."""
    options = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    options.add_argument('first', type=int, nargs='?', default=20)
    options.add_argument('last', type=int, nargs='?', default=40)
    options.add_argument('--generations', type=int, default=2)
    options.add_argument('--population', type=int, default=4)
    options.add_argument('--trials', type=int, default=64, help='on the true axis; 0 for none')
    options.add_argument('--jobs', type=int, default=os.cpu_count())
    options.add_argument('--how', choices=WAYS, action='append')
    options.add_argument('--on-machine', action='store_true')
    options.add_argument('--identify-only', action='store_true', help='without controllers')
    options.add_argument('--json', type=Path)
    asked = options.parse_args()
    pieces = [
        (
            seed,
            how,
            asked.generations,
            asked.population,
            asked.trials,
            asked.on_machine,
            asked.identify_only,
        )
        for seed in range(asked.first, asked.last)
        for how in asked.how or WAYS
    ]
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(asked.jobs) as workers:
        for row in workers.map(judged, pieces):
            if row.get('skipped'):
                print(f'{row["seed"]}: no loop that it could come with', file=sys.stderr)
                continue
            rows.append(row)
            print(row_text(row), file=sys.stderr, flush=True)
    shown(rows)
    if asked.json is not None:
        asked.json.write_text(json.dumps(rows, indent=1) + '\n')
    if asked.identify_only:
        return 0
    good = [not row['refused'] or not isfinite(row['untuned']) for row in rows]
    stays = [bool(row['refused']) or isfinite(row['written']) for row in rows]
    return 0 if all(good) and all(stays) else 1


if __name__ == '__main__':
    raise SystemExit(main())

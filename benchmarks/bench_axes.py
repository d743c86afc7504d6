# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Three axes that nothing was made for: identified, tuned and judged, each from one recording.

Each has two masses with a spring, friction that falls with speed, dead time, and backlash or
cogging; the model that is identified has one mass.  A weak loop moves the axis about for 12 s, and
from duty and position alone follow its machine data.  On these PID with feedforward, cascade,
linear tangent and variable universe are tuned with the same number of trials, and one of them
would be written into the machine file.  All are judged on the axis itself: moves, steps and pulses
of load that nothing was tuned on, gains from half to twice.

Prints a table for each axis.  Fails if the one that is written leaves errors 5 % above those of
PID or cascade, or gives up in a case in which the PID does not.  Run with
`python benchmarks/bench_axes.py`; it takes some minutes.
"""

import os

# One thread each, set before numpy starts its pool: the searches share the processors.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from time import monotonic

from fuzzycnc_ros.core.identify.axis_data import identify_axis
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis_control import AXIS_CONTROLLERS
from fuzzycnc_ros.simulation.servo.axis_tuning import (
    AxisCase,
    AxisTuning,
    TunedController,
    axis_cases,
    judged_controller,
    load_time,
    tune_controller,
)
from fuzzycnc_ros.studies.servo.axis_tuning_tables import LABELS

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test' / 'support'))
from two_mass_axis import UNSEEN, TwoMassAxis, TwoMassConfig, operated

RECORDED = 12.0
"""Length of the recording [s]."""

SEEDS = (1, 2)
"""Of the cases on the axis itself; those on the model have 0."""

WORSE = 1.05
"""Errors over those of PID and cascade up to which the one that is written is as good [-]."""


def identified(name: str) -> AxisData:
    """Return what a recording tells of an axis, and the force at full duty on its plate."""
    config = UNSEEN[name]
    rigid = config.force / (config.motor + config.slide)
    recording = operated(TwoMassAxis(config), rigid, RECORDED, seed=1)
    return identify_axis([recording], force=config.force).data


def axis_itself(config: TwoMassConfig, data: AxisData, case: AxisCase) -> TwoMassAxis:
    """Return the axis as it is in a case."""
    return TwoMassAxis(
        replace(
            config,
            gain=case.gain,
            coulomb=case.friction * config.coulomb,
            breakaway=case.friction * config.breakaway,
            load=case.load,
            load_time=load_time(data, case, config.period),
            seed=case.seed,
        )
    )


def tuned(piece: tuple[str, AxisData, str]) -> tuple[TunedController, TunedController]:
    """Return a controller with its figures on the model, and with those on the axis itself."""
    name, data, kind = piece
    model = tune_controller(data, kind)
    runs = [
        judged_controller(
            data,
            kind,
            model.settings,
            seed=seed,
            plant=lambda case: axis_itself(UNSEEN[name], data, case),
        )
        for seed in SEEDS
    ]
    return model, replace(model, held_out=tuple(one for run in runs for one in run.held_out))


def shown(name: str, data: AxisData, pairs: list[tuple[TunedController, TunedController]]) -> bool:
    """Print the table of an axis; return whether what is written is as good as it has to be."""
    models, real = zip(*pairs, strict=True)
    written = AxisTuning(models, axis_cases(data, held_out=True)).winner.name
    found = {one.name: one for one in real}
    own, pid = found[written], found['pid']
    print(f'{name}: {len(own.held_out)} cases on the axis, {own.trials} trials each')
    print(f'{"":28} {"errors [um]":>12} {"over the best":>14} {"gave up":>8}')
    best = min(real, key=lambda one: one.error)
    for one in real:
        mark = '  written into the file' if one is own else ''
        ratio, spread = one.against(best)
        against = 'best' if one is best else f'x{ratio:.2f} ({spread:.2f})'
        print(f'{LABELS[one.name]:28} {1e6 * one.error:12.3g} {against:>14} {one.faults:8}{mark}')
    alone = sum(
        bool(mine.fault) and not its.fault
        for mine, its in zip(own.held_out, pid.held_out, strict=True)
    )
    good = not alone and all(own.against(found[rival])[0] <= WORSE for rival in RIVALS)
    if not good:
        print(
            f'expected at most {WORSE:g} times the errors of PID and cascade, and no fault alone'
        )
    return good


RIVALS = ('pid', 'cascade')
"""What the one that is written has to be as good as."""


def main() -> int:
    """Print all tables and the time; fail if an axis would get a controller that is not good."""
    begin = monotonic()
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        data = dict(zip(UNSEEN, workers.map(identified, UNSEEN), strict=True))
        known = monotonic() - begin
        pieces = [(name, data[name], kind) for name in UNSEEN for kind in AXIS_CONTROLLERS]
        pairs = list(workers.map(tuned, pieces))
    each = len(AXIS_CONTROLLERS)
    good = [
        shown(name, data[name], pairs[each * place : each * (place + 1)])
        for place, name in enumerate(UNSEEN)
    ]
    print(f'{known:.0f} s to identify, {monotonic() - begin:.0f} s in all, for {len(good)} axes')
    return 0 if all(good) else 1


if __name__ == '__main__':
    raise SystemExit(main())

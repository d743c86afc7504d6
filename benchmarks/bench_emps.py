# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The EMPS recording, identified from raw positions and tuned: what its set points are worth.

The recording is identified without its set points and with them as instrument.  On each model, and
on the second as if nothing beyond it were unknown, the PID is tuned as `fuzzycnc servo tune` does,
and follows the recorded reference on the published model, without and with pulses of load.

Prints a row for each.  Run with `python benchmarks/bench_emps.py DATA_EMPS.mat`; it takes some
minutes.
"""

import os

# One thread each, set before numpy starts its pool: the searches share the processors.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.io import loadmat

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test' / 'support'))
from emps import from_rest

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.axis_data import identify_axis
from fuzzycnc_ros.core.identify.axis_fit import AxisRecording
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis_control import make_axis_controller
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis
from fuzzycnc_ros.simulation.servo.axis_tuning import loop_limit, tune_controller

PERIOD = 1e-3
FULL, FORCE = 10.0, 351.5
"""Voltage [V] and force [N] at full duty."""

VOLTS = (0.0, 1.0, 2.5, 5.0)
"""Pulses of half a second [V]."""

KNOWLEDGE = ('without set points', 'with set points', 'with set points, nothing unknown')


def identified(raw: dict[str, Array], knowledge: str) -> AxisData:
    """Return what the recording tells of the axis."""
    reference = None if knowledge == KNOWLEDGE[0] else raw['qg']
    recording = AxisRecording(raw['vir'] / FULL, raw['qm'], PERIOD, reference)
    data = identify_axis([recording], force=FORCE).data
    if knowledge != KNOWLEDGE[2]:
        return data
    sure = replace(data.knowledge, known_to=1e4, mode_low=1e4, remainder='')
    return replace(data, knowledge=sure)


def left(data: AxisData, settings: dict[str, float], reference: Array, volts: float) -> float:
    """Return the rms following error on the published model [m]."""
    axis = BallscrewAxis(BallscrewAxisConfig(), position=float(reference[0]))
    # the watch of the feedback is told of the pulses: else they are a fault
    loaded = replace(data, limits=replace(data.limits, load=max(VOLTS) / FULL))
    controller = make_axis_controller(loaded, 'pid', settings)
    controller.reset(axis.measure())
    speeds = np.gradient(reference, PERIOD)
    rises = np.pad(np.diff(reference, 2), 1) / PERIOD**2
    errors = []
    for step, (place, speed, rise) in enumerate(
        np.column_stack([reference, speeds, rises]).tolist()
    ):
        errors.append(place - axis.position)
        duty = controller.step(place, axis.measure(), speed, rise)
        axis.drive(min(max(duty + volts / FULL * (step // 500 % 2), -1.0), 1.0))
    if controller.watch.fault:
        return float('nan')
    return float(np.sqrt(np.mean(np.square(errors))))


def row(piece: tuple[dict[str, Array], str]) -> str:
    """Return the row of a model."""
    raw, knowledge = piece
    data = identified(raw, knowledge)
    tuned = tune_controller(data, 'pid')
    assert tuned.margin is not None
    reference = from_rest(raw['qg'])
    errors = [1e6 * left(data, tuned.settings, reference, volts) for volts in VOLTS]
    return (
        f'{knowledge:34} {data.knowledge.known_to:9.3g} {1e3 * data.known_plant().delay:10.2g} '
        f'{tuned.margin.crossover:9.0f} {" ".join(f"{one:8.2f}" for one in errors)}  '
        f'{loop_limit(data, tuned) if knowledge != KNOWLEDGE[2] else ""}'
    )


def main() -> int:
    """Print the table."""
    if len(sys.argv) != 2:
        print('expected the file DATA_EMPS.mat', file=sys.stderr)
        return 2
    file = loadmat(Path(sys.argv[1]))
    raw = {name: file[name].ravel().astype(float) for name in ('qg', 'qm', 'vir')}
    heads = ' '.join(f'{volts:6g} V' for volts in VOLTS)
    print(f'{"PID":34} {"known[Hz]":>9} {"delay[ms]":>10} {"[rad/s]":>9} {heads}  rms [um]')
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for line in workers.map(row, [(raw, one) for one in KNOWLEDGE]):
            print(line, flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

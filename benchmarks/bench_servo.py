# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One step of the variable-universe controller, against the source's 36 rules in numpy.

All are timed in one run on the same inputs, call by call as a control loop calls them: the
textbook form (memberships, all products, centre average) as numpy arrays, the contracted surface
alone (bare), the same as a whole controller with its checks of the feedback, and the production
controller with observer, feedforward and relief from stick-slip.  The bare surface is to take at
most 2 us, the production step 5 us; the ratio to the textbook is what counts.
Run with `python benchmarks/bench_servo.py`.
"""

import os

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

from collections.abc import Callable
from statistics import median
from time import process_time

import numpy as np

from fuzzycnc_ros.core.servo.pid_cascade import CascadeController, PidController
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.positioning import position

STEPS, REPEATS = 1000, 15
BARE_MAX, OBSERVER_MAX, RATIO_MIN, APART_MAX = 2e-6, 5e-6, 15.0, 1e-12


def textbook(controller: VariableUniverseController) -> Callable[[float, float], float]:
    """Return the law with all rules in numpy, as the source writes it."""
    params = controller.params
    centres, values = np.array(params.rules.centres), np.array(params.rules.values)
    width = np.diff(centres)

    def degrees(value: float) -> np.ndarray:
        passed = np.clip((value - centres[:-1]) / width, 0.0, 1.0)
        return np.append(1.0, passed) - np.append(passed, 0.0)

    def law(error: float, rate: float) -> float:
        e = min(max(error / params.error_range, -1.0), 1.0)
        c = min(max(rate / params.rate_range, -1.0), 1.0)
        x = e / (abs(e) ** params.error_exponent + params.error_floor)
        y = c / (abs(c) ** params.rate_exponent + params.rate_floor)
        strength = np.outer(degrees(x), degrees(y))
        return float(-params.output_gain * (strength * values).sum() / strength.sum())

    return law


def nothing() -> None:
    """Prepare nothing."""


def step_time(
    function: Callable[..., object],
    inputs: list[tuple[float, float]],
    prepare: Callable[[], None] = nothing,
) -> float:
    """Return the median time of a call over repeats [s], each after `prepare`."""
    times = []
    for _ in range(REPEATS):
        prepare()
        begin = process_time()
        for one, two in inputs:
            function(one, two)
        times.append((process_time() - begin) / len(inputs))
    return median(times)


def main() -> int:
    """Print all times; fail if the production step is too slow by ratio or differs."""
    axis = LatheAxis()
    controller = VariableUniverseController(axis.config.linear())
    run = position(controller, axis, -0.05, STEPS * 1e-3)
    error = run.reference - run.measured
    rate = -np.gradient(run.measured, controller.period)
    pairs = list(zip(error.tolist(), rate.tolist(), strict=True))
    moves = list(zip(run.reference.tolist(), run.measured.tolist(), strict=True))
    book, bare = textbook(controller), controller.law
    apart = max(abs(book(*pair) - bare(*pair)) for pair in pairs)

    linear = axis.config.linear()
    controllers = {
        'static controller': VariableUniverseController(linear, mode='static'),
        'published recursion': VariableUniverseController(linear, mode='paper_literal'),
        'production': controller,
        'PID': PidController(linear),
        'cascade with observer': CascadeController(linear),
    }
    timed = {'textbook, 36 rules in numpy': (book, pairs), 'bare surface': (bare, pairs)}
    times = {name: step_time(*what) for name, what in timed.items()}
    for name, made in controllers.items():
        times[name] = step_time(made.step, moves, lambda made=made: made.reset(0.0))
        if made.status.fault:
            raise RuntimeError(f'{name}: {made.status.fault}')
    unit = times['textbook, 36 rules in numpy']
    print(f'{"one step":30} {"us":>7} {"textbook / it":>14}')
    for name, time in times.items():
        print(f'{name:30} {1e6 * time:7.2f} {unit / time:14.1f}')
    print(f'surface and textbook differ by {apart:.1e} at most')
    ratio = unit / times['bare surface']
    slow = times['bare surface'] > BARE_MAX or times['production'] > OBSERVER_MAX
    print(
        f'bare {1e6 * times["bare surface"]:.2f} us (2 expected), production '
        f'{1e6 * times["production"]:.2f} us (5), ratio {ratio:.0f} ({RATIO_MIN:g})'
    )
    return 1 if slow or ratio < RATIO_MIN or apart > APART_MAX else 0


if __name__ == '__main__':
    raise SystemExit(main())

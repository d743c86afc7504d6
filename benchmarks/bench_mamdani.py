# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Mamdani inference of the published feed rules, against scikit-fuzzy's control system.

Both infer the same pairs here, one after the other, each in one call with arrays; the ratio of
their times per pair is what counts, and that they agree.  Also timed: the lookup table.
Needs scikit-fuzzy (`pip install scikit-fuzzy networkx packaging`); without it only our own times
are printed.  Run with `python benchmarks/bench_mamdani.py`.
"""

import os

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np

from fuzzycnc_ros.core.fuzzy.mamdani import Mamdani, MamdaniTable
from fuzzycnc_ros.papers.feedrate import FuzzyScheduler

PAIRS, THEIR_PAIRS = 200_000, 2000
REPEATS = 5
RATIO_MIN, APART_MAX = 100.0, 1e-3


def seconds(function: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median time of a call."""
    times = []
    for _ in range(repeats):
        begin = perf_counter()
        function()
        times.append(perf_counter() - begin)
    return median(times)


def their_inference(system: Mamdani) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the same rules as a control system of scikit-fuzzy that takes arrays."""
    import skfuzzy
    from skfuzzy import control

    def sets(variable, centres: tuple[float, ...]) -> None:
        around = [2 * centres[0] - centres[1], *centres, 2 * centres[-1] - centres[-2]]
        for number in range(len(centres)):
            variable[str(number)] = skfuzzy.trimf(variable.universe, around[number : number + 3])

    first = control.Antecedent(np.linspace(system.first[0], system.first[-1], 601), 'first')
    second = control.Antecedent(np.linspace(system.second[0], system.second[-1], 201), 'second')
    low = 2 * system.output[0] - system.output[1]
    high = 2 * system.output[-1] - system.output[-2]
    output = control.Consequent(np.linspace(low, high, 181), 'output')
    sets(first, system.first)
    sets(second, system.second)
    sets(output, system.output)
    rules = [
        control.Rule(first[str(i)] & second[str(j)], output[str(level)])
        for i, row in enumerate(system.rules)
        for j, level in enumerate(row)
    ]
    simulation = control.ControlSystemSimulation(control.ControlSystem(rules), cache=False)

    def infer(one: np.ndarray, two: np.ndarray) -> np.ndarray:
        simulation.input['first'], simulation.input['second'] = one, two
        simulation.compute()
        return np.asarray(simulation.output['output'])

    return infer


def main() -> int:
    """Print all times and ratios; fail if we are not fast enough or differ."""
    system = FuzzyScheduler(feed_max=1.0).system
    rng = np.random.default_rng(0)
    pairs = rng.uniform(0.0, 3000.0, PAIRS), rng.uniform(0.0, 1.0, PAIRS)
    table = MamdaniTable(system)
    own = seconds(lambda: system(*pairs)) / PAIRS
    lookup = seconds(lambda: table(*pairs)) / PAIRS
    print(f'inference           {1e6 * own:7.3f} us per pair')
    print(f'lookup              {1e6 * lookup:7.3f} us per pair')
    try:
        infer = their_inference(system)
    except ImportError as error:
        print(f'scikit-fuzzy        not compared: {error}; pip install scikit-fuzzy networkx')
        return 0
    few = pairs[0][:THEIR_PAIRS], pairs[1][:THEIR_PAIRS]
    their = seconds(lambda: infer(*few), 3) / THEIR_PAIRS
    apart = np.abs(infer(*few) - system(*few)).max()
    print(f'scikit-fuzzy        {1e6 * their:7.1f} us per pair, {apart:.1e} apart')
    print(f'ratio               {their / own:7.0f} (at least {RATIO_MIN:g} expected)')
    return 0 if their / own >= RATIO_MIN and apart <= APART_MAX else 1


if __name__ == '__main__':
    raise SystemExit(main())

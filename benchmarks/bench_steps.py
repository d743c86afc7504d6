# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Training and one streaming step of every candidate, on the simulated mill, in one run.

All candidates are trained on D0, D0b and T1 (5 of 76 sensors, two channels) and stepped through T2
as the predictor steps them; the plainest of them is the unit of both columns.  A step of any model
that training chooses by itself should take less than 60 us.
Run with `python benchmarks/bench_steps.py`.
"""

import os

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

from statistics import median
from time import perf_counter

from fuzzycnc_ros.core.thermal.candidate import CANDIDATES, STANDARD
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.simulation.thermal.duties import record_runs

PASSES = 20
UNIT = 'static_ridge'


def step_times(model: ThermalModel, samples: list, name: str | None) -> list[float]:
    """Return the time of each step of a candidate, or of the default [s]."""
    times = []
    for _ in range(PASSES):
        stream = model.start(name)
        for sample in samples:
            start = perf_counter()
            stream.step(sample)
            times.append(perf_counter() - start)
    return times


def main() -> None:
    """Print the table."""
    runs = record_runs()
    training = [runs[name] for name in ('D0', 'D0b', 'T1')]
    seconds: dict[str, float] = {}
    begun = [('', perf_counter())]

    def tell(stage: str, name: str, done: int, total: int) -> None:
        now = perf_counter()
        last, since = begun[-1]
        if last:
            seconds[last] = seconds.get(last, 0.0) + now - since
        begun.append((name if stage == 'fit' and done < total else '', now))

    model = train_model(training, candidates=CANDIDATES, sensors='clusters', progress=tell)
    model = ThermalModel.from_json(model.to_json())
    samples = list(model.rises(runs['T2']))
    steps = {name: step_times(model, samples, name) for name in model.candidates}
    steps['default'] = step_times(model, samples, None)
    unit = median(steps[UNIT])
    print('training with choice on held-out runs, and one step of two channels')
    print(f'{"model":24} {"train s":>8} {"step us":>8} {"p99 us":>8} {"steps of " + UNIT:>22}')
    for name, times in steps.items():
        ordered = sorted(times)
        middle, late = median(times), ordered[int(0.99 * len(ordered))]
        trained = f'{seconds[name]:8.2f}' if name in seconds else ' ' * 8
        mark = ' standard' if name in STANDARD else ''
        figures = f'{1e6 * middle:8.1f} {1e6 * late:8.1f} {middle / unit:22.1f}'
        print(f'{name:24} {trained} {figures}{mark}')
    print(f'default: {", ".join(model.default)}')


if __name__ == '__main__':
    main()

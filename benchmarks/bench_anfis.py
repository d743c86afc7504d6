# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Training of an ANFIS on the simulated mill, against anfis-toolbox, and the time of a step.

Both run here, one after the other, on the same scaled samples of three runs (603 of 5 sensors),
from the same Gaussian sets and rules, for the same number of epochs of hybrid learning, with
their own settings else; the ratio of their times and the residual on two duties that neither has
seen are what counts.  Needs anfis-toolbox (`pip install anfis-toolbox`); without it only our own
time is printed.  Run with `python benchmarks/bench_anfis.py`.
"""

import os

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np

from fuzzycnc_ros.core.fuzzy.takagi_sugeno import (
    Premises,
    log_firing,
    normalised_firing,
    train_rules,
)
from fuzzycnc_ros.core.thermal.fit.anfis import (
    STEP,
    WIDTH_MIN,
    Anfis,
    GreyAnfis,
    cluster_premises,
    grid_premises,
)
from fuzzycnc_ros.core.thermal.recursions.base import Stream, combine
from fuzzycnc_ros.simulation.thermal.duties import record_runs

SENSORS = ('T18', 'T55', 'T63', 'T68', 'T71')
TRAINING, UNSEEN = ('D0', 'T1', 'D0b'), ('T2', 'T3')
SEEDS = range(5)
EPOCHS = 50
RATIO_MIN = 20.0
STEP_MAX = 60e-6

Predictor = Callable[[np.ndarray], np.ndarray]


class Case:
    """Samples of one seed and axis, scaled to about 1, and a way to judge predictors."""

    def __init__(self, seed: int, axis: int) -> None:
        runs = record_runs(seed=seed)
        rise = {name: run.rise()[:, run.columns(SENSORS)] for name, run in runs.items()}
        inputs = np.concatenate([rise[name] for name in TRAINING])
        target = np.concatenate([runs[name].displacement[:, axis] for name in TRAINING])
        scale, self._unit = inputs.std(axis=0), target.std()
        self.inputs, self.target = inputs / scale, target / self._unit
        self._unseen = [
            (rise[name] / scale, runs[name].displacement[:, axis] / self._unit) for name in UNSEEN
        ]

    def residual(self, predict: Predictor) -> float:
        """Return the root mean square residual on the unseen duties [um]."""
        apart = np.concatenate([predict(inputs) - target for inputs, target in self._unseen])
        return float(1e6 * self._unit * np.sqrt(np.mean(apart**2)))


def ours(case: Case, premises: Premises) -> tuple[float, float]:
    """Return seconds of training and the residual on unseen duties [um]."""
    begin = perf_counter()
    trained = train_rules(
        case.inputs,
        case.target,
        premises,
        ridge=Anfis().ridge,
        epochs=EPOCHS,
        step=STEP,
        width_min=WIDTH_MIN,
    )
    seconds = perf_counter() - begin
    center, width = trained.premises.of_rules()

    def predict(inputs: np.ndarray) -> np.ndarray:
        firing = normalised_firing(log_firing(inputs, center, 1.0 / width))
        return (firing * (inputs @ trained.slope.T + trained.offset)).sum(axis=1)

    return seconds, case.residual(predict)


def theirs(case: Case, premises: Premises) -> tuple[float, float]:
    """Return the same of anfis-toolbox."""
    from anfis_toolbox import ANFISRegressor
    from anfis_toolbox.membership import GaussianMF

    sets = {
        column: [
            GaussianMF(mean=float(center), sigma=float(width))
            for center, width in zip(
                premises.center[:, column], premises.width[:, column], strict=True
            )
        ]
        for column in range(len(SENSORS))
    }
    model = ANFISRegressor(
        inputs_config=sets, rules=premises.index.tolist(), optimizer='hybrid', epochs=EPOCHS
    )
    begin = perf_counter()
    model.fit(case.inputs, case.target)
    return perf_counter() - begin, case.residual(model.predict)


def step_times() -> dict[str, float]:
    """Return the seconds of a streaming step of two channels, the fastest of nine passes."""
    runs = record_runs(seed=0)
    rise = np.concatenate([runs[name].rise()[:, runs[name].columns(SENSORS)] for name in TRAINING])
    target = np.concatenate([runs[name].displacement for name in TRAINING])
    times = {}
    for make in (Anfis, GreyAnfis):
        stream = Stream(combine([make().fit(rise, column).recursion_ for column in target.T]))
        passes = []
        for _ in range(9):
            begin = perf_counter()
            for sample in rise:
                stream.step(sample)
            passes.append((perf_counter() - begin) / len(rise))
        times[make.__name__] = min(passes)
    return times


def main() -> int:
    """Print times, ratios and residuals; fail if we are not fast or not good enough."""
    cases = [Case(seed, axis) for seed in SEEDS for axis in (0, 1)]
    fine = True
    for name, premises_of in (
        ('3 rules of fuzzy c-means', lambda inputs: cluster_premises(inputs, 3, 0)),
        ('32 rules of a grid', grid_premises),
    ):
        premises = [premises_of(case.inputs) for case in cases]
        print(f'{name}, {EPOCHS} epochs, median of {len(cases)} fits')
        own, other = [], []
        try:
            for pair in zip(cases, premises, strict=True):
                own.append(ours(*pair))
                other.append(theirs(*pair))
        except ImportError as error:
            print(f'  fuzzycnc       {1e3 * own[0][0]:8.1f} ms')
            print(f'  anfis-toolbox  not compared: {error}; pip install anfis-toolbox')
            continue
        for package, fits in (('fuzzycnc', own), ('anfis-toolbox', other)):
            print(
                f'  {package:13}  {1e3 * median(seconds for seconds, _ in fits):8.1f} ms   '
                f'residual on unseen duties {median(residual for _, residual in fits):.2f} um'
            )
        ratio = median(b[0] / a[0] for a, b in zip(own, other, strict=True))
        print(f'  ratio          {ratio:8.1f} (at least {RATIO_MIN:g} expected)')
        fine &= ratio >= RATIO_MIN
        fine &= median(a[1] for a in own) <= median(b[1] for b in other)
    for name, seconds in step_times().items():
        print(f'step of {name}, 2 channels: {1e6 * seconds:.1f} us (at most {1e6 * STEP_MAX:g})')
        fine &= seconds <= STEP_MAX
    return 0 if fine else 1


if __name__ == '__main__':
    raise SystemExit(main())

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""First run of a machine that begins with what others of its kind have learnt.

Five mills are simulated, whose errors differ in size and direction by a part of them.  Each learns
three runs from nothing, with a probe an hour.  Then each is left out in turn: it begins its first
run, one that no machine has seen, with nothing, with what one other has learnt, and with what the
other four have.  Printed is the geometric mean over machines and axes of the root mean square
error, probed every hour, and the share of samples in the band.

Run with `python benchmarks/fleet_prior.py`.
"""

from dataclasses import replace

import numpy as np

from fuzzycnc_ros.core.thermal.blank import blank_model
from fuzzycnc_ros.core.thermal.fit import evaluate
from fuzzycnc_ros.core.thermal.learning import Basis, Learner
from fuzzycnc_ros.core.thermal.prior import LearningPrior, of_one_kind
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.simulation.thermal.duties import record_runs
from fuzzycnc_ros.studies.thermal.probed import evaluate_probed

MACHINES, LEARNT, JUDGED = 5, ('D0', 'T1', 'T2'), 'T3'
SPREADS = (0.1, 0.25, 0.5)
HOUR, NOISE = 3600.0, 0.5e-6


def machine(number: int, spread: float) -> dict[str, ThermalRun]:
    """Return the runs of a mill whose errors are mixed by a matrix near the identity."""
    random = np.random.default_rng(100 + number)
    mixed = np.eye(2) + spread * random.standard_normal((2, 2))
    runs = record_runs(seed=number)
    return {
        name: replace(run, displacement=run.displacement @ mixed.T) for name, run in runs.items()
    }


def learn(runs: dict[str, ThermalRun]) -> LearningPrior:
    """Return what hourly probes of some runs teach."""
    first = runs[LEARNT[0]]
    learner = Learner(Basis(len(first.sensor), True, first.interval), first.channel)
    for name in LEARNT:
        run = runs[name]
        if name != LEARNT[0]:
            learner.begin_run()
        rows = zip(run.rise(), run.spindle_speed.tolist(), run.time.tolist(), strict=True)
        for row, sample in enumerate(rows):
            learner.step(*sample)
            if row and row % 60 == 0:
                learner.probe(run.displacement[row], np.full(2, NOISE))
    known = tuple(item.knowledge() for item in learner.posteriors)
    return LearningPrior(learner.basis, known, (0.0,) * len(known))


def main() -> None:
    """Print a table, a row for each spread of the machines."""
    print('| machines differ by | none | probe held | nothing known | one other | the kind |')
    print('| --- | --- | --- | --- | --- | --- |')
    for spread in SPREADS:
        machines = [machine(number, spread) for number in range(MACHINES)]
        learnt = [learn(runs) for runs in machines]
        left, covered = [], []
        for number, runs in enumerate(machines):
            run = runs[JUDGED]
            blank = blank_model(run.sensor, run.axis, run.interval)
            others = [item for other, item in enumerate(learnt) if other != number]
            models = [blank, *(replace(blank, prior=p) for p in (others[0], of_one_kind(others)))]
            found = [evaluate_probed(item, run, evaluate(item, run), HOUR) for item in models]
            plain = [found[0].rms[name] for name in ('uncompensated', 'held')]
            left.append([*plain, *(item.rms['learnt'] for item in found)])
            covered.append([item.covered for item in found])
        means = np.exp(np.log(np.array(left)).mean(axis=(0, 2))) * 1e6
        inside = 100.0 * np.array(covered).mean(axis=(0, 2))
        cells = [f'{value:.1f}' for value in means[:2]]
        cells += [f'{value:.1f}, {s:.0f} %' for value, s in zip(means[2:], inside, strict=True)]
        print(f'| {100.0 * spread:.0f} % | {" | ".join(cells)} |')


if __name__ == '__main__':
    main()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Time of learning from probes, with 24 sensors, the spindle speed and three lags.

Printed are, for one channel, the time of a sample (features, drift, prediction and deviation), of
a probe, and of learning the scales anew from a full window of probes; and the size of all that.

Run with `python benchmarks/bench_learning.py`.
"""

import os

# One thread, set before numpy starts its pool.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

from timeit import repeat

import numpy as np

from fuzzycnc_ros.core.thermal.learning import WINDOW, Basis, Learner, Posterior

SENSORS = 24
SAMPLE_MAX, PROBE_MAX = 50e-6, 1e-3
SIZE_MAX = 1 << 20


def best(work: object, times: int = 200) -> float:
    """Return the shortest mean time of a call [s]."""
    return min(repeat(work, number=times, repeat=7)) / times  # type: ignore[arg-type]


def main() -> int:
    """Print the times; fail if one is longer, or more is kept, than a machine should bear."""
    basis = Basis(SENSORS, True, 60.0)
    random = np.random.default_rng(0)
    features = np.abs(random.normal(size=(WINDOW, basis.features))) * 10.0
    known = Posterior(basis)
    for hour, row in enumerate(features):
        known.update(row, 3600.0 * hour, 1e-5 * float(random.normal()), 0.5e-6)
    learner = Learner(basis, ['Z'])
    rise = features[0, :SENSORS]
    step = best(lambda: learner.step(rise, 100.0, 60.0))
    predict = best(lambda: known.predict(features[0], 1e6))
    # A probe that says what is expected: the filter alone is timed, as if it were the first.
    fresh = Posterior(basis)
    probe = best(lambda: fresh.update(features[1], 0.0, 0.0, 0.5e-6), 50)
    tune = best(known.tune, 2)
    size = known.state.nbytes
    sample = 1e6 * (step + predict)
    print(f'a sample       {sample:8.1f} us, of it the prediction {1e6 * predict:.1f} us')
    print(f'a probe        {1e6 * probe:8.1f} us')
    print(f'all scales     {1e3 * tune:8.1f} ms, from {WINDOW} probes')
    print(f'the memory     {size / 1024:8.0f} kB')
    slow = predict > SAMPLE_MAX or probe > PROBE_MAX or size > SIZE_MAX
    return int(slow)


if __name__ == '__main__':
    raise SystemExit(main())

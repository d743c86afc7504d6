# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A machine of made-up weights that a learner follows for any number of steps."""

import hashlib
import json
import sys

import numpy as np

from fuzzycnc_ros.core.thermal.learning import Basis, Learner

WRONG = (5e-4, -3e-4, 0.0, 1e-2)
"""Errors that a chip under the probe, a wrong sign or a wrong unit make of anything [m]."""


def follow(steps: int, seed: int, channels: int = 2) -> tuple[Learner, str]:
    """Return a learner after steps of many runs, and a hash of all that it said.

    Runs are of any length; probes come at random, some of them false, some of a noise of their
    own; there are pauses of hours.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    learner = Learner(Basis(3, True, 60.0), [f'C{number}' for number in range(channels)])
    weight = random.uniform(-1e-6, 1e-6, (channels, 4))
    rise, speed = np.zeros(3), 0.0
    said = hashlib.sha256()
    time = 0.0
    for chance in random.random(steps):
        time += 60.0
        if chance < 2e-3:
            learner.begin_run()
            time = 0.0
            rise, speed = np.zeros(3), 0.0
        elif chance < 1e-2:
            speed = float(random.uniform(0.0, 600.0))
        rise = rise + 0.02 * (np.array([0.05, 0.03, 0.01]) * speed - rise)
        learner.step(rise, speed, time)
        error, deviation = learner.predict()
        said.update(error.tobytes() + deviation.tobytes())
        if chance > 0.98:
            noise = np.full(channels, random.choice([0.3e-6, 1e-6, 20e-6]))
            true = (weight[:, :3] * rise).sum(axis=1) + 1e-3 * weight[:, 3] * speed
            probe = true + noise * random.uniform(-2.0, 2.0, channels)
            if chance > 0.998:
                probe[random.integers(channels)] = random.choice(WRONG)
            said.update(learner.probe(probe, noise, float(random.choice([0.0, 20.0]))).tobytes())
    return learner, said.hexdigest()


if __name__ == '__main__':
    print(json.dumps(follow(int(sys.argv[1]), int(sys.argv[2]))[1]))

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectory input: whatever parts are made of, the commanded position never jumps."""

from dataclasses import replace

import numpy as np
import pytest
from benches.trajectory_bench import AXES, PERIOD, SECOND, line, parts, trapezoid
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryInput, TrajectoryInputConfig

CONFIG = TrajectoryInputConfig()
STEP = round(PERIOD * SECOND)


BAD_NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-4, 1e300, -1e-3]


def mutated(part, rng):
    """Return a part with something wrong, or a little different, with it."""
    kind = rng.integers(0, 9)
    if kind == 0:
        name = rng.choice(['part', 'epoch', 'committed', 'start'])
        change = int(rng.choice([-SECOND, -STEP, -1, 1, STEP, 1000 * SECOND]))
        return replace(part, **{name: getattr(part, name) + change})
    if kind == 1:
        return replace(part, period=float(rng.choice(BAD_NUMBERS)))
    if kind == 2:
        axis = [('X',), ('X', 'Y'), (), ('X', 'Y', 'A'), ('Z', 'Y', 'X'), ('X', 'X', 'X')]
        return replace(part, axis=axis[rng.integers(len(axis))])
    if kind == 3:
        return replace(part, last=not part.last, path_id=str(rng.choice(['', 'path', 'b'])))
    name = str(rng.choice(['position', 'velocity', 'arc_length']))
    values = getattr(part, name).copy()
    if kind == 4:
        return replace(part, **{name: values[: rng.integers(0, len(values))]})
    if kind == 5:
        return replace(part, **{name: values.reshape(1, -1)})
    if kind == 6:
        values[rng.integers(len(values))] = rng.choice(BAD_NUMBERS)
    elif kind == 7:
        values += rng.normal(0.0, 10.0 ** rng.uniform(-12, 3), len(values))
    else:
        values *= rng.choice([0.0, 0.5, 1.009, 1.5, -1.0, 1e6])
    return replace(part, **{name: values})


def drive(seed, count):
    """Give mutated parts between good ones; check every commanded step; return what happened."""
    rng = np.random.default_rng(seed)
    machine = TrajectoryInput(AXES, np.zeros(3), CONFIG)
    verdicts = {True: 0, False: 0}
    place, done = machine.sample.position, 0
    steps = []
    while done < count:
        if machine.next_time is None:
            begin = machine.sample.position.copy()
            way = trapezoid(rng.uniform(1e-4, 0.05), rng.uniform(0.01, 0.24), 3.0)
            heading = np.linalg.qr(rng.normal(size=(3, 3)))[0][0]
            coming = parts(
                lambda s, b=begin, h=heading: b + line(s, h),
                way,
                start=machine.time + int(rng.integers(1, SECOND // 10)),
                chunk=int(rng.integers(5, 80)),
                path_id='path',
                epoch=machine.epoch or 1,
            )
        for part in coming[:2]:
            for _ in range(int(rng.integers(1, 4))):
                bad = mutated(part, rng)
                verdicts[machine.command(bad).accepted] += 1
                done += 1
            if rng.random() < 0.9:
                machine.command(part)
        coming = coming[1:]
        if rng.random() < 0.02:
            machine.allow(False, 'fuzz')
            machine.allow(True)
        for _ in range(int(rng.integers(1, 80))):
            if machine.next_time is None:
                break
            sample = machine.take()
            steps.append(sample.position - place)
            place = sample.position
            assert np.isfinite(sample.velocity).all()
        if not coming:
            while machine.next_time is not None:
                sample = machine.take()
                steps.append(sample.position - place)
                place = sample.position
    return np.array(steps), verdicts


@pytest.mark.parametrize('seed', range(2))
def test_no_step_is_larger_than_the_machine_allows(seed):
    steps, verdicts = drive(seed, 2000)
    assert np.isfinite(steps).all()
    assert np.abs(steps).max() <= 1.01 * CONFIG.velocity_max * PERIOD * (1 + 1e-9)
    assert np.abs(steps).max() > 0.5 * CONFIG.velocity_max * PERIOD  # and it did move
    assert len(steps) > 2000
    assert verdicts[False] > 1000


@given(
    samples=st.lists(
        st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 3), min_size=1, max_size=8
    ),
    committed=st.integers(-1, 9),
    start=st.integers(-(2**63), 2**63),
    last=st.booleans(),
)
@settings(max_examples=200, deadline=None)
def test_any_numbers_are_refused_or_harmless(samples, committed, start, last):
    machine = TrajectoryInput(AXES, np.zeros(3), CONFIG)
    place = np.array(samples)
    good = parts()[0]
    answer = machine.command(
        replace(
            good,
            start=start,
            committed=committed,
            last=last,
            position=place.ravel(),
            velocity=place.ravel(),
            arc_length=place[:, 0],
        )
    )
    assert answer.accepted is (machine.next_time is not None)
    reach = 1.01 * CONFIG.acceleration_max * PERIOD**2 * len(samples) ** 2
    while machine.next_time is not None:
        assert np.abs(machine.take().position).max() <= reach

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Error along the travel of random ball screws on random duties, learnt from runs or from nothing.

python benchmarks/random_screws.py [SEED...]        about twenty seconds for each seed

Losses, frictions and capacities of each screw differ by a third from the usual ones, and strokes
lie anywhere on the travel.  Sensors are at bearing, nut and table.
"""

import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzzycnc_ros.core.thermal.band import WIDTH
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.learning import Basis, Learner
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.places import MOTION_MEANS, AxisSpan, motion_of
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.core.thermal.screw_growth import screws_of
from fuzzycnc_ros.simulation.thermal.ball_screw import BallScrew, BallScrewConfig, Stroke
from fuzzycnc_ros.simulation.thermal.mill import MILL_STEP

SPAN = AxisSpan('Y', -0.5, 0.0, bent=True)
PLACES = np.linspace(SPAN.low, SPAN.high, 11)
ENDS = SPAN.shares(np.array([SPAN.low, SPAN.middle, SPAN.high]))
STANDING, HOURS, INTERVAL = 360, 4, 60.0
SENSOR_NOISE, NOISE = 0.05, 0.5e-6
KEPT = ('mounting', 'length', 'diameter', 'expansion', 'prestretch', 'scale_expansion')
KEPT = (*KEPT, 'scale_fixed_at', 'bearing_position', 'direction', 'nut_length')
UNSEEN = 6
SETTLED = 9000.0


def random_screw(rng: np.random.Generator) -> BallScrewConfig:
    """Return a screw that differs from the usual one."""
    usual = BallScrewConfig()
    names = [item.name for item in fields(usual) if item.name not in KEPT]
    factors = np.exp(rng.normal(0.0, 0.3, len(names)))
    changed = {name: getattr(usual, name) * k for name, k in zip(names, factors, strict=True)}
    return replace(usual, **changed, diameter=float(rng.choice([0.032, 0.04, 0.05])))


def random_duty(rng: np.random.Generator) -> list[tuple[int, Stroke]]:
    """Return how long an axis does what [s]."""
    rest = Stroke(-0.1, -0.1, 0.0)
    blocks = [(STANDING, rest)]
    while sum(duration for duration, _ in blocks) < HOURS * 3600:
        duration = 60 * int(rng.integers(20, 90))
        length, speed = rng.uniform(0.1, 0.45), rng.uniform(0.05, 0.25)
        low = rng.uniform(SPAN.low, -length)
        stroke = Stroke(low, low + length, speed)
        blocks.append((duration, rest if rng.random() < 0.2 else stroke))
    return blocks


def recorded(
    name: str, screw: BallScrewConfig, rng: np.random.Generator
) -> tuple[ThermalRun, np.ndarray]:
    """Return a run of a random duty, and the true error at `PLACES` (n, p) [m]."""
    base, amplitude, phase = rng.uniform(17, 26), rng.uniform(0, 3), rng.uniform(0, 2 * np.pi)
    rows, moved, now = [], np.zeros(len(MOTION_MEANS)), 0
    ball = BallScrew(screw, base + amplitude * np.sin(phase))
    for duration, stroke in random_duty(rng):
        for _ in range(int(duration // MILL_STEP)):
            ball.advance(base + amplitude * np.sin(phase + 2 * np.pi * now / 86400), stroke)
            now, moved = now + MILL_STEP, moved + MILL_STEP * stroke.motion
            if now % INTERVAL == 0:
                rows.append(
                    (now, ball.temperatures()[[0, 2, 3]], ball.error(PLACES), moved / INTERVAL)
                )
                moved = np.zeros(len(MOTION_MEANS))
    time, temperature, error, motion = (
        np.array(column, float) for column in zip(*rows, strict=True)
    )
    channels = np.linalg.solve(ENDS, error[:, [0, 5, 10]].T).T
    run = ThermalRun(
        name=name,
        time=time - time[0],
        sensor=('bearing', 'nut', 'table'),
        temperature=temperature + SENSOR_NOISE * rng.standard_normal(temperature.shape),
        channel=SPAN.channels,
        axis=('Y',) * 3,
        displacement=channels + NOISE * rng.standard_normal(channels.shape),
        drives={
            f'{drive}/Y': column for drive, column in zip(MOTION_MEANS, motion.T, strict=True)
        },
    )
    return run, error


def followed(
    learner: Learner,
    run: ThermalRun,
    error: np.ndarray,
    rng: np.random.Generator | None = None,
    model: ThermalModel | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the error beyond the best line at each sample [m], and which places are in the band.

    With a generator both ends are probed once an hour.
    """
    left, inside = [], []
    shares = SPAN.shares(PLACES)[:, : len(learner.posteriors)]
    moved = motion_of(run.drives, learner.basis.axes, len(run.time))
    alone = np.zeros((len(run.time), len(learner.posteriors)))
    if model is not None:
        alone = model.predict(run) * np.array(model.prior.share)
    for row, rise in enumerate(run.rise()):
        learner.step(rise, 0.0, float(run.time[row]), moved[row])
        value, deviation = learner.predict()
        value = alone[row] + value
        off = error[row] - shares[:, :2] @ value[:2]
        line = np.polynomial.polynomial.polyfit(PLACES, error[row], 1)
        best = np.abs(error[row] - np.polynomial.polynomial.polyval(PLACES, line)).max()
        left.append(np.abs(off).max() - best)
        inside.append(
            np.abs(off) <= WIDTH * np.hypot(deviation[0], shares[:, 1] * deviation[1]) + best
        )
        if rng is not None and row and row % 60 == 0:
            low, high = error[row, [0, -1]] + NOISE * rng.standard_normal(2)
            probe = 0.5 * np.array([low + high, high - low])
            learner.probe(probe, np.full(2, NOISE / np.sqrt(2)))
    return np.array(left), np.array(inside)


def judged(seed: int) -> Iterator[tuple[str, list[float], float]]:
    """Yield ways of learning: the largest error of each run beyond the best line, and coverage."""
    rng = np.random.default_rng(seed)
    screw = random_screw(rng)
    runs = [recorded(f'{number}', screw, rng) for number in range(8 + UNSEEN)]
    unseen = runs[8:]
    for count in (2, 8):
        model = train_model(
            [run for run, _ in runs[:count]],
            candidates=('static_ridge', 'lag_ridge'),
            interval=INTERVAL,
        )
        found = [
            followed(model.prior.learner(SPAN.channels), run, error, model=model)
            for run, error in unseen
        ]
        yield (
            f'{count} runs',
            [float(left.max()) for left, _ in found],
            float(np.mean([item.mean() for _, item in found])),
        )
    basis = Basis(3, False, INTERVAL, screws=screws_of(SPAN.channels))
    learner = Learner(basis, SPAN.channels[:2])
    found = []
    for number, (run, error) in enumerate(unseen[:3]):
        if number:
            learner.begin_run()
        left, inside = followed(learner, run, error, rng)
        since = run.time >= (0.0 if number else SETTLED)
        found.append((left[since], inside[since]))
    yield (
        'from nothing, three days',
        [float(left.max()) for left, _ in found],
        float(np.mean(np.concatenate([item for _, item in found]))),
    )


def main() -> None:
    """Print a row for each screw and way of learning."""
    print('| screw | learnt from | beyond the best line, each run [µm] | median | in band % |')
    print('|---|---|---|---|---|')
    for seed in map(int, sys.argv[1:] or range(21, 27)):
        for way, left, inside in judged(seed):
            each = ' '.join(f'{1e6 * value:.1f}' for value in left)
            print(
                f'| {seed} | {way} | {each} | {1e6 * np.median(left):.1f} | {100 * inside:.0f} |',
                flush=True,
            )


if __name__ == '__main__':
    main()

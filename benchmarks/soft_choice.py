# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of a model of feed compensation on sheets of other laws than the simulated one.

The drag depends on the direction by threads that lock, on the density of the stitches, or on the
order in which samples were stitched, which no input of a model says.  A chosen model is judged by
noise-free compensations of 600 other processes, beside each of the models that compete.
Run with `python benchmarks/soft_choice.py FIRST_SEED LAST_SEED [KIND...]`.
"""

import os
import sys

os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.regression import gaussian_process, ridge_regression
from fuzzycnc_ros.studies.soft.foam_records import array_samples
from fuzzycnc_ros.studies.soft.foam_training import train_model

KINDS = ('direction', 'order', 'density', 'none')
SIZES = (20, 60, 200)
NOISE, JUDGED = 0.2, 600


def processes(rng: np.random.Generator, count: int) -> Array:
    """Return process values, shape (count, 5)."""
    thickness = rng.choice([8.0, 12.0, 16.0, 22.0, 30.0], count)
    kind = np.where(rng.random(count) < 0.75, 2.0, 1.0)
    depth, step = thickness * rng.uniform(0.25, 0.55, count), rng.integers(2, 6, count)
    return np.column_stack([rng.uniform(0.0, 360.0, count), depth, kind, step, thickness])


class Sheet:
    """A sheet whose drag bends with one thing, drawn."""

    def __init__(self, kind: str, rng: np.random.Generator) -> None:
        self.kind = kind
        self.axis, self.phase = rng.uniform(0.0, np.pi), rng.uniform(0.0, 2.0 * np.pi)
        self.uneven, self.size = rng.uniform(0.2, 0.5), rng.uniform(4.0, 7.0)
        self.bend, self.half = rng.uniform(0.4, 0.8), rng.uniform(0.25, 0.5)
        self.twist = np.radians(rng.uniform(5.0, 15.0))

    def compensation(self, x: Array, order: Array) -> Array:
        """Return compensations [mm per 50 mm] of samples, each at its share of the order."""
        turn = np.radians(x[:, 0]) + np.where(x[:, 2] == 1.0, self.twist, 0.0)
        ratio, density = x[:, 1] / x[:, 4], 3.0 / x[:, 3]
        strain = 15.0 * ratio / (1.0 - ratio) / x[:, 4]
        if self.kind == 'direction':  # threads lock the weave
            away = turn - self.phase
            lock = 1.0 + self.bend * (np.cos(2.0 * away) + 0.5 * np.cos(4.0 * away))
            shear = np.tanh(0.8 * strain * density * np.maximum(lock, 0.05)) / 0.8
        elif self.kind == 'density':  # dense seams clamp the sheet
            square = density * density
            shear = 1.2 * strain * square / (self.half + square * (0.4 + 0.25 * square))
        else:  # each seam stiffens the sheet for later ones
            shear = np.arctan(1.2 * strain * density) / 1.2
            shear = shear * (1.0 - self.bend * (1.0 - np.exp(-3.0 * order)))
        cosine, sine = np.cos(self.axis), np.sin(self.axis)
        rotation = np.array([[cosine, -sine], [sine, cosine]])
        drag = rotation @ np.diag([1.0 + self.uneven, 1.0 - self.uneven]) @ rotation.T
        way = np.column_stack([np.cos(turn), np.sin(turn)])
        return np.asarray(self.size * shear[:, np.newaxis] * (way @ drag.T))


def errors(kind: str, count: int, share: float, seed: int) -> dict[str, float]:
    """Return the rms error of each model on processes that no choice saw [mm per 50 mm]."""
    rng = np.random.default_rng([seed, count, KINDS.index(kind)])
    x, judged = processes(rng, count), processes(rng, JUDGED)
    if kind == 'none':
        s, true = rng.normal(0.0, 1.0, (count, 2)), np.zeros((JUDGED, 2))
    else:
        sheet, orders = Sheet(kind, rng), (np.arange(200) + 0.5) / 200
        s = sheet.compensation(x, (np.arange(count) + 0.5) / count)
        s += rng.normal(0.0, NOISE, s.shape)
        true = np.mean([sheet.compensation(judged, np.full(JUDGED, at)) for at in orders], axis=0)
    wrong = rng.choice(count, round(share * count), replace=False)
    angle = rng.uniform(0.0, 2.0 * np.pi, len(wrong))
    away = rng.uniform(3.0, 10.0, len(wrong))[:, np.newaxis]
    s[wrong] += away * np.column_stack([np.cos(angle), np.sin(angle)])
    samples = array_samples(x, s)
    found = train_model(samples, {})
    kept = ~np.isin(samples.where, found.outliers)
    x, s = samples.x[kept], samples.s[kept]
    models = {
        'ridge': ridge_regression(x, s),
        'gaussian_process': gaussian_process(x, s),
        'network': TSFuzzyNetwork().fit(x, s).model_,
        'chosen': found.model,
    }
    return {
        name: float(np.sqrt(((model.predict(judged) - true) ** 2).mean()))
        for name, model in models.items()
    }


def main() -> int:
    """Print root mean squares over the seeds, and the chosen one against the best of them."""
    seeds = range(int(sys.argv[1]), int(sys.argv[2]) + 1)
    kinds = sys.argv[3:] or KINDS
    for kind in kinds:
        for count in SIZES:
            for share in (0.0, 0.05):
                found = [errors(kind, count, share, seed) for seed in seeds]
                rms = {
                    name: float(np.sqrt(np.mean([one[name] ** 2 for one in found])))
                    for name in found[0]
                }
                best = min(value for name, value in rms.items() if name != 'chosen')
                figures = '  '.join(f'{name} {value:.3f}' for name, value in rms.items())
                if kind != 'none':
                    figures += f'  {rms["chosen"] / best:.2f} times the best'
                print(f'{kind:9} {count:3} {100 * share:.0f} %  {figures}', flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

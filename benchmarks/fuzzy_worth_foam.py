# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensation of soft material with and without rules, on simulated sheets not trained on.

All models have the same inputs, the same target and the same samples, and all are judged on
processes held out as a whole, on a thickness held out as a whole, and by tracks on sheets of
their own that were stitched with what they say.  The settings were chosen on other data seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from fuzzy_worth_rows import FUZZY, LAW, NOTHING, PLAIN, Part, Way

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.compensation import OffsetPath, compensate_path
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.training import equal_rows
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.studies.soft.foam_comparison import TrackCase
from fuzzycnc_ros.studies.soft.foam_training import (
    ComparedModel,
    Predictor,
    baselines,
    judge_training,
    network,
    plain_regressor,
)

HELD_OUT, THICKNESS = 'held-out processes [mm]', 'held-out thickness [mm]'
DEVIATION, ANGLE = 'largest deviation [mm]', 'angle error [deg]'
"""Headings of the figures; the first two are rms errors per 50 mm of feed."""

SEEDS = (40, 41, 42, 43, 44)
"""Data seeds; the defaults were chosen on 20 to 29."""

TRACKS = (TrackCase(25, 18, 7), TrackCase(40, 22, 9), TrackCase(52, 30, 11))
"""Angles and thicknesses between those of the samples."""

RUNS = 5
"""Runs of each track, each on a sheet that scatters."""

FEATURES = 'load'
"""Inputs and target of the default network, for all models."""

HIDDEN_ALONE = 23
"""Hidden nodes of one rule that have as many weights as the default network: 184 of 187."""


def no_compensation(x: Array, s: Array, groups: Array) -> Predictor:
    """Say that nothing is needed."""
    return lambda rows: np.zeros((len(rows), 2))


def _products(inputs: int) -> Any:
    """Return ridge regression on the inputs, their squares and their products."""
    from sklearn.linear_model import RidgeCV
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    penalties = np.logspace(-3, 2, 11)
    return make_pipeline(PolynomialFeatures(2), StandardScaler(), RidgeCV(penalties))


def rivals() -> tuple[tuple[str, ComparedModel], ...]:
    """Return the models, each with what stands in the place of its rules."""
    plain = {rival.label: rival for rival in baselines(FEATURES)}
    return (
        (FUZZY, network('T-S network, the default (NTS, 10 rules)')),
        (FUZZY, network('linear rules (STS, 10 rules)', consequent='sts')),
        (LAW, network('the same network, one rule', n_rules=1, hidden=HIDDEN_ALONE)),
        (LAW, network('one linear rule', consequent='sts', n_rules=1)),
        (PLAIN, plain['plain ridge regression']),
        (PLAIN, ComparedModel('ridge on products of two', plain_regressor(FEATURES, _products))),
        (PLAIN, plain['MLP, 32 and 32 nodes']),
        (NOTHING, ComparedModel('no compensation', no_compensation)),
    )


def prediction(quick: bool) -> Part:
    """Judge all models on samples that were held out."""
    chosen = rivals()
    models = [rival for _, rival in chosen]
    seeds = SEEDS[:1] if quick else SEEDS
    folds = 2 if quick else 5
    processes, thicknesses = [], []
    for seed in seeds:
        x, s = foam_samples(seed)
        processes.append(judge_training(x, s, equal_rows(x), models, folds=folds, seed=seed))
        sheets = np.unique(x[:, 4], return_inverse=True)[1]
        thicknesses.append(judge_training(x, s, sheets, models, folds=folds, seed=seed))
    ways = []
    for number, (part, rival) in enumerate(chosen):
        found = [judged.errors[number].rms for judged in processes]
        beyond = [judged.errors[number].rms for judged in thicknesses]
        ways.append(Way(rival.label, part, {HELD_OUT: found, THICKNESS: beyond}))
    cases = tuple(f'data seed {seed}' for seed in seeds)
    return Part('Soft material: held-out samples, rms per 50 mm of feed', cases, tuple(ways))


def tracks(quick: bool) -> Part:
    """Stitch tracks with what the models say, on sheets that scatter."""
    chosen = rivals()
    seeds, cases = (SEEDS[:1], TRACKS[:1]) if quick else (SEEDS, TRACKS)
    figures: list[tuple[list[float], list[float]]] = [([], []) for _ in chosen]
    for seed in seeds:
        x, s = foam_samples(seed)
        gate = TSFuzzyNetwork(random_state=0).fit(x, s).model_
        for (_, rival), (largest, angle) in zip(chosen, figures, strict=True):
            predict = rival.train(x, s, equal_rows(x))
            for case in cases:
                path = compensate_path(case.path, case.material, predict, gate=gate)
                found = _stitched(case, path, range(100 * seed, 100 * seed + RUNS))
                largest.append(1e3 * found[0])
                angle.append(float(np.degrees(found[1])))
    ways = [
        Way(rival.label, part, {DEVIATION: largest, ANGLE: angle})
        for (part, rival), (largest, angle) in zip(chosen, figures, strict=True)
    ]
    labels = tuple(f'data seed {seed}, {case.name}' for seed in seeds for case in cases)
    return Part(f'Soft material: tracks, means of {RUNS} runs', labels, tuple(ways))


def _stitched(case: TrackCase, path: OffsetPath, seeds: Sequence[int]) -> tuple[float, float]:
    """Return means of largest deviation [m] and angle error [rad] over runs."""
    qualities = [
        case.track.measure(case.stitch(path.commanded, np.random.default_rng(seed)))
        for seed in seeds
    ]
    return (
        float(np.mean([quality.max_deviation for quality in qualities])),
        float(np.mean([quality.angle_error for quality in qualities])),
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models of feed compensation, judged on samples that they were not trained on."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.features import feature_set, load
from fuzzycnc_ros.core.deformation.network import (
    TooFewSamplesError,
    TSFuzzyNetwork,
    samples_needed,
)
from fuzzycnc_ros.core.deformation.training import grouped_folds
from fuzzycnc_ros.core.threads import single_threaded

Predictor = Callable[[Array], Array]
Trainer = Callable[[Array, Array, NDArray[np.int64]], Predictor]
Tell = Callable[[str, int, int], None]

FOLDS = 5
"""Parts that are held out in turn."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Samples of one thickness.

    Attributes
    ----------
    thickness : float
        Thickness [m].
    lines, arcs : int
        Samples of each kind.
    direction, depth, step : tuple of float
        Least and largest direction [rad], depth and step [m].
    """

    thickness: float
    lines: int
    arcs: int
    direction: tuple[float, float]
    depth: tuple[float, float]
    step: tuple[float, float]


@dataclass(frozen=True, eq=False)
class MethodErrors:
    """Errors of one kind of model on samples that were held out.

    Attributes
    ----------
    name : str
        What it is called.
    predicted : ndarray, shape (k, 2)
        Compensations of all samples, each held out in turn [mm per 50 mm].
    rms : float
        Root mean square of both axes over all samples [mm per 50 mm].
    by_thickness : mapping of float to float
        The same by thickness [m].
    """

    name: str
    predicted: Array
    rms: float
    by_thickness: Mapping[float, float]


@dataclass(frozen=True, eq=False)
class FoamTraining:
    """A training, judged.

    Attributes
    ----------
    coverage : sequence of Coverage
        Samples by thickness.
    needed : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    errors : sequence of MethodErrors
        Held-out errors, the model in use first.
    folds, groups : int
        Parts that were held out in turn, and groups of samples that were kept together.
    """

    coverage: Sequence[Coverage]
    needed: Array
    errors: Sequence[MethodErrors]
    folds: int
    groups: int


@dataclass(frozen=True)
class Rival:
    """A model to compare.

    Parameters
    ----------
    label : str
        What it is called.
    train : callable
        From process values, compensations and groups to a predictor.
    """

    label: str
    train: Trainer


def network(label: str, **settings: Any) -> Rival:
    """Return the T-S fuzzy neural network with settings of `TSFuzzyNetwork`."""

    def train(x: Array, s: Array, groups: NDArray[np.int64]) -> Predictor:
        return TSFuzzyNetwork(**settings).fit(x, s, groups).predict

    return Rival(label, train)


def baselines(features: str, seed: int = 0) -> tuple[Rival, ...]:
    """Return plain regressors on a feature set, scaled inputs and outputs.

    Parameters
    ----------
    features : str
        Name of the feature set; with 'load' they learn the compensation per load, too.
    seed : int
        Seed of those that draw.

    Raises
    ------
    ImportError
        If scikit-learn is not installed.
    """
    from sklearn.ensemble import GradientBoostingRegressor
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
    from sklearn.linear_model import RidgeCV
    from sklearn.multioutput import MultiOutputRegressor
    from sklearn.neural_network import MLPRegressor

    def process(inputs: int) -> Any:
        kernel = ConstantKernel() * RBF(np.ones(inputs)) + WhiteKernel(1e-2)
        return MultiOutputRegressor(GaussianProcessRegressor(kernel))

    makers: dict[str, Callable[[int], Any]] = {
        'ridge regression': lambda inputs: RidgeCV(np.logspace(-3, 2, 11)),
        'MLP, 32 and 32 nodes': lambda inputs: MLPRegressor(
            hidden_layer_sizes=(32, 32),
            alpha=1.0,
            solver='lbfgs',
            max_iter=2000,
            max_fun=10**6,
            random_state=seed,
        ),
        'Gaussian process': process,
        'gradient boosting': lambda inputs: MultiOutputRegressor(
            GradientBoostingRegressor(n_estimators=300, random_state=seed)
        ),
    }
    return tuple(Rival(label, plain_regressor(features, make)) for label, make in makers.items())


def plain_regressor(features: str, make: Callable[[int], Any]) -> Trainer:
    """Return the training of a regressor of scikit-learn on scaled features.

    Parameters
    ----------
    features : str
        Name of the feature set; with 'load' it learns the compensation per load, too.
    make : callable
        Makes the regressor of a number of inputs.
    """
    chosen = feature_set(features)

    def weight(x: Array) -> Array:
        if not chosen.loaded:
            return np.ones((len(x), 1))
        return np.asarray(load(*x[:, [1, 3, 4]].T)[:, np.newaxis])

    def train(x: Array, s: Array, groups: NDArray[np.int64]) -> Predictor:
        from sklearn.preprocessing import StandardScaler

        target = s / weight(x)
        inputs, outputs = StandardScaler().fit(chosen.rows(x)), StandardScaler().fit(target)
        model = make(inputs.n_features_in_)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # a model that stops early is judged like any other
            model.fit(inputs.transform(chosen.rows(x)), outputs.transform(target))

        def predict(rows: Array) -> Array:
            scaled = model.predict(inputs.transform(chosen.rows(rows)))
            return np.asarray(outputs.inverse_transform(scaled) * weight(rows))

        return predict

    return train


@single_threaded
def check_enough(x: Array, s: Array, rules: int) -> None:
    """Refuse fewer samples than it takes to train a model and to judge it on others.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    rules : int
        Number of rules.

    Raises
    ------
    ValueError
        If there are; the text says how many are needed.
    """
    found, needed = len(np.unique(np.column_stack([x, s]), axis=0)), samples_needed(rules, FOLDS)
    if found < needed:
        raise ValueError(
            f'samples: expected at least {needed} that differ, to learn {rules} rules and to '
            f'judge them on others, but found {found}; record more'
        )


def judge_training(
    x: Array,
    s: Array,
    groups: NDArray[np.int64],
    rivals: Sequence[Rival],
    *,
    folds: int = FOLDS,
    seed: int = 0,
    progress: Tell = lambda text, done, total: None,
) -> FoamTraining:
    """Hold samples out in whole groups, in turn, and judge models on them.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    groups : ndarray of int, shape (k,)
        Groups that stay together.
    rivals : sequence of Rival
        Models, that in use first.
    folds, seed : int
        Parts, and seed of their draw.
    progress : callable
        Told what is going on, steps done and in all.

    Returns
    -------
    FoamTraining
        Errors of each model, all from the same parts.

    Raises
    ------
    ValueError
        If there are not three groups: training chooses its penalty on parts as well.
    """
    count = len(np.unique(groups))
    if count < 3:
        raise ValueError(
            f'samples: expected three different processes or sheets, to hold some out, but found '
            f'{count}; record more'
        )
    parts = grouped_folds(groups, folds, np.random.default_rng(seed))
    errors = []
    for number, rival in enumerate(rivals):
        predicted = np.empty_like(s)
        for done, part in enumerate(parts):
            progress(rival.label, number * len(parts) + done, len(rivals) * len(parts))
            try:
                predict = rival.train(x[~part], s[~part], groups[~part])
            except TooFewSamplesError as error:
                raise ValueError(
                    f'samples: expected groups of one process or sheet of which some can be held '
                    f'out, but found {len(x)} samples in {count} groups, too large a part of them '
                    'in one; record more sheets or processes'
                ) from error
            predicted[part] = predict(x[part])
        errors.append(_errors(rival.label, x, s, predicted))
    return FoamTraining(coverage(x), s, errors, len(parts), count)


def coverage(x: Array) -> tuple[Coverage, ...]:
    """Return what samples cover, by thickness."""
    found = []
    for thickness in np.unique(x[:, 4]):
        rows = x[x[:, 4] == thickness]
        low, high = rows.min(axis=0), rows.max(axis=0)
        found.append(
            Coverage(
                thickness=1e-3 * float(thickness),
                lines=int((rows[:, 2] == 2.0).sum()),
                arcs=int((rows[:, 2] == 1.0).sum()),
                direction=(float(np.radians(low[0])), float(np.radians(high[0]))),
                depth=(1e-3 * float(low[1]), 1e-3 * float(high[1])),
                step=(1e-3 * float(low[3]), 1e-3 * float(high[3])),
            )
        )
    return tuple(found)


def _errors(label: str, x: Array, s: Array, predicted: Array) -> MethodErrors:
    square = ((predicted - s) ** 2).mean(axis=1)
    return MethodErrors(
        label,
        predicted,
        float(np.sqrt(square.mean())),
        {
            1e-3 * float(thickness): float(np.sqrt(square[x[:, 4] == thickness].mean()))
            for thickness in np.unique(x[:, 4])
        },
    )

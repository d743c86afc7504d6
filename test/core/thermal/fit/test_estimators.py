# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every thermal estimator against scikit-learn's own checks.

What cannot pass is listed with its reason, and the list is held both ways: a check that fails
without being listed is an error, and so is a listed one that passes.
"""

import importlib
import pkgutil
import subprocess
import sys
import warnings

import numpy as np
import pytest

from fuzzycnc_ros import papers
from fuzzycnc_ros.core import thermal
from fuzzycnc_ros.core.estimator import check_target
from fuzzycnc_ros.core.thermal.fit import hybrid
from fuzzycnc_ros.core.thermal.fit.anfis import Anfis, GreyAnfis
from fuzzycnc_ros.core.thermal.fit.grey import GreyModel
from fuzzycnc_ros.core.thermal.fit.hybrid import HybridFilterNetwork
from fuzzycnc_ros.core.thermal.fit.linear import LagRidge, LeastSquares, StaticRidge
from fuzzycnc_ros.core.thermal.fit.regressor import ThermalRegressor
from fuzzycnc_ros.papers.grey import GreyVariant
from fuzzycnc_ros.papers.learners import GaussianProcess, Mlp
from fuzzycnc_ros.papers.networks import Arma, DynamicNetwork, LinearNetwork, StaticNetwork

checks = pytest.importorskip('sklearn.utils.estimator_checks')
exceptions = pytest.importorskip('sklearn.exceptions')

# Small networks and few samples: the checks are about conventions and fit hundreds of times.
ESTIMATORS = [
    LeastSquares(),
    StaticRidge(),
    LagRidge(),
    *(GreyModel(kind) for kind in GreyModel.kinds()),
    *(GreyVariant(kind) for kind in GreyVariant.kinds()),
    Anfis(),
    GreyAnfis(),
    GaussianProcess(samples_max=20),
    Mlp(hidden=(5,), iterations_max=50),
    HybridFilterNetwork(hidden=3),
    Arma(),
    StaticNetwork(hidden=2),
    DynamicNetwork(hidden=2),
    LinearNetwork(hidden=3),
]

ORDER = 'a sample follows on the one before: rows that are shuffled or split are another run'
UNORDERED = (
    'samples of the check are drawn one by one: past targets say nothing of the next, and a free '
    'run that feeds on its own outputs explains less than half of them'
)
TOO_FEW = 'the network asks for 3 (K + J) + 10 samples, the check has fewer'

IN_ORDER = {
    'check_methods_sample_order_invariance': ORDER,
    'check_methods_subset_invariance': ORDER,
}
SHORT_OF_19 = {
    'check_estimators_nan_inf': TOO_FEW,
    'check_n_features_in_after_fitting': TOO_FEW,
    'check_regressors_no_decision_function': TOO_FEW,
}
SHORT_OF_22 = SHORT_OF_19 | {
    'check_dict_unchanged': TOO_FEW,
    'check_dont_overwrite_parameters': TOO_FEW,
    'check_estimators_dtypes': TOO_FEW,
    'check_estimators_fit_returns_self': TOO_FEW,
    'check_estimators_overwrite_params': TOO_FEW,
    'check_f_contiguous_array_estimator': TOO_FEW,
    'check_fit2d_predict1d': TOO_FEW,
    'check_methods_sample_order_invariance': TOO_FEW,
    'check_methods_subset_invariance': TOO_FEW,
    'check_readonly_memmap_input': TOO_FEW,
}


def expected_failures(estimator):
    """Return the reason of each check that the estimator, as it ships, cannot pass."""
    match estimator:
        case GreyModel(kind='stable'):
            return {}  # on the samples of the checks its best pole is 0, which is static
        case GreyModel(kind='classical') | GreyVariant(kind='discrete'):
            return IN_ORDER
        case GreyModel():
            return IN_ORDER | {'check_regressors_train': UNORDERED}
        case LagRidge():
            return IN_ORDER
        case Arma():
            return SHORT_OF_22 | {'check_regressors_train': UNORDERED}
        case HybridFilterNetwork():
            return SHORT_OF_22
        case DynamicNetwork():
            return IN_ORDER | SHORT_OF_19
    return {}


def failed_checks(estimator):
    """Return the names of the checks that the estimator was put to, and how they failed."""
    if hasattr(checks, 'estimator_checks_generator'):
        generated = checks.estimator_checks_generator(estimator)
    else:  # scikit-learn before 1.6
        generated = checks.check_estimator(estimator, generate_only=True)
    names, failures = set(), {}
    for instance, check in generated:
        name = check.func.__name__
        names.add(name)
        try:
            with warnings.catch_warnings():
                # Checks of other array libraries announce that they do not apply.
                warnings.simplefilter('ignore', exceptions.SkipTestWarning)
                check(instance)
        except checks.SkipTest:
            continue
        except Exception as error:
            failures[name] = repr(error)
    assert len(names) > 30
    return names, failures


def assert_as_expected(estimator, expected):
    names, failures = failed_checks(estimator)
    # Some checks are younger than the oldest scikit-learn that is supported.
    assert set(failures) == set(expected) & names, failures


@pytest.mark.parametrize(
    'estimator',
    [
        pytest.param(one, marks=[pytest.mark.slow] * isinstance(one, Anfis | DynamicNetwork))
        for one in ESTIMATORS  # these two take long, and have a brother of the same kind
    ],
    ids=repr,
)
def test_scikit_learn_accepts(estimator):
    assert_as_expected(estimator, expected_failures(estimator))


def test_too_few_samples_are_all_that_keeps_the_hybrid_from_passing(monkeypatch):
    def lifted(*arguments):
        return original(*arguments[:-1], 2)

    original = hybrid.network_training
    monkeypatch.setattr(hybrid, 'network_training', lifted)
    assert_as_expected(HybridFilterNetwork(hidden=3), IN_ORDER)


def test_no_estimator_is_left_out():
    for package in (thermal, papers):
        for module in pkgutil.walk_packages(package.__path__, f'{package.__name__}.'):
            importlib.import_module(module.name)
    found, todo = set(), [ThermalRegressor]
    while todo:
        todo.extend(children := todo.pop().__subclasses__())
        found.update(kind for kind in children if {'fit', '_fit', '_take'} & set(vars(kind)))
    tested = {type(estimator) for estimator in ESTIMATORS}
    assert {kind.__name__ for kind in found} == {kind.__name__ for kind in tested}


@pytest.mark.parametrize('estimator', ESTIMATORS, ids=repr)
def test_estimators_are_regressors(estimator):
    base = pytest.importorskip('sklearn.base')
    assert base.is_regressor(estimator)


def test_targets_are_checked_before_they_are_converted():
    with pytest.raises(ValueError, match='requires y to be passed'):
        check_target(LagRidge(), None)
    with pytest.raises(ValueError, match='Complex data not supported'):
        check_target(LagRidge(), [1j])
    with pytest.raises(ValueError, match='infinity'):
        check_target(LagRidge(), [0.0, np.inf])
    assert np.isnan(check_target(LagRidge(), [0.0, np.nan])[1])


def test_columns_are_taken_the_same_way_without_scikit_learn():
    program = """
import sys, warnings
sys.modules['sklearn'] = None
from fuzzycnc_ros.core.estimator import DataConversionWarning
from fuzzycnc_ros.core.thermal.fit import LagRidge
rise = [[0.0], [1.0], [2.0], [3.0]]
expected = LagRidge().fit(rise, [0.0, 1.0, 2.0, 3.0]).predict(rise)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter('always')
    column = LagRidge().fit(rise, [[0.0], [1.0], [2.0], [3.0]]).predict(rise)
assert [item.category for item in caught] == [DataConversionWarning]
assert (column == expected).all()
"""
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize('estimator', [LagRidge(), GreyModel('classical')])
def test_groups_are_runs_by_another_word(estimator):
    rng = np.random.default_rng(0)
    rise, runs = rng.normal(size=(80, 2)).cumsum(axis=0), np.repeat(['monday', 'tuesday'], 40)
    target = rise @ [1e-6, 2e-6]
    by_runs = estimator.fit(rise, target, runs=runs).predict(rise, runs=runs)
    by_groups = estimator.fit(rise, target, groups=runs).predict(rise, groups=runs)
    np.testing.assert_array_equal(by_groups, by_runs)
    assert not np.array_equal(estimator.predict(rise), by_runs)
    with pytest.raises(ValueError, match='runs or groups'):
        estimator.fit(rise, target, runs=runs, groups=runs)
    with pytest.raises(ValueError, match='runs or groups'):
        estimator.predict(rise, runs=runs, groups=runs)

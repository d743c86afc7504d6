# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Base of all estimators: scikit-learn's where it is installed, a small mixin where not.

Estimators follow scikit-learn's conventions: parameters are stored untouched by `__init__`,
`fit` returns the estimator, learnt values end in an underscore.
"""

import inspect
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array, check_matrix


class NotFittedError(ValueError, AttributeError):
    """An estimator was asked for something that only a fit provides."""


class DataConversionWarning(UserWarning):
    """Data had another shape than expected, but what is meant is clear."""


class _ParameterMixin:
    """`get_params`, `set_params` and the readable form, as scikit-learn defines them."""

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the constructor's parameters by name."""
        names = [name for name in inspect.signature(type(self)).parameters if name != 'self']
        return {name: getattr(self, name) for name in names}

    def set_params(self, **params: Any) -> Any:
        """Set parameters by name and return the estimator.

        Raises
        ------
        ValueError
            If there is no parameter of a given name.
        """
        known = self.get_params()
        for name in params:
            if name not in known:
                raise ValueError(
                    f'{type(self).__name__}: expected one of the parameters {", ".join(known)}, '
                    f'but found {name!r}'
                )
        for name, value in params.items():
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        """Return the constructor call that makes an equal estimator."""
        params = ', '.join(f'{name}={value!r}' for name, value in self.get_params().items())
        return f'{type(self).__name__}({params})'


def check_target(estimator: Any, target: ArrayLike) -> Array:
    """Return a target as a vector of doubles, NaN where it was not measured.

    Parameters
    ----------
    estimator : object
        Estimator under training, for the message.
    target : array_like, shape (n,)
        Values by samples.  A column (n, 1) is taken with a warning.

    Raises
    ------
    ValueError
        If it is absent, complex or infinite.
    """
    if target is None:
        raise ValueError(
            f'y: expected one value per sample. {type(estimator).__name__} requires y to be '
            'passed, but the target y is None'
        )
    raw = np.asarray(target)
    if np.iscomplexobj(raw):
        raise ValueError('y: expected real numbers. Complex data not supported')
    values = np.asarray(raw, dtype=np.float64)
    if values.ndim == 2 and values.shape[1] == 1:
        warnings.warn(
            'A column-vector y was passed when a 1d array was expected; pass y.ravel()',
            DataConversionWarning,
            stacklevel=3,
        )
        values = values[:, 0]
    if np.isinf(values).any():
        raise ValueError('y: expected finite values or NaN, but found infinity')
    return values


if TYPE_CHECKING:
    Estimator = _ParameterMixin

    class ClusterEstimator(_ParameterMixin):
        """Base of cluster estimators."""

        def fit_predict(self, X: ArrayLike, y: Any = None, **params: Any) -> NDArray[np.int64]:  # noqa: N803
            """Return the label of each sample."""
            raise NotImplementedError

    class RegressionEstimator(_ParameterMixin):
        """Base of regressors."""

    def check_features(estimator: Any, samples: Any, *, reset: bool) -> Array:
        """Return the samples as a matrix that fits the estimator."""
        raise NotImplementedError

else:
    try:
        from sklearn.base import BaseEstimator as Estimator
        from sklearn.base import ClusterMixin, RegressorMixin
        from sklearn.exceptions import DataConversionWarning, NotFittedError

        try:
            from sklearn.utils.validation import validate_data
        except ImportError:  # scikit-learn before 1.6 has it as a method

            def validate_data(estimator: Any, samples: Any, **options: Any) -> Array:
                """Call the method of the same purpose."""
                return estimator._validate_data(samples, **options)

        class ClusterEstimator(ClusterMixin, Estimator):
            """Base of cluster estimators."""

        class RegressionEstimator(RegressorMixin, Estimator):
            """Base of regressors."""

        def check_features(estimator: Any, samples: Any, *, reset: bool) -> Array:
            """Return the samples as a matrix that fits the estimator, by scikit-learn's rules."""
            return validate_data(estimator, samples, dtype=np.float64, reset=reset)

    except ImportError:
        Estimator = _ParameterMixin

        class ClusterEstimator(_ParameterMixin):
            """Base of cluster estimators."""

            def fit_predict(self, X: ArrayLike, y: Any = None, **params: Any) -> NDArray[np.int64]:  # noqa: N803
                """Fit and return the label of each sample."""
                return self.fit(X).labels_

        class RegressionEstimator(_ParameterMixin):
            """Base of regressors."""

        def check_features(estimator: Any, samples: Any, *, reset: bool) -> Array:
            """Return the samples as a matrix with the number of features seen by `fit`."""
            matrix = check_matrix(samples)
            if reset:
                estimator.n_features_in_ = matrix.shape[1]
            elif matrix.shape[1] != estimator.n_features_in_:
                raise ValueError(
                    f'X has {matrix.shape[1]} features, but {type(estimator).__name__} is '
                    f'expecting {estimator.n_features_in_} features as input'
                )
            return matrix


def check_fitted(estimator: Any, attribute: str) -> None:
    """Refuse an estimator that has not been fitted.

    Raises
    ------
    NotFittedError
        If the learnt `attribute` is absent.
    """
    if not hasattr(estimator, attribute):
        raise NotFittedError(
            f'{type(estimator).__name__}: expected a fitted estimator, but found no {attribute}; '
            "call 'fit' first"
        )

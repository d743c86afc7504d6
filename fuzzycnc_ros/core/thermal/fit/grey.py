# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Grey model GM(1,N) of the thermal error: as published, solved exactly, and made stable.

Its variants with constants are in `fuzzycnc_ros.papers.grey`.
"""

import copy
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.fit.linear import (
    check_ridge,
    column_scale,
    lag_features,
    linear_recursion,
    ridge_solution,
)
from fuzzycnc_ros.core.thermal.fit.regressor import (
    ThermalRegressor,
    check_sample_count,
    check_training,
    run_labels,
)
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, check_interval
from fuzzycnc_ros.core.thermal.recursions.grey import (
    GreyRecursion,
    development_of,
    pole_of,
)

POLES_PER_MINUTE = (0.0, 0.2, 0.4, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.985, 0.99)
"""Poles that the stable form tries at 1 min; other intervals use the same time constants."""

_CONDITION_MAX = 1e6
"""Condition number of the scaled regression matrix above which a classical fit is refused."""


@dataclass(eq=False, repr=False)
class GreyModel(ThermalRegressor):
    """Grey model GM(1,N), [ding_zeng] eqs. (10)-(16).

    Parameters
    ----------
    kind : {'classical', 'derived', 'stable'}
        'classical' fits eq. (14) and predicts by the published time response (15)-(16);
        'derived' has the same coefficients, but solves eq. (12) exactly as a recursion;
        'stable' fits the output error of the derived recursion, its pole bounded below 1.
    interval : float
        Sampling interval of the training samples [s].
    ridge : float
        Penalty of the stable form per sample [-].
    poles : sequence of float, optional
        Poles in [0, 1) that the stable form tries, ascending [-].

    Attributes
    ----------
    a_ : float
        Development coefficient [-].
    b_ : ndarray, shape (p,)
        Driving coefficients, target unit per driver unit [m/K].
    phi_ : float
        Pole of the recursion [-]: (1 - a/2) / (1 + a/2).
    condition_ : float
        Condition number of the scaled regression matrix [-].
    stable_ : bool
        Whether a is positive, without which the prediction grows without bound.
    problems_ : tuple of str
        Why the fit is not to be trusted; empty if it is.
    reliable_ : bool
        Whether there are no problems.

    Notes
    -----
    Eq. (15) is exact for constant drivers only; once its exponential has died it is a static
    linear regression, and with a <= 0 it diverges.  The published method does not check this.

    Examples
    --------
    Without drivers it is GM(1,1), whose one coefficient is the constant input:

    >>> series = [2.874, 3.278, 3.337, 3.390, 3.679]
    >>> model = GreyModel('classical').fit(None, series)
    >>> print(round(model.a_, 6), round(model.b_[0], 6), model.reliable_)
    -0.037204 3.065363 False
    >>> model.predict(constant_input(5), initial=series[0]).round(3).tolist()
    [2.874, 3.232, 3.355, 3.482, 3.614]
    """

    kind: str = 'stable'
    _: KW_ONLY
    interval: float = 60.0
    ridge: float = 1e-3
    poles: Sequence[float] | None = None

    CONSTANTS: ClassVar[dict[str, int]] = {'classical': 0, 'derived': 0}
    """Kinds that accumulate their target, and how many constants each has beside a and b."""

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        """Return the kinds that there are; all but the stable one accumulate their target."""
        return (*cls.CONSTANTS, 'stable')

    def fit(
        self,
        X: ArrayLike | None,  # noqa: N803
        y: ArrayLike,
        *,
        runs: ArrayLike | None = None,
        groups: ArrayLike | None = None,
        use: ArrayLike | None = None,
    ) -> 'GreyModel':
        """Fit drivers (n, p) to the target (n,).

        Parameters
        ----------
        X : array_like, shape (n, p), or None
            Drivers; here the rises of the chosen sensors [K].  None fits GM(1,1) to one run,
            in the classical and derived forms.
        y : array_like, shape (n,)
            Target [m].  The stable form ignores NaN; the others cannot accumulate over it and
            leave out runs that were not measured at all.
        runs, groups : array_like, shape (n,), optional
            Label of the run that each sample belongs to, by either word; each accumulates from
            its own start.
        use : array_like of bool, shape (n,), optional
            Samples whose equations are fitted; the others only drive accumulation and lags, as
            judging on held-out stretches of one run needs it.  All, if absent.

        Raises
        ------
        ValueError
            If `kind` is unknown, there are too few samples, or a form that accumulates the
            target meets NaN.
        """
        if self.kind not in self.kinds():
            raise ValueError(
                f'kind: expected one of {", ".join(self.kinds())}, but found {self.kind!r}'
            )
        runs = run_labels(runs, groups)
        if X is None:
            if self.kind not in ('classical', 'derived') or runs is not None:
                raise ValueError(
                    'X: expected drivers, but found None; GM(1,1) is classical, one run'
                )
            X = constant_input(np.size(y))  # noqa: N806
        drivers, target, rows = check_training(self, X, y, runs)
        used = np.ones(target.shape, bool) if use is None else np.asarray(use, dtype=bool)
        if used.shape != target.shape:
            raise ValueError(f'use: expected {target.size} switches, but found {used.shape}')
        if not np.isfinite(target[used]).any():
            raise ValueError('use: expected a measured sample to fit, but found none')
        if self.kind == 'stable':
            self._fit_stable(drivers, np.where(used, target, np.nan), rows)
        else:
            self._fit_accumulated(drivers, target, rows, used)
        self.stable_ = self.a_ > 0.0
        self.reliable_ = not self.problems_
        return self

    def predict(
        self,
        X: ArrayLike,  # noqa: N803
        *,
        runs: ArrayLike | None = None,
        groups: ArrayLike | None = None,
        initial: float = 0.0,
    ) -> Array:
        """Return the target of whole runs, each from its own start.

        Parameters
        ----------
        X : array_like, shape (n, p)
            Drivers [K].
        runs, groups : array_like, shape (n,), optional
            Label of the run that each sample belongs to, by either word; one run if absent.
        initial : float
            First value y(1) of each run [m]; 0 for rises.  The stable form is anchored at zero
            and has none.

        Returns
        -------
        ndarray, shape (n,)
            Target [m]; infinite or NaN where the classical form has diverged.
        """
        runs = run_labels(runs, groups)
        if initial == 0.0:
            return super().predict(X, runs=runs)
        if self.kind == 'stable':
            raise ValueError(f'initial: expected 0 for the stable form, but found {initial}')
        raised = copy.copy(self)
        raised.recursion_ = self.solution(initial)
        return ThermalRegressor.predict(raised, X, runs=runs)

    def equations(
        self, drivers: Array, target: Array, rows: Sequence[slice], used: NDArray[np.bool_]
    ) -> tuple[Array, Array]:
        """Return B and Y of [ding_zeng] eq. (14), or of the equation of the kind.

        Parameters
        ----------
        drivers : ndarray, shape (n, p)
            Drivers [K].
        target : ndarray, shape (n,)
            Target.
        rows : sequence of slice
            Rows of each run; each accumulates from its own start.
        used : ndarray of bool, shape (n,)
            Samples whose equation is fitted.

        Returns
        -------
        matrix, left : ndarray
            The used rows of k = 2..n of every run, stacked.
        """
        blocks = []
        for run in rows:
            columns, left = self._run_equations(drivers[run], target[run])
            keep = used[run][1:]
            blocks.append((columns[keep], left[keep]))
        return np.concatenate([b for b, _ in blocks]), np.concatenate([y for _, y in blocks])

    def _run_equations(self, drivers: Array, target: Array) -> tuple[Array, Array]:
        """Return the columns (n - 1, ...) and the left side (n - 1,) of one run's equations."""
        total = np.cumsum(target)
        driver = np.cumsum(drivers, axis=0)
        return np.column_stack([-0.5 * (total[1:] + total[:-1]), driver[1:]]), target[1:]

    def _take(self, solution: Array, unit: float) -> None:
        """Take a, b and the pole from the solution for a target divided by `unit`."""
        self.a_ = float(solution[0])
        self.b_: Array = solution[1:] * unit
        self.phi_ = float(pole_of(np.array(self.a_)))

    def solution(self, initial: float) -> Recursion:
        """Return a fitted form that accumulates, from a first value y(1) [m]."""
        return GreyRecursion(
            exact=self.kind == 'derived',
            a=np.array([self.a_]),
            b=self.b_[np.newaxis],
            initial=np.array([initial]),
        )

    def _fit_accumulated(
        self, drivers: Array, target: Array, rows: Sequence[slice], used: NDArray[np.bool_]
    ) -> None:
        check_sample_count(target, drivers.shape[1] + 1 + self.CONSTANTS[self.kind])
        rows = [run for run in rows if np.isfinite(target[run]).any()]
        missing = sum(int(np.isnan(target[run]).sum()) for run in rows)
        if missing:
            raise ValueError(
                f'y: expected a value in every sample, but found {missing} NaN; the {self.kind} '
                'form accumulates its target: use the stable form'
            )
        check_interval(self.interval)
        unit = float(np.nanmax(np.abs(target))) or 1.0
        matrix, left = self.equations(drivers, target / unit, rows, used)
        # Unit columns, so that the condition number tells collinearity and not units.
        norm = np.linalg.norm(matrix, axis=0)
        norm[norm == 0.0] = 1.0
        solution, _, _, singular = np.linalg.lstsq(matrix / norm, left, rcond=None)
        self.condition_ = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else np.inf
        self._take(solution / norm, unit)
        self.recursion_: Recursion = self.solution(0.0)
        self.problems_ = self._accumulated_problems()

    def _accumulated_problems(self) -> tuple[str, ...]:
        problems = []
        slowest = float(stable_poles(self.interval)[-1])
        if not self.a_ > 0.0:
            problems.append(
                f'a = {self.a_:.4g} is not positive: the prediction grows without bound'
            )
        elif self.phi_ > slowest:
            problems.append(
                f'the pole {self.phi_:.6g} lies beyond {slowest:.6g}, the slowest that is '
                'trusted: the prediction sums up its errors'
            )
        if not self.condition_ <= _CONDITION_MAX:
            problems.append(
                f'the condition number {self.condition_:.3g} exceeds {_CONDITION_MAX:g}: the '
                'drivers are collinear, the coefficients arbitrary'
            )
        return tuple(problems)

    def _fit_stable(self, drivers: Array, target: Array, rows: Sequence[slice]) -> None:
        check_ridge(self.ridge)
        poles = stable_poles(self.interval) if self.poles is None else _checked(self.poles)
        measured = np.isfinite(target)
        scale = column_scale(drivers[measured])
        unit = float(target[measured].std()) or 1.0
        values = target[measured] / unit
        # One pass over the samples for all poles: the pass is what takes time.
        lagged = lag_features(drivers / scale, rows, poles, direct=False)[measured]
        banks = np.split(lagged, len(poles), axis=1)
        thetas = [ridge_solution(features, values, self.ridge) for features in banks]
        costs = [
            float(np.mean((values - features @ theta) ** 2) + self.ridge * theta @ theta)
            for features, theta in zip(banks, thetas, strict=True)
        ]
        index = int(np.argmin(costs))
        theta, features = thetas[index], banks[index]
        weight = unit * theta / scale
        self.phi_ = float(poles[index])
        self.a_ = float(development_of(poles[index]))
        self.b_ = weight * (1.0 - self.phi_) * (1.0 + self.a_ / 2.0)
        self.condition_ = float(np.linalg.cond(features / column_scale(features)))
        self.recursion_ = linear_recursion(weight, poles[index : index + 1], False, 0.0)
        # A pole of 0 is a static machine; at the other end the best one may lie beyond.
        at_end = len(poles) > 1 and index == len(poles) - 1
        self.problems_ = (
            (f'the pole {self.phi_:g} is the end of the grid: the lag lies beyond it',)
            if at_end
            else ()
        )


def constant_input(samples: int) -> Array:
    """Return the driver, shape (n, 1), whose accumulation is the constant 1, as GM(1,1) has it."""
    driver = np.zeros((samples, 1))
    driver[:1] = 1.0
    return driver


def stable_poles(interval: float) -> Array:
    """Return the grid of poles for a sampling interval [s]: 1-min poles to the same lags."""
    check_interval(interval)
    return np.asarray(np.array(POLES_PER_MINUTE) ** (interval / 60.0))


def _checked(poles: Sequence[float]) -> Array:
    grid = np.asarray(poles, dtype=np.float64)
    if grid.ndim != 1 or not len(grid) or not ((grid >= 0.0) & (grid < 1.0)).all():
        raise ValueError(f'poles: expected one pole or more in [0, 1), but found {poles}')
    return grid

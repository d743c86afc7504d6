# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Grey models that accumulate their target: their regressions, and the recursions they become.

References
----------
.. [1] T.-L. Tien, "A research on the grey prediction model GM(1,n)", 2012: GMC(1,N).
.. [2] B. Zeng, C. Luo, S. Liu, Y. Bai, C. Li, "Development of an optimization method for the
   GM(1,N) model", 2016: OGM(1,N).
.. [3] N.-M. Xie, S.-F. Liu, "Discrete grey forecasting model and its optimization", 2009:
   DGM(1,N).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.recursions import (
    DifferencedGreyRecursion,
    GreyRecursion,
    Recursion,
    development_of,
    pole_of,
)

CONSTANTS = {'classical': 0, 'derived': 0, 'convolution': 1, 'optimised': 2, 'discrete': 2}
"""Kinds that accumulate their target, and how many constants each has beside a and b."""


@dataclass(frozen=True, eq=False)
class GreyCoefficients:
    """What a regression in accumulated series gives.

    Parameters
    ----------
    kind : str
        One of `CONSTANTS`.
    a : float
        Development coefficient [-].
    b : ndarray, shape (p,)
        Driving coefficients [m/K].
    constants : ndarray, shape (0,), (1,) or (2,)
        u of the convolution form, h1 and h2 of the optimised and discrete ones [m].
    """

    kind: str
    a: float
    b: Array
    constants: Array

    @staticmethod
    def of(kind: str, solution: Array, unit: float) -> 'GreyCoefficients':
        """Take the solution of `regression` for a target divided by `unit`."""
        lead, others = float(solution[0]), solution[1:] * unit
        drivers = len(others) - CONSTANTS[kind]
        if kind == 'discrete':
            # Its equation is the optimised one, divided by 1 + a/2.
            with np.errstate(divide='ignore'):
                lead = float(development_of(np.array(lead)))
            others = others * (1.0 + lead / 2.0)
        return GreyCoefficients(kind, lead, others[:drivers], others[drivers:])

    @property
    def pole(self) -> float:
        """Pole of the recursion [-]: exp(-a) of the convolution form, (1-a/2)/(1+a/2) else."""
        if self.kind == 'convolution':
            return float(np.exp(-self.a))
        return float(pole_of(np.array(self.a)))

    def recursion(self, initial: float) -> Recursion:
        """Return the model of one channel at run time, from a first value y(1) [m]."""
        if self.kind in ('classical', 'derived'):
            return GreyRecursion(
                a=np.array([self.a]),
                b=self.b[np.newaxis],
                initial=np.array([initial]),
                exact=self.kind == 'derived',
            )
        pole = self.pole
        if self.kind == 'convolution':
            gain, constant = self.b / 2.0, 0.0
            start = initial * (pole - 1.0) + self.constants[0] * (1.0 + pole) / 2.0
        else:
            half = 1.0 + self.a / 2.0
            gain, constant = self.b / half, float(self.constants[0]) / half
            start = (self.constants.sum() - self.a * initial) / half
        return DifferencedGreyRecursion(
            pole=np.array([pole]),
            gain=gain[np.newaxis],
            constant=np.array([constant]),
            start=np.array([start]),
            initial=np.array([initial]),
            averaged=self.kind == 'convolution',
        )


def regression(
    kind: str, drivers: Array, target: Array, rows: Sequence[slice], used: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return B and Y of eq. (14) or of its variants, method sheet 001 section 3.2.

    Parameters
    ----------
    kind : str
        One of `CONSTANTS`.
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
        total = np.cumsum(target[run])
        driver = np.cumsum(drivers[run], axis=0)
        if kind == 'convolution':
            driver = (driver + np.concatenate([driver[:1], driver[:-1]])) / 2.0
        if kind == 'discrete':
            past, left = total[:-1], total[1:]
        else:
            past, left = -0.5 * (total[1:] + total[:-1]), target[run][1:]
        number = np.arange(1.0, len(total))
        constants = (number, np.ones_like(number))[2 - CONSTANTS[kind] :]
        keep = used[run][1:]
        blocks.append((np.column_stack([past, driver[1:], *constants])[keep], left[keep]))
    return np.concatenate([b for b, _ in blocks]), np.concatenate([y for _, y in blocks])

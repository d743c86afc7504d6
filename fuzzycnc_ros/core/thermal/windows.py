# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Windows of a run: which of its samples count, and what nobody may know of the others.

One rule holds for every command.  A window says which samples count.  It never moves the
reference: temperatures and displacements stay referred to the first samples of the recording,
and what lies before the window warms up the lags, as it did on the machine.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.run import REFERENCE_SAMPLES, ThermalDataError, ThermalRun

SPARSE = 4.0
"""Time without a measurement that still belongs to the training, in usual steps of it [-]."""


def counted(run: ThermalRun, start: float | None = None, stop: float | None = None) -> ThermalRun:
    """Return a run of which only the samples from `start` to `stop` [s] are measured.

    Samples before `start` keep their temperatures, which warm up the lags, and lose their
    displacements; samples after `stop` are dropped.

    Raises
    ------
    ThermalDataError
        If no sample lies in the window.
    """
    inside = run.inside(start, stop)
    if not inside.any():
        raise ThermalDataError(
            f'run {run.name!r}: expected samples between {start} and {stop} s, but found it to '
            f'last from {run.time[0]:.6g} to {run.time[-1]:.6g} s'
        )
    last = int(np.flatnonzero(inside)[-1]) + 1
    return replace(
        run,
        time=run.time[:last],
        temperature=run.temperature[:last],
        displacement=np.where(inside[:last, np.newaxis], run.displacement[:last], np.nan),
        spindle_speed=None if run.spindle_speed is None else run.spindle_speed[:last],
    )


def hidden(run: ThermalRun, inside: NDArray[np.bool_]) -> ThermalRun:
    """Return a run that tells nothing of some of its samples, for training on the others.

    Parameters
    ----------
    run : ThermalRun
        An even run.
    inside : ndarray of bool, shape (n,)
        Samples to hide.

    Returns
    -------
    ThermalRun
        It ends with the last sample that is not hidden.  In the hidden ones before there is no
        displacement, each temperature goes in a straight line from the last
        sample before to the first one after, and the speed stays what it was before: the lags of
        later samples need some value, and it must not come from what is held out.  The first
        three samples keep their temperatures, since all later ones are referred to them.
    """
    last = int(np.flatnonzero(~inside)[-1]) + 1
    run, inside = run.window(stop=float(run.time[last - 1])), inside[:last]
    untold = inside & (np.arange(len(inside)) >= REFERENCE_SAMPLES)
    seen, gone = np.flatnonzero(~untold), np.flatnonzero(untold)
    temperature = run.temperature.copy()
    for readings in temperature.T:
        readings[gone] = np.interp(run.time[gone], run.time[seen], readings[seen])
    speed = run.spindle_speed
    if speed is not None:
        before = np.maximum(np.searchsorted(seen, gone) - 1, 0)
        speed = speed.copy()
        speed[gone] = speed[seen[before]]
    return replace(
        run,
        temperature=temperature,
        displacement=np.where(inside[:, np.newaxis], np.nan, run.displacement),
        spindle_speed=speed,
    )


def observed(time: Array, displacement: Array) -> NDArray[np.bool_]:
    """Return which samples of a run were trained on, shape (n,).

    Those with a displacement, and those between two that are no further apart than usual: a
    touch probe measures once in many samples.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Time of each sample [s].
    displacement : ndarray, shape (n, c)
        Thermal error [m]; NaN where nothing was measured.
    """
    at = np.flatnonzero(np.isfinite(displacement).any(axis=1))
    trained = np.zeros(len(time), dtype=np.bool_)
    trained[at] = True
    if len(at) < 2:
        return trained
    step = np.diff(time[at])
    near = step <= SPARSE * float(np.median(step))
    for first, last in zip(at[:-1][near], at[1:][near], strict=True):
        trained[first:last] = True
    return trained

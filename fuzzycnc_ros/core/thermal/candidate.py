# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A fitted candidate model, as a model file keeps it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.run import SPINDLE_SPEED

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.recursions.base import Recursion

UNCOMPENSATED = 'uncompensated'
"""The machine as it is: the candidate that predicts nothing, which every model must beat."""

DEFAULT = 'default'
"""Row of the automatic choice, beside those of the candidates."""

BASELINES = ('least_squares', 'static_ridge', 'lag_ridge')
"""Plain models that every table shows beside the others."""

CANDIDATES = (
    *BASELINES,
    'lag_ridge_speed',
    'lag_ridge_drives',
    'classical_grey',
    'stable_grey',
    'anfis',
    'grey_anfis',
    'hybrid_network',
    'hybrid_network_speed',
)
"""Names of the candidates that a model file may hold, in the order of tables."""

COMPARED_ONLY = (
    'convolution_grey',
    'optimised_grey',
    'discrete_grey',
    'arma',
    'static_network',
    'dynamic_network',
    'linear_network',
    'gaussian_process',
    'gaussian_process_speed',
    'mlp',
    'mlp_speed',
)
"""Names of models that are compared, but run on no machine; model files held them once."""

STANDARD = (
    *BASELINES,
    'lag_ridge_speed',
    'classical_grey',
    'stable_grey',
    'grey_anfis',
    'hybrid_network',
)
"""Candidates that training fits unless told otherwise; `lag_ridge_drives` beside `lag_ridge`."""

SPEED_SUFFIX = '_speed'
"""Ending of the name of a candidate that reads the spindle speed."""

DRIVES_SUFFIX = '_drives'
"""Ending of the name of a candidate that reads all drivers that the control reports."""


def drivers_read(name: str, drivers: tuple[str, ...]) -> tuple[str, ...]:
    """Return which of the drivers at hand a candidate reads; none if one that it needs lacks."""
    speed = drivers[: drivers[:1] == (SPINDLE_SPEED,)]
    if name.endswith(DRIVES_SUFFIX):
        return drivers if drivers != speed else ()
    return speed if name.endswith(SPEED_SUFFIX) else ()


Settings = dict[str, float | str | tuple[float, ...]]
"""Settings of a candidate that were chosen on held-out samples."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted candidate and what it achieved on held-out samples.

    Parameters
    ----------
    name : str
        One of `CANDIDATES`, or of what they are compared with.
    settings : tuple of dict, length c
        Settings of each channel, chosen on held-out samples, or fixed ones.
    recursion : Recursion
        The fit to all training samples, all channels.
    problems : tuple of str
        Why the fit is not to be trusted; empty if it is.
    held_out_rms, held_out_max : ndarray, shape (c,)
        Residual on samples that the judged fits had not seen [m]; infinite if it diverged.
    """

    name: str
    settings: tuple[Settings, ...]
    recursion: 'Recursion'
    problems: tuple[str, ...]
    held_out_rms: Array
    held_out_max: Array

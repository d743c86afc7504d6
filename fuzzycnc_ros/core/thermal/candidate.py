# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A fitted candidate model, as a model file keeps it."""

from dataclasses import dataclass

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.recursions import Recursion

CANDIDATES = ('least_squares', 'static_ridge', 'classical_grey', 'stable_grey', 'lag_ridge')
"""Names of the candidates, in the order of tables."""

Settings = dict[str, float | tuple[float, ...]]
"""Settings of a candidate that were chosen on held-out samples."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted candidate and what it achieved on held-out samples.

    Parameters
    ----------
    name : str
        One of `CANDIDATES`.
    settings : dict
        Settings chosen on held-out samples, or fixed ones.
    recursion : Recursion
        The fit to all training samples, all channels.
    problems : tuple of str
        Why the fit is not to be trusted; empty if it is.
    held_out_rms, held_out_max : ndarray, shape (c,)
        Residual on samples that the judged fits had not seen [m]; infinite if it diverged.
    """

    name: str
    settings: Settings
    recursion: Recursion
    problems: tuple[str, ...]
    held_out_rms: Array
    held_out_max: Array

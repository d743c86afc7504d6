# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""All models side by side on what they never saw, and what the automatic choice makes of them.

The choice is nested: for every held-out run sensors, settings and the default model are chosen
anew from the other runs alone, so that the row of the default is what a user would have got.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import STANDARD
from fuzzycnc_ros.core.thermal.fingerprint import Fingerprint
from fuzzycnc_ros.core.thermal.fit.candidates import CONTENDERS, Contender
from fuzzycnc_ros.core.thermal.fit.evaluation import Evaluation, evaluate, pooled_rms
from fuzzycnc_ros.core.thermal.fit.folds import thermal_cycles
from fuzzycnc_ros.core.thermal.fit.refinement import Progress
from fuzzycnc_ros.core.thermal.fit.training import (
    at_interval,
    check_copies,
    train_model,
    training_interval,
)
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun, hidden

CHAIN = (0.5, 0.7, 1.0)
"""Forward chaining of a single run without cycles: train up to a cut, judge up to the next."""


@dataclass(frozen=True, eq=False)
class Split:
    """Runs to train on, and the held-out run.

    Parameters
    ----------
    name : str
        Name of the held-out run or stretch.
    training : tuple of ThermalRun
        Runs to train on; the held-out stretch of a single run is hidden in them.
    held_out : ThermalRun
        Run to judge on, from its start, so that lags are warm where the judging begins.
    start, stop : float or None
        Times [s] between which residuals count.
    """

    name: str
    training: tuple[ThermalRun, ...]
    held_out: ThermalRun
    start: float | None = None
    stop: float | None = None


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Residuals of all models on one held-out run.

    Parameters
    ----------
    evaluation : Evaluation
        Residuals of every candidate, of the automatic choice ('default') and of the
        uncompensated machine.
    inputs : tuple of str
        Sensors that were chosen.
    refused : mapping of str to str
        Candidates that are not to be trusted or could not be fitted, and why.
    """

    evaluation: Evaluation
    inputs: tuple[str, ...]
    refused: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Comparison:
    """All held-out runs.

    Parameters
    ----------
    held_out : tuple of HeldOut
        One entry per held-out run or stretch.
    """

    held_out: tuple[HeldOut, ...]

    @property
    def channel(self) -> tuple[str, ...]:
        """Channels."""
        return self.held_out[0].evaluation.channel

    @property
    def names(self) -> tuple[str, ...]:
        """Rows that every held-out run has, in the order of tables."""
        rows = [item.evaluation.rms for item in self.held_out]
        return tuple(name for name in rows[0] if all(name in other for other in rows))

    @property
    def refused(self) -> dict[str, str]:
        """Candidates that are not to be trusted on at least one of the held-out runs, and why."""
        reasons: dict[str, str] = {}
        for item in self.held_out:
            for name, reason in item.refused.items():
                reasons.setdefault(name, reason)
        return reasons

    def rms(self) -> dict[str, Array]:
        """Return the root mean square residual over all held-out samples, see `pooled_rms`."""
        return pooled_rms([item.evaluation for item in self.held_out])

    def largest(self) -> dict[str, Array]:
        """Return the largest residual over all held-out samples, (c,) [m]."""
        return {
            name: np.nanmax([item.evaluation.largest[name] for item in self.held_out], axis=0)
            for name in self.names
        }


def splits(
    runs: Sequence[ThermalRun],
    windows: Sequence[tuple[float, float]] = (),
    interval: float | None = None,
) -> tuple[Split, ...]:
    """Return what is held out in turn: runs, thermal cycles, or the later part of a run.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Runs of one machine.  Several are left out one by one.  A single one is cut into its
        thermal cycles, where the recorded spindle speed shows at least two that were measured;
        else its last part is predicted from what came before, twice.
    windows : sequence of (float, float)
        Stretches of a single run to hold out instead, first and last second.
    interval : float, optional
        Sampling interval of the models [s]; see `training_interval`.  A single run is averaged to
        it before it is cut: a sample half in and half out of a stretch would tell what is held
        out.

    Raises
    ------
    ThermalDataError
        If there is no run, one is there twice, or windows are given for several.
    """
    if not runs:
        raise ThermalDataError('runs: expected at least one run, but found none')
    if windows and len(runs) > 1:
        raise ThermalDataError(
            f'windows: expected one run to cut, but found {len(runs)}; several runs are held '
            'out one by one'
        )
    if len(runs) > 1:
        check_copies([Fingerprint.of(run) for run in runs])
        return tuple(
            Split(run.name, tuple(other for other in runs if other is not run), run)
            for run in runs
        )
    run = at_interval(runs[0], training_interval(runs, interval))
    if not windows:
        cycle, measured = thermal_cycles(run), np.isfinite(run.displacement).any(axis=1)
        rows = [np.flatnonzero(cycle == number) for number in np.unique(cycle[measured])]
        if len(rows) < 2:
            return _chained(run)
        windows = [(float(run.time[own[0]]), float(run.time[own[-1]])) for own in rows]
    return tuple(_cut(run, start, stop) for start, stop in windows)


def judge(
    split: Split,
    *,
    candidates: Sequence[str] | None = None,
    contenders: Mapping[str, Contender] = CONTENDERS,
    interval: float | None = None,
    sensors: str = 'auto',
    n_clusters: int = 5,
    spindle_speed: bool = True,
    random_state: int = 0,
    progress: Progress | None = None,
) -> HeldOut:
    """Train on one part and judge on the other.

    Parameters
    ----------
    split : Split
        What to train on and what to judge on.
    candidates : sequence of str
        Candidates to fit, all of `contenders` if absent.  The automatic choice is made among those
        that training considers by itself; the others are for comparison.
    contenders : mapping of str to Contender
        What the names mean, in the order of tables.
    interval, sensors, n_clusters, spindle_speed, random_state, progress
        As in `train_model`.

    Raises
    ------
    ThermalDataError
        If the runs cannot be used.
    """
    candidates = tuple(contenders) if candidates is None else candidates
    model = train_model(
        split.training,
        candidates=[name for name in STANDARD if name in candidates] or candidates,
        compared=candidates,
        contenders=contenders,
        interval=interval,
        sensors=sensors,
        n_clusters=n_clusters,
        spindle_speed=spindle_speed,
        random_state=random_state,
        progress=progress,
    )
    evaluation = evaluate(model, split.held_out, start=split.start, stop=split.stop)
    problems = {
        name: '; '.join(item.problems) for name, item in model.candidates.items() if item.problems
    }
    return HeldOut(
        evaluation=replace(evaluation, run=split.name),
        inputs=model.inputs,
        refused={**model.omitted, **problems},
    )


def _cut(run: ThermalRun, start: float, stop: float) -> Split:
    """Hold a stretch of a run out."""
    inside = run.inside(start, stop)
    if not inside.any() or inside.all():
        raise ThermalDataError(
            f'run {run.name!r}: expected a part of {run.time[0]:.6g} to {run.time[-1]:.6g} s to '
            f'hold out, but found {start:.6g} to {stop:.6g} s'
        )
    return Split(
        f'{run.name} {start:.0f}-{stop:.0f} s',
        (hidden(run, inside),),
        run,
        start,
        stop,
    )


def _chained(run: ThermalRun) -> tuple[Split, ...]:
    counted = run.time[np.isfinite(run.displacement).any(axis=1)]
    if not len(counted):
        raise ThermalDataError(
            f'run {run.name!r}: expected measured displacements, but found none'
        )
    span = counted[-1] - counted[0]
    cuts = [float(counted[0] + share * span) for share in CHAIN]
    chained = []
    for first, last in pairwise(cuts):
        start = float(run.time[run.time > first][0])
        name = f'{run.name} {start:.0f}-{last:.0f} s'
        chained.append(Split(name, (run.window(stop=first),), run, start, last))
    return tuple(chained)

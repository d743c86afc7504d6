# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Pre-compensation of a path on a soft sheet, so that the relaxed sheet shows the nominal one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.deformation.features import FOLD_FROM, half_turns, opposite_sign
from fuzzycnc_ros.core.deformation.stitch_path import ARC, LINE, SheetMaterial, StitchPath


class StepFlag(IntFlag):
    """Reasons why a step was not compensated in full; 0 if it was."""

    OUTSIDE_DOMAIN = 1
    """The gate refused its process values."""
    RIGHT_TURN = 2
    """An arc that turns right, which the models were not trained on."""
    ZERO_LENGTH = 4
    """The point was given twice; nothing was added."""
    RATE_LIMITED = 8
    """The model's output was cut at its largest rate."""
    OFFSET_LIMITED = 16
    """The offset was cut at its largest length."""
    PROGRESS_LIMITED = 32
    """The offset was held back so that the tool goes on along the path."""
    CLIPPED = 64
    """The offset was cut at the edge of the area."""
    NO_PROGRESS = 128
    """At the edge of the area the tool goes on by less than the least progress."""


def limit_offsets(
    nominal: Array,
    wanted: ArrayLike,
    *,
    offset_max: float = 15e-3,
    progress_min: float = 0.2,
    size: tuple[float, float] | None = None,
) -> tuple[Array, NDArray[np.int64]]:
    """Return offsets within their limits.

    Parameters
    ----------
    nominal : ndarray, shape (n + 1, 2)
        Nominal points [m].
    wanted : array_like, shape (n + 1, 2)
        Offsets [m].
    offset_max : float
        Largest length of an offset [m].
    progress_min : float
        Least progress of a commanded step along its nominal direction, as a share of the
        nominal step [-]; an offset that would take more is held back towards the last one.
    size : tuple of float, optional
        Clamped area from the origin [m]; commanded points are cut at its edge.  This comes
        last: at the edge a step may make less progress, which its flag then says.

    Returns
    -------
    offset : ndarray, shape (n + 1, 2)
        Offsets [m].
    flag : ndarray of int, shape (n,)
        Limits that were at work on each step, `StepFlag`.
    """
    target = np.array(wanted, float)
    reach = np.hypot(*target.T)
    over = reach > offset_max
    target[over] *= (offset_max / reach[over])[:, None]
    flag = np.where(over[1:], StepFlag.OFFSET_LIMITED, 0).astype(np.int64)
    offset = target.copy()
    if size is not None:
        offset[0] = np.clip(nominal[0] + target[0], 0.0, size) - nominal[0]
    feed = np.diff(nominal, axis=0)
    square = (feed * feed).sum(axis=1)
    for n, step in enumerate(feed):
        if square[n] == 0.0:
            offset[n + 1] = offset[n]
            continue
        change = target[n + 1] - offset[n]
        gained = portable.matmul(change, step) / square[n]  # as a share of the nominal step
        if gained < progress_min - 1.0:
            flag[n] |= StepFlag.PROGRESS_LIMITED
            change = change * ((progress_min - 1.0) / gained)
        offset[n + 1] = offset[n] + change
        if size is None:
            continue
        point = nominal[n + 1] + offset[n + 1]
        inside = np.clip(point, 0.0, size)
        if (inside == point).all():
            continue
        flag[n] |= StepFlag.CLIPPED
        offset[n + 1] = inside - nominal[n + 1]
        if (
            portable.matmul(offset[n + 1] - offset[n], step) / square[n]
            < progress_min - 1.0 - 1e-9
        ):
            flag[n] |= StepFlag.NO_PROGRESS
    return offset, flag


REFERENCE_LENGTH = 50e-3
"""Feed that a model's output is meant for [m]: it gives millimetres per 50 mm."""

SAMPLE_LENGTH = {ARC: 30e-3, LINE: REFERENCE_LENGTH}
"""Lengths of the samples behind a model, by kind [m]."""

_MM = 1e-3


@dataclass(frozen=True, kw_only=True)
class CompensationConfig(Config):
    """Settings that turn outputs of a model into offsets of a path."""

    accumulate: str = param(
        'leaky', '-', 'How offsets add up along the path', choices=('leaky', 'ramp')
    )
    leak_length: float = param(
        60e-3, 'm', 'Way over which an offset fades, leaky only', low=1e-3, high=1e3
    )
    prompt_length: float = param(
        1e-3, 'm', 'Way whose drift the sheet gives way at once, leaky only', low=0.0, high=0.1
    )
    initial_rate: bool = param(
        True, '-', 'Raise the average over a sample to the rate at its start, leaky only'
    )
    passes: int = param(1, '-', 'How often the compensated path is put in again', low=1, high=5)
    rate_max: float = param(
        0.15, '-', 'Largest output of the model per feed and axis', low=1e-3, high=0.5
    )
    offset_max: float = param(15e-3, 'm', 'Largest offset', low=1e-5, high=0.1)
    progress_min: float = param(
        0.2, '-', 'Least progress of a step along its nominal direction', low=0.0, high=0.9
    )


class DomainGate(Protocol):
    """Domain of a model: tells known process values from others; rows as `feature_rows` gives."""

    def accepts(self, x: Array) -> NDArray[np.bool_]:
        """Return for each row whether the model may be asked, shape (steps,)."""

    def clip(self, x: Array) -> Array:
        """Return the rows cut at the box of the training samples, shape (steps, 5)."""


@dataclass(frozen=True, eq=False)
class OffsetPath:
    """A nominal path and the offsets that were added to it.

    Attributes
    ----------
    nominal : ndarray, shape (n + 1, 2)
        Points as given [m].
    offset : ndarray, shape (n + 1, 2)
        Offsets of the points [m].
    compensation : ndarray, shape (n, 2)
        Output of the model for each step of the last pass, limited, in the step's direction
        [mm per 50 mm]; 0 where it was not asked.
    support : ndarray, shape (n,)
        Logarithm of the support by the model's rules in pass 1; NaN where it was not asked.
    flag : ndarray of int, shape (n,)
        `StepFlag` of each step.
    """

    nominal: Array
    offset: Array
    compensation: Array
    support: Array
    flag: NDArray[np.int64]

    @classmethod
    def unchanged(cls, points: ArrayLike) -> OffsetPath:
        """Return a path of points, shape (n + 1, 2) [m], without offsets."""
        nominal = np.array(points, float)
        steps = len(nominal) - 1
        return cls(
            nominal,
            np.zeros_like(nominal),
            np.zeros((steps, 2)),
            np.full(steps, np.nan),
            np.zeros(steps, np.int64),
        )

    @property
    def commanded(self) -> Array:
        """Points to be commanded [m], shape (n + 1, 2)."""
        return np.asarray(self.nominal + self.offset)

    @property
    def refused(self) -> NDArray[np.bool_]:
        """Steps that the model was not asked for, shape (n,)."""
        return np.asarray(self.flag & (StepFlag.OUTSIDE_DOMAIN | StepFlag.RIGHT_TURN) != 0)


def compensate_path(
    path: StitchPath,
    material: SheetMaterial,
    predict: Callable[[Array], Array],
    *,
    config: CompensationConfig | None = None,
    gate: DomainGate | None = None,
    support: Callable[[Array], Array] | None = None,
) -> OffsetPath:
    """Shift a path so that the relaxed sheet shows the nominal one.

    Along the path off' = off exp(-length / leak_length) + s length / 50 mm, without the fading
    for `accumulate='ramp'`, and in the leaky case the share that the sheet gives way at once,
    s prompt_length / 50 mm, on top.

    Parameters
    ----------
    path : StitchPath
        Nominal stitches.
    material : SheetMaterial
        The sheet.  Where it has a size the tool is kept on it.
    predict : callable
        Model: rows of `feature_rows` to compensations, shape (steps, 2) [mm per 50 mm].
    config : CompensationConfig, optional
        Settings; the defaults if left out.
    gate : DomainGate, optional
        Judge of the nominal values.  Steps it refuses are given no compensation; offsets from
        before are taken back by `rate_max` of the feed.  Later passes cut their values at its
        box and judge no more.
    support : callable, optional
        Rows to the logarithm of their support, shape (steps,).

    Returns
    -------
    OffsetPath
        Offsets with their limits kept, flags and support.

    Raises
    ------
    ValueError
        If the foot would go through the sheet, a nominal point lies off it, or the model's
        output is not finite or of another shape.

    Notes
    -----
    A model's output is the average over a whole sample, while the drift fades along it: with
    `initial_rate` it is multiplied by what the same sums give for a fading drift (1.35 for a
    line of 50 mm, fading over 60 mm).  On five tracks of the simulated sheet, with exact outputs,
    this and `prompt_length` lower the spread across the sides from 0.22 to 0.35 mm (fading over
    80 mm as it stands) to 0.11 to 0.19 mm.  Both lengths follow from one recorded run, see
    `identify_relaxation`.
    """
    config = CompensationConfig() if config is None else config
    material.check(path)
    lengths = path.lengths
    live = lengths > 0.0
    flag = np.where(live, 0, StepFlag.ZERO_LENGTH).astype(np.int64)
    flag[live & (path.kind == ARC) & (path.turn < 0)] |= StepFlag.RIGHT_TURN
    x, sign = feature_rows(path, material)
    evidence = np.full(len(lengths), np.nan)
    if support is not None:
        evidence[live] = support(x[live])
    if gate is not None:
        refused = np.zeros(len(lengths), bool)
        refused[live] = ~gate.accepts(x[live])
        flag[refused] |= StepFlag.OUTSIDE_DOMAIN
    asked = flag == 0
    factor = _initial_rate_factor(path, config)
    offset, verdict = np.zeros_like(path.points), flag
    for number in range(config.passes):
        moved = path.moved(offset)
        if number:
            x, sign = feature_rows(moved, material, moved.lengths)
            x = x if gate is None else gate.clip(x)
        s = np.zeros((len(lengths), 2))
        if asked.any():
            s[asked] = sign[asked, None] * _checked(predict(x[asked]), int(asked.sum()))
        largest = config.rate_max * REFERENCE_LENGTH / _MM
        limited = np.clip(s, -largest, largest)
        verdict = flag | np.where((limited != s).any(axis=1), StepFlag.RATE_LIMITED, 0)
        rate = limited * factor[:, None] * _MM / REFERENCE_LENGTH
        wanted = _accumulated(rate, moved.lengths * live, ~asked & live, config)
        offset, limits = limit_offsets(
            path.points,
            wanted,
            offset_max=config.offset_max,
            progress_min=config.progress_min,
            size=material.size,
        )
        verdict = verdict | limits
    return OffsetPath(path.points, offset, limited, evidence, verdict)


def feature_rows(
    path: StitchPath, material: SheetMaterial, step: ArrayLike | None = None
) -> tuple[Array, Array]:
    """Return the process values of the steps in the units of the paper.

    Parameters
    ----------
    path : StitchPath
        Stitches.
    material : SheetMaterial
        The sheet.
    step : array_like, shape () or (n,), optional
        Stitch step to be told to the model [m]; the nominal one if left out.

    Returns
    -------
    x : ndarray, shape (n, 5)
        Direction [deg], folded as `half_turns` says, feed depth [mm], type (1 arc, 2 line),
        stitch step [mm], thickness [mm].
    sign : ndarray, shape (n,)
        -1 where the step goes in the opposite direction, whose drag is the negative; else 1.

    Notes
    -----
    Folding at 0 deg would turn -2 deg into 178 deg with the wrong sign.
    """
    feed = np.diff(path.points, axis=0)
    direction = portable.arctan2(feed[:, 1], feed[:, 0])
    turns = half_turns(np.degrees(direction), FOLD_FROM)
    told = path.step if step is None else np.broadcast_to(step, len(feed))
    x = np.column_stack(
        [
            np.degrees(direction - np.pi * turns),
            path.depth / _MM,
            path.kind,
            told / _MM,
            np.full(len(feed), material.thickness / _MM),
        ]
    )
    return x, opposite_sign(turns)


def _checked(output: ArrayLike, count: int) -> Array:
    found = np.asarray(output, float)
    if found.shape != (count, 2):
        raise ValueError(
            f'predict: expected compensations of shape {(count, 2)} but found {found.shape}'
        )
    if not np.isfinite(found).all():
        raise ValueError('predict: expected finite compensations but found some that are not')
    return found


def _initial_rate_factor(path: StitchPath, config: CompensationConfig) -> Array:
    """Return by how much the rate at the start of a sample exceeds its average, shape (n,)."""
    factor = np.ones(len(path.lengths))
    if config.accumulate == 'ramp' or not config.initial_rate:
        return factor
    for kind, step in {*zip(path.kind.tolist(), path.step.tolist(), strict=True)}:
        of_kind = (path.kind == kind) & (path.step == step)
        factor[of_kind] = initial_rate_factor(
            SAMPLE_LENGTH[int(kind)], step, config.leak_length, config.prompt_length
        )
    return factor


def initial_rate_factor(
    sample_length: float, step: float, leak_length: float, prompt_length: float = 0.0
) -> float:
    """Return the rate at the start of a sample over its least-squares slope.

    Parameters
    ----------
    sample_length : float
        Length of the sample [m].
    step : float
        Nominal stitch step [m].
    leak_length : float
        Way over which the drift fades [m].
    prompt_length : float
        Way whose drift the sheet gives way at once [m].

    Examples
    --------
    >>> round(initial_rate_factor(50e-3, 3e-3, 60e-3), 4)
    1.3502
    """
    count = max(round(sample_length / step), 1)
    way = np.arange(1, count + 1) * (sample_length / count)
    drift = leak_length * -portable.expm1(-way / leak_length) + prompt_length
    return float(portable.matmul(way, way) / portable.matmul(way, drift))


def _accumulated(
    rate: Array, lengths: Array, refused: NDArray[np.bool_], config: CompensationConfig
) -> Array:
    """Return the offsets that the rates add up to, before any limit, shape (n + 1, 2) [m]."""
    leaky = config.accumulate == 'leaky'
    total = np.zeros(2)
    course = [total]
    for step_rate, length, none in zip(rate, lengths, refused, strict=True):
        if leaky:
            total = total * portable.exp(-length / config.leak_length)
        if none:  # taken back, and by no more than a step may add
            back = config.rate_max * length
            total = np.sign(total) * np.maximum(np.abs(total) - back, 0.0)
        else:
            total = total + step_rate * length
        course.append(total)
    wanted = np.array(course)
    if leaky:
        wanted[1:] += config.prompt_length * rate
    return wanted


LEARNING_GAIN = 0.7
"""Share of the deviation that one cycle takes away [-]."""


def learn_offsets(
    path: OffsetPath,
    stitched: ArrayLike,
    *,
    gain: float = LEARNING_GAIN,
    config: CompensationConfig | None = None,
    size: tuple[float, float] | None = None,
) -> OffsetPath:
    """Return the path of the next cycle: off + gain (nominal - stitched).

    Parameters
    ----------
    path : OffsetPath
        Path that was commanded; `OffsetPath.unchanged` in the first cycle, or what a model
        made of it.
    stitched : array_like, shape (n + 1, 2) or (runs, n + 1, 2)
        Stitched points of one recorded run of that path, or of several, whose mean counts [m].
    gain : float
        Share of the deviation to be taken away [-]; more than 0, at most 1.
    config : CompensationConfig, optional
        Whose `offset_max` and `progress_min` the offsets keep; the defaults if left out.
    size : tuple of float, optional
        Clamped area from the origin, on which the tool is kept [m].

    Returns
    -------
    OffsetPath
        With new offsets and the flags of their limits; compensation and support as they were.

    Raises
    ------
    ValueError
        If a run is not finite or not parallel to the path, or the gain out of its range.

    Notes
    -----
    A refused step may be learnt: its offset comes from a run and no model.

    Examples
    --------
    Three cycles on the test track, a recorded run each:

    >>> from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
    >>> from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack
    >>> track, rng = FoamTrack.parallelogram(np.pi / 4), np.random.default_rng(0)
    >>> path, errors = OffsetPath.unchanged(track.points), []
    >>> for cycle in range(4):
    ...     sheet = FoamSheet(15e-3, (0.15, 0.1)).scattered(rng)
    ...     stitched = sheet.stitch(path.commanded, 6e-3, rng=rng)
    ...     errors.append(float(np.degrees(track.measure(stitched).angle_error).round(2)))
    ...     path = learn_offsets(path, stitched)
    >>> errors  # [deg]
    [5.16, 1.77, 0.5, 0.09]
    """
    config = CompensationConfig() if config is None else config
    if not 0.0 < gain <= 1.0:
        raise ValueError(f'gain: expected more than 0 and at most 1 but found {gain}')
    runs = np.asarray(stitched, float)
    runs = runs[np.newaxis] if runs.ndim == 2 else runs
    if runs.ndim != 3 or runs.shape[1:] != path.nominal.shape or not len(runs):
        raise ValueError(
            f'stitched: expected runs of the same track, shape {path.nominal.shape} each, but '
            f'found shape {np.shape(stitched)}; learn each track from its own recordings'
        )
    if not np.isfinite(runs).all():
        raise ValueError(
            'stitched: expected finite coordinates [m] but found some that are not; leave runs '
            'with lost stitches out'
        )
    wanted = path.offset + gain * (path.nominal - runs.mean(axis=0))
    offset, flag = limit_offsets(
        path.nominal,
        wanted,
        offset_max=config.offset_max,
        progress_min=config.progress_min,
        size=size,
    )
    return replace(path, offset=offset, flag=flag)

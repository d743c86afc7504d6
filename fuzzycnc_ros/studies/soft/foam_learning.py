# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from recorded runs: offsets of one track, and gains of a model for another sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.believed_deviation import (
    BelievedDeviation,
    believed_deviation,
)
from fuzzycnc_ros.core.deformation.compensation import OffsetPath, learn_offsets
from fuzzycnc_ros.core.deformation.model import GAIN_MAX, GAIN_MIN, DeformationModel
from fuzzycnc_ros.core.deformation.offset_file import SAME_POINT, StitchOffsets
from fuzzycnc_ros.core.deformation.samples import RecordedPath
from fuzzycnc_ros.core.names import first_names
from fuzzycnc_ros.studies.soft.foam_records import NAMED, Samples


@dataclass(frozen=True, eq=False)
class Learnt:
    """Offsets of the next cycle, and what the recorded one left.

    Attributes
    ----------
    offsets : StitchOffsets
        The offsets.
    runs : int
        Runs that they were learnt from.
    rms_deviation, max_deviation : float
        Distance of the stitches, means of the runs, from their places [m].
    limited : int
        Steps at which a limit was at work on the new offsets.
    believed : BelievedDeviation
        What of the deviation will come again.
    outliers : tuple of str
        Stitches that were left out.
    """

    offsets: StitchOffsets
    runs: int
    rms_deviation: float
    max_deviation: float
    limited: int
    believed: BelievedDeviation
    outliers: tuple[str, ...]

    @property
    def largest(self) -> float:
        """Largest offset [m]."""
        return float(np.hypot(*self.offsets.offset.T).max())

    def lines(self) -> list[str]:
        """Return it in words."""
        lines = [
            f'{self.runs} run{"s" if self.runs > 1 else ""} of {len(self.offsets.nominal):,} '
            f'points: deviation {1e3 * self.rms_deviation:.3f} mm rms, '
            f'{1e3 * self.max_deviation:.3f} mm at most; largest new offset '
            f'{1e3 * self.largest:.3f} mm'
        ]
        lines += self.doubts()
        if self.believed.corrects and self.believed.reach:
            lines.append(
                f'smoothed over {self.believed.reach} stitches to either side, which leaves '
                f'{1e3 * self.believed.error:.3f} mm of held-out ones instead of '
                f'{1e3 * self.believed.error_none:.3f} mm'
            )
        return lines

    def doubts(self) -> list[str]:
        """Return what of it may surprise."""
        lines = []
        error, none = 1e3 * self.believed.error, 1e3 * self.believed.error_none
        if self.outliers:
            lines.append(
                f'left out: {len(self.outliers)} stitches that lie far off their neighbours: '
                f'{first_names(self.outliers, NAMED)}'
            )
        if not self.believed.corrects:
            lines.append(
                'no correction: held-out stitches show no deformation beyond chance '
                f'({error:.3f} mm off with one, {none:.3f} mm without); the offsets stay as they '
                'were'
            )
        if self.limited:
            lines.append(f'note: {self.limited} steps are limited; the track is not learnt there')
        return lines

    def document(self) -> dict[str, Any]:
        """Return it in SI."""
        return {
            'path_id': self.offsets.path_id,
            'material': self.offsets.material,
            'runs': self.runs,
            'rms_deviation': self.rms_deviation,
            'max_deviation': self.max_deviation,
            'largest_offset': self.largest,
            'limited': self.limited,
            'corrects': self.believed.corrects,
            'smoothed_over': self.believed.reach,
            'held_out_error': self.believed.error,
            'held_out_error_without': self.believed.error_none,
            'outliers': self.outliers,
        }


def learn_track(paths: Sequence[RecordedPath], path_id: str | None, gain: float) -> Learnt:
    """Return the offsets of the next cycle of one track.

    Only the deviation that will come again is taken away, see `believed_deviation`.

    Parameters
    ----------
    paths : sequence of RecordedPath
        Recorded runs, at least one.
    path_id : str, optional
        Name of the track; needed where there are several.
    gain : float
        Share of the deviation to be taken away [-].

    Raises
    ------
    ValueError
        If there is no such track, it does not lie on the sheet, or the runs are not of one cycle
        of one track on one material, or one is there twice.
    """
    known = sorted({path.path_id for path in paths})
    if path_id is not None and path_id not in known:
        raise ValueError(
            f'path: expected one of the stitched paths {", ".join(known)} but found {path_id!r}'
        )
    if path_id is None and len(known) > 1:
        raise ValueError(
            f'{_other(paths).source}: expected runs of one track but found '
            f'{", ".join(known)}; choose one path'
        )
    runs = [path for path in paths if path_id is None or path.path_id == path_id]
    first = runs[0]
    sheet = first.material
    try:
        sheet.check_points(first.nominal, SAME_POINT)
    except ValueError as error:
        raise ValueError(f'{first.source}: {error}') from error
    track = StitchOffsets(first.path_id, sheet.name, first.nominal, first.offset, sheet.thickness)
    for run in runs[1:]:
        _check_same(track, first, run)
    _check_copies(runs)
    stitched = np.stack([run.stitched for run in runs])
    believed = believed_deviation(first.nominal, stitched, first.primitive)
    offset, limited = first.offset, 0
    if believed.corrects:
        places = first.nominal - believed.deviation
        parts = [
            learn_offsets(
                replace(OffsetPath.unchanged(first.nominal[run]), offset=first.offset[run]),
                places[run], gain=gain, size=sheet.size,
            )
            for run in first.run_points
        ]  # fmt: skip
        offset = np.concatenate([part.offset for part in parts])
        limited = sum(int((part.flag != 0).sum()) for part in parts)
    deviation = np.hypot(*(stitched.mean(axis=0) - first.nominal).T)
    return Learnt(
        replace(track, offset=offset),
        len(runs),
        float(np.sqrt(np.mean(deviation**2))),
        float(deviation.max()),
        limited,
        believed,
        tuple(
            f'{runs[run].source}: stitch {point + 1}'
            for run, point in np.argwhere(believed.outlier).tolist()
        ),
    )


def _check_same(track: StitchOffsets, first: RecordedPath, run: RecordedPath) -> None:
    """Refuse a run that does not belong to the first one."""
    sheet = run.material
    reason = track.mismatch(run.path_id, sheet.name, sheet.thickness, run.nominal)
    if not reason and np.abs(first.depth - run.depth).max() > SAME_POINT:
        low, high = 1e3 * first.depth.max(), 1e3 * run.depth.max()
        reason = f'a feed depth of {low:g} mm, not of {high:g} mm'
    if reason:
        raise ValueError(
            f'{run.source}: expected a run like {first.source} but that has {reason}; learn each '
            'track on each material by itself'
        )
    apart = float(np.abs(run.offset - first.offset).max())
    if apart > SAME_POINT:
        raise ValueError(
            f'{run.source}: expected the offsets of {first.source} but found others by up to '
            f'{1e3 * apart:.3f} mm; give the runs of the last cycle alone'
        )


def _check_copies(runs: Sequence[RecordedPath]) -> None:
    """Refuse a run that is there twice: its noise would look like what comes again."""
    for first, second in combinations(runs, 2):
        if np.array_equal(first.stitched, second.stitched):
            raise ValueError(
                f'{second.source}: expected another run than {first.source} but found the same '
                'stitches; give each run once'
            )


def _other(paths: Sequence[RecordedPath]) -> RecordedPath:
    """Return the first run of another track than the first."""
    return next(path for path in paths if path.path_id != paths[0].path_id)


TURN_MAX = 10.0
"""Largest angle of a sample beside the directions of a model that is fitted to it [deg]."""


@dataclass(frozen=True, eq=False)
class GainFit:
    """A model with gains that were fitted to samples.

    Attributes
    ----------
    model : DeformationModel
        The model with its new gains.
    before : ndarray, shape (2,)
        Gains of X and Y that it had.
    samples, left_out : int
        Samples it was fitted to, and those that the model is not for.
    error_before, error : float
        Root mean square on these samples [mm per 50 mm].
    """

    model: DeformationModel
    before: Array
    samples: int
    left_out: int
    error_before: float
    error: float

    @property
    def gain(self) -> Array:
        """Gains of X and Y [-], shape (2,)."""
        return self.model.gain.value

    def lines(self) -> tuple[str, ...]:
        """Return what is to be said of it."""
        left = f'left out: {self.left_out} samples that the model is not for'
        return (
            *((left,) if self.left_out else ()),
            *(
                f'gain of {axis}: {first:.3f} -> {last:.3f}'
                + (', at its limit: train the model anew' if last in (GAIN_MIN, GAIN_MAX) else '')
                for axis, first, last in zip('XY', self.before, self.gain, strict=True)
            ),
            f'error on these {self.samples} samples: {self.error_before:.3f} -> {self.error:.3f} '
            'mm per 50 mm of feed; judge it on another run',
        )


def fit_gains(model: DeformationModel, samples: Samples) -> GainFit:
    """Fit the gains of a model to samples of a run.

    Raises
    ------
    ValueError
        If the model holds no correction, or is for none of the samples.
    """
    if not model.corrects:
        raise ValueError(
            'expected a model with gains to fit but found one that holds no correction; train it '
            'anew'
        )
    # The foot of a compensated side goes a few degrees beside the direction of the pattern.  It
    # is cut in its half of the full turn, so that the sign of its compensation stays.
    cut = model.clip(samples.x)
    turned = np.abs(cut[:, 0] - samples.x[:, 0]) <= TURN_MAX
    known = turned & np.isclose(cut[:, 1:], samples.x[:, 1:]).all(axis=1) & model.accepts(cut)
    if not known.any():
        raise ValueError(
            f'expected samples that the model is for but found none among {len(known)}; train it '
            'on such samples'
        )
    x, s = cut[known], samples.s[known]
    adapted = model.adapted(x, s)
    return GainFit(
        adapted,
        model.gain.value,
        int(known.sum()),
        int((~known).sum()),
        *(_rms(item.predict(x) - s) for item in (model, adapted)),
    )


def _rms(error: Array) -> float:
    return float((error**2).mean() ** 0.5)

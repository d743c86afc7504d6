# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Offsets of one track, learnt from its recorded runs, as JSON documents."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import TRACK_OFFSETS, Node, parse_document

VERSION = 1
"""Version of the layout."""

OFFSETS_SIZE_MAX = 64 * 1024 * 1024
"""Largest document that is read [characters]; a stitch takes about 80."""

SHEET_MAX = 100.0
"""Largest coordinate, and largest offset, of a stitch [m]: no sheet is larger."""

SAME_POINT = 1.5e-6
"""Nominal points, and thicknesses, that differ by no more are the same [m]: a commanded point and
its offset, both rounded to 1 µm along X and Y, are off by 1.4 µm."""


@dataclass(frozen=True, eq=False)
class StitchOffsets:
    """Offsets of one track on one material.

    Parameters
    ----------
    path_id : str
        Name of the pattern.
    material : str
        Name of the material.
    nominal : ndarray, shape (n + 1, 2)
        Nominal points that the offsets are for [m].
    offset : ndarray, shape (n + 1, 2)
        Offsets to be added [m].
    thickness : float, optional
        Thickness of the sheet [m]; files of earlier versions do not have it.
    """

    path_id: str
    material: str
    nominal: Array
    offset: Array
    thickness: float | None = None

    def mismatch(self, path_id: str, material: str, thickness: float, nominal: Array) -> str:
        """Return why the offsets are not for a track, or nothing if they are.

        Parameters
        ----------
        path_id, material : str
            Name of the pattern and of its material.
        thickness : float
            Thickness of the sheet [m].
        nominal : ndarray, shape (k + 1, 2)
            Nominal points of the track [m].
        """
        if path_id != self.path_id:
            return f'offsets of the pattern {self.path_id!r}, not of {path_id!r}'
        if material != self.material:
            return f'offsets for the material {self.material!r}, not for {material!r}'
        return self.other_sheet(thickness) or self.other_points(nominal)

    def other_sheet(self, thickness: float) -> str:
        """Return how the thickness of a sheet [m] differs; nothing if it does not."""
        if self.thickness is None or abs(thickness - self.thickness) <= SAME_POINT:
            return ''
        return f'offsets for a sheet of {1e3 * self.thickness:g} mm, not of {1e3 * thickness:g} mm'

    def of_runs(self, runs: Sequence[Array]) -> list[StitchOffsets] | None:
        """Return the offsets of each run of a design, None if they are not for all of them.

        Parameters
        ----------
        runs : sequence of ndarray, shape (k, 2)
            Nominal points of the runs in their order [m].
        """
        if self.other_points(np.concatenate([np.empty((0, 2)), *runs])):
            return None
        ends = np.cumsum([len(run) for run in runs])[:-1]
        return [
            replace(self, nominal=nominal, offset=offset)
            for nominal, offset in zip(
                np.split(self.nominal, ends), np.split(self.offset, ends), strict=True
            )
        ]

    def other_points(self, nominal: Array) -> str:
        """Return how nominal points, shape (k + 1, 2) [m], differ; nothing if they do not."""
        if nominal.shape != self.nominal.shape:
            return f'offsets of {len(self.nominal)} points, not of {len(nominal)}'
        apart = np.hypot(*(nominal - self.nominal).T)
        if not (apart <= SAME_POINT).all():
            at = int(np.nanargmax(apart)) if np.isfinite(apart).any() else 0
            moved = np.ptp(nominal - self.nominal, axis=0).max() <= SAME_POINT
            return (
                f'offsets of other points: number {at} lies {1e6 * apart[at]:.0f} µm from '
                f'the one they were learnt at{", as all do" if moved else ""}'
            )
        return ''


def write_offsets(offsets: StitchOffsets) -> str:
    """Return offsets as a JSON document; equal offsets give equal text."""
    document = {
        'format': TRACK_OFFSETS,
        'version': VERSION,
        'path_id': offsets.path_id,
        'material': offsets.material,
        **({} if offsets.thickness is None else {'thickness': offsets.thickness}),
        'nominal': offsets.nominal.tolist(),
        'offset': offsets.offset.tolist(),
    }
    return json.dumps(document, allow_nan=False) + '\n'


def read_offsets(text: str) -> StitchOffsets:
    """Return the offsets that `write_offsets` wrote.

    Raises
    ------
    ModelFileError
        If the text is too large, no JSON, of another format or version, or holds points that are
        not finite or not parallel.
    """
    return offsets_of(parse_document(text, 'offsets file', OFFSETS_SIZE_MAX))


def offsets_of(root: Node) -> StitchOffsets:
    """Return the offsets of a parsed document; errors as `read_offsets`."""
    root.check_kind('format', TRACK_OFFSETS)
    version = root.get('version')
    if type(version.value) is not int or version.value != VERSION:
        version.refuse(f'version {VERSION}; learn the offsets anew')
    path_id = root.get('path_id')
    if not path_id.text():
        path_id.refuse('the name of a pattern')
    nominal, offset = (
        root.get(name).matrix(2, -SHEET_MAX, SHEET_MAX) for name in ('nominal', 'offset')
    )
    if len(nominal) < 2:
        root.get('nominal').refuse('two points or more')
    if len(offset) != len(nominal):
        root.get('offset').refuse(f'as many as there are nominal points, {len(nominal)}')
    thickness = None
    if 'thickness' in root.items():
        thickness = root.get('thickness').number(SAME_POINT, SHEET_MAX)
    material = root.get('material').text()
    return StitchOffsets(path_id.text(), material, nominal, offset, thickness)

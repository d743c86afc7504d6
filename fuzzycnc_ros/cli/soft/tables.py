# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of a track from CSV files, for `fuzzycnc soft learn`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.cli.soft.compensate import sheet_size
from fuzzycnc_ros.core.deformation.samples import RecordedPath
from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial
from fuzzycnc_ros.core.units import LENGTHS
from fuzzycnc_ros.studies.number_table import read_numbers
from fuzzycnc_ros.studies.soft.foam_records import StitchRecordings, recorded_run

COMMANDED = ('x_mm', 'y_mm')
OFFSET = ('offset_x_mm', 'offset_y_mm')
STITCHED = ('stitched_x_mm', 'stitched_y_mm')
JUMP = 'jump'


@dataclass(frozen=True)
class TrackOptions:
    """Facts of a run that a CSV file does not have, as given on the command line."""

    path_id: str | None
    material: str | None
    thickness: str | None
    size: str | None

    def sheet(self) -> SheetMaterial:
        """Return the sheet.

        Raises
        ------
        ValueError
            If a name or length is missing or cannot be.
        """
        given = {
            '--path': self.path_id,
            '--material': self.material,
            '--thickness': self.thickness,
        }
        missing = [name for name, value in given.items() if not value]
        if missing:
            raise ValueError(
                f'{", ".join(missing)}: expected with a .csv, which does not hold it, but '
                'found none'
            )
        thickness = quantity('--thickness', str(self.thickness), LENGTHS, example='15mm')
        size = None if self.size is None else sheet_size(self.size)
        return SheetMaterial(thickness, size, str(self.material))


def read_tables(sources: Sequence[Path], options: TrackOptions) -> StitchRecordings | None:
    """Read runs from CSV files, one each; None if the sources are bags.

    Raises
    ------
    ValueError
        If bags and tables are mixed, options are missing or of no use, or a file is no such table;
        the message names file and line.
    """
    tables = [source for source in sources if source.suffix.lower() == '.csv']
    if not tables:
        given = {
            '--material': options.material,
            '--thickness': options.thickness,
            '--size': options.size,
        }
        for name, value in given.items():
            if value is not None:
                raise ValueError(f'{name}: expected with a .csv only, since a bag holds it')
        return None
    if len(tables) < len(sources):
        raise ValueError(f'{tables[0]}: expected bags, or .csv files, but found both')
    sheet = options.sheet()
    return StitchRecordings([_run(path, sheet, str(options.path_id)) for path in tables])


def _run(path: Path, sheet: SheetMaterial, path_id: str) -> RecordedPath:
    """Read a run; its commanded places include the offsets, as `soft compensate` writes them."""
    found = read_numbers(path, COMMANDED + STITCHED, optional=(*OFFSET, JUMP))
    known = [name for name in found.columns[4:] if name in OFFSET]
    if len(known) == 1:
        raise ValueError(f'{path}: line 1: expected both {" and ".join(OFFSET)} or neither')
    values = 1e-3 * found.values
    commanded, stitched = values[:, :2], values[:, 2:4]
    jump = np.zeros(len(values), bool)
    if JUMP in found.columns:
        jump = found.values[:, found.columns.index(JUMP)] != 0.0
    return recorded_run(
        commanded,
        stitched,
        values[:, 4:6] if known else np.zeros_like(commanded),
        path_id=path_id,
        material=sheet,
        source=str(path),
        places=[f'line {number}' for number in found.lines],
        jump=jump,
    )

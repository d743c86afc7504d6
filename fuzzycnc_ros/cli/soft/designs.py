# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Designs of stitching machines, for `fuzzycnc soft compensate`."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from fuzzycnc_ros.cli.soft.compensate import PathCompensator
from fuzzycnc_ros.core.deformation.stitch_design import PlacedRun, placed_design, run_path
from fuzzycnc_ros.files.atomic import whole_file
from fuzzycnc_ros.studies.soft.design_files import (
    bounds,
    check_written,
    read_design,
    stitch_lengths,
    write_design,
)


@dataclass(frozen=True)
class Sewing:
    """Sewing settings of a machine that a file does not have.

    Parameters
    ----------
    longest : float or None
        Longest stitch of the machine [m]; that of the format alone if None.
    shortest : float
        Stitches that offsets make shorter are merged [m].
    feed : float
        Feed of a part program [m/s].
    unit : float
        Unit of a drawing that does not say it [m].
    """

    longest: float | None
    shortest: float
    feed: float
    unit: float


def shift_design(path: Path, out: Path, job: PathCompensator, sewing: Sewing) -> list[str]:
    """Write a design with its stitches shifted, and return what is to be said.

    Raises
    ------
    ValueError
        If it cannot be read or written, or does not fit the sheet.
    """
    check_written(out)
    source = read_design(path, job.given_step, sewing.unit)
    design, runs = source.design, source.design.runs()
    offset, shift = np.zeros_like(design.points), np.zeros(2)
    low, high = bounds(design)
    if job.material.size is not None:
        shift = 0.5 * (np.array(job.material.size) - low - high)
    models = job.models([design.points[run] + shift for run in runs])
    for number, (run, model) in enumerate(zip(runs, models, strict=True), start=1):
        track = run_path(design.points[run] + shift, job.depth, job.given_step)
        if track is not None:
            offset[run] = job.compensated(track, [number] * len(track.lengths), model).offset
            offset[run[0]] = 0.0  # where the jump led, which stays
    job.check()
    longest = inf if sewing.longest is None else sewing.longest
    lengths = stitch_lengths(out.suffix.lower(), longest, sewing.shortest)
    placed = placed_design(design, offset, lengths)
    text = write_design(source, placed, out, sewing.feed)
    with whole_file(out) as file:
        file.write(text)
    job.runs += [PlacedRun(design.points[run], placed.points[run], offset[run]) for run in runs]
    merged = int(placed.merged.sum())
    job.counts |= {'runs': len(runs), 'split': placed.split, 'merged': merged}
    width, height = 1e3 * (high - low)
    lines = [
        f'{path.name}: {len(runs):,} run{"s" * (len(runs) != 1)} on {width:.1f} x {height:.1f} mm',
        *source.notes,
    ]
    if placed.split or merged:
        lines.append(f'{placed.split:,} stitches split, {merged:,} merged with the next')
    return lines

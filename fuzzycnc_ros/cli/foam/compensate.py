# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc foam compensate`: a part program or a list of points, shifted for a soft sheet."""

import csv
import io
import sys
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stdout
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.cli.console import JsonFile, check_folder, say, show, write_json
from fuzzycnc_ros.cli.options import PROGRAM_UNITS, OptionalText, choice, given
from fuzzycnc_ros.cli.programs.program_files import (
    STREAM,
    check_output,
    new_program,
    open_program,
    program_lines,
)
from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.core.units import LENGTHS
from fuzzycnc_ros.studies.number_table import table_cells

if TYPE_CHECKING:
    from fuzzycnc_ros.core.deformation.compensation import CompensatedPath
    from fuzzycnc_ros.core.deformation.soft_model import SoftModel
    from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath
    from fuzzycnc_ros.studies.page.table import Table

COLUMNS = ('x_mm', 'y_mm')
"""Columns of a list of points; `kind` (1 arc, 2 line) and `turn` (1 left, -1 right) may follow."""

ADDED = ('offset_x_mm', 'offset_y_mm', 'flag')
"""Columns that are added."""

SPACING = 0.2
"""What the spacing of points may be off the stitch step, as a share of it."""

ROWS = 20
"""Lines with refused or limited steps that are printed; the figures have all."""


@dataclass(frozen=True)
class LineFlags:
    """Refused or limited steps of a line.

    Attributes
    ----------
    line : int
        Number of the line.
    steps, refused, limited : int
        Its steps, and those of them that were not compensated, or by less than the model said.
    reasons : tuple of str
        Why.
    """

    line: int
    steps: int
    refused: int
    limited: int
    reasons: tuple[str, ...]


def compensate(
    path: Annotated[
        Path,
        typer.Argument(
            metavar='PATH',
            help='Part program (G-code; - is standard input), or .csv of stitches with the '
            'columns x_mm, y_mm and, if wanted, kind (1 arc, 2 line) and turn (1 left, -1 right).',
        ),
    ],
    model: Annotated[
        Path, typer.Option(metavar='MODEL', help='File of `foam train` or `foam learn`.')
    ],
    thickness: Annotated[
        str, typer.Option(metavar='LENGTH', help='Thickness of the sheet, such as 15mm.')
    ],
    depth: Annotated[str, typer.Option(metavar='LENGTH', help='Feed depth, such as 6mm.')],
    step: Annotated[str, typer.Option(metavar='LENGTH', help='Stitch step, such as 3mm.')],
    out: Annotated[
        Path, typer.Option(metavar='FILE', help='The compensated path; - is standard output.')
    ],
    size: Annotated[
        OptionalText,
        given(
            'Clamped area from the origin, such as 150x100mm; the tool is kept on it.',
            metavar='WIDTHxHEIGHT',
        ),
    ] = None,
    units: Annotated[
        str, choice('Unit before the program says G20 or G21.', PROGRAM_UNITS)
    ] = 'mm',
    in_place: Annotated[
        bool, typer.Option('--in-place', help='FILE may be the path itself.')
    ] = False,
    json_file: JsonFile = None,
) -> None:
    r"""Shift the stitches of a path, so that the relaxed sheet shows the path as it was meant.

    Moves with feed in X and Y are divided into stitches, a G1 each; a figure goes from one rapid
    to the next, and its first point stays where it is. All other lines stay as they are. Steps
    that the model was not trained for are not compensated, and listed by their lines, like those
    at which a limit was at work. A file of `foam learn` is for the figure that it was learnt on.

        fuzzycnc foam compensate quilt.ngc --model model.json --thickness 15mm --depth 6mm \
            --step 3mm --size 150x100mm --out quilt_compensated.ngc
        fuzzycnc foam compensate stitches.csv --model model.json --thickness 20mm --depth 8mm \
            --step 3mm --out stitches_compensated.csv
    """
    from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial

    lengths = [
        quantity(option, text, LENGTHS, example=example)
        for option, text, example in (
            ('--thickness', thickness, '15mm'), ('--depth', depth, '6mm'), ('--step', step, '3mm'),
        )
    ]  # fmt: skip
    if units not in PROGRAM_UNITS:
        raise ValueError(f'--units: expected mm or inch but found {units!r}')
    sheet = SheetMaterial(lengths[0], None if size is None else sheet_size(size))
    known = read_model_file(model)
    check_output(path, out, in_place)
    check_folder(json_file)
    table = path.suffix.lower() == '.csv'
    with program_lines(path) as source:
        job = Job(known, sheet, lengths[1], lengths[2])
        try:
            text = shifted_points(source, job) if table else shifted_program(source, units, job)
        except ValueError as error:
            raise ValueError(f'{path}: {error}') from error
        if job.elsewhere and job.refused == job.steps:
            raise ValueError(
                f'{path}: expected the stitches that {model} was learnt on but found '
                f'{job.elsewhere}; give the path that was stitched then, without its offsets'
            )
        with new_program(out) as new:
            new.write(text)
    with redirect_stdout(sys.stderr) if str(out) == STREAM else nullcontext():
        if job.flags:
            show(_flags_table(job.flags))
        say(
            f'{job.steps:,} stitches, {job.refused:,} of them not compensated, {job.limited:,} '
            f'limited; largest offset {1e3 * job.largest:.3f} mm'
        )
        if job.elsewhere:
            say(f'note: {model} is for one figure alone; for the others it has {job.elsewhere}')
        if not job.largest and not job.refused:
            say(f'note: {model} holds no correction; the path is as it was')
        if str(out) != STREAM:
            say(f'{out}: the compensated path')
    write_json(json_file, job.document())


class Job:
    """Compensates paths, and keeps what is to be said of them."""

    def __init__(
        self, model: 'SoftModel', material: 'SheetMaterial', depth: float, step: float
    ) -> None:
        self.model, self.material, self.depth, self.step = model, material, depth, step
        self.flags: list[LineFlags] = []
        self.steps = self.refused = self.limited = 0
        self.largest = 0.0
        self.elsewhere = ''  # why learnt offsets are not for a figure

    def compensated(self, path: 'StitchPath', lines: Sequence[int]) -> 'CompensatedPath':
        """Compensate a path whose steps are from certain lines."""
        import numpy as np

        from fuzzycnc_ros.core.deformation.compensation import CompensatedPath
        from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets
        from fuzzycnc_ros.core.deformation.soft_model import compensated

        if isinstance(self.model, StitchOffsets) and self.model.other_points(path.points):
            self.elsewhere = self.model.other_points(path.points)
            self.steps += len(path.lengths)
            self.refused += len(path.lengths)
            return CompensatedPath.unchanged(path.points)
        found = compensated(path, self.material, self.model)
        refused = found.refused
        limited = (found.flag != 0) & ~refused
        self.steps += len(refused)
        self.refused += int(refused.sum())
        self.limited += int(limited.sum())
        self.largest = max(self.largest, float(np.hypot(*found.offset.T).max()))
        places = np.asarray(lines)
        for line in dict.fromkeys(lines):
            of_line = places == line
            if not found.flag[of_line].any():
                continue
            self.flags.append(
                LineFlags(
                    line,
                    int(of_line.sum()),
                    int(refused[of_line].sum()),
                    int(limited[of_line].sum()),
                    _reasons(int(np.bitwise_or.reduce(found.flag[of_line]))),
                )
            )
        return found

    def document(self) -> dict[str, Any]:
        """Return the figures in SI."""
        return {
            'steps': self.steps,
            'refused': self.refused,
            'limited': self.limited,
            'largest_offset': self.largest,
            'lines': self.flags,
        }


def shifted_program(source: Path, units: str, job: Job) -> str:
    """Return a part program with its stitches shifted."""
    import numpy as np

    from fuzzycnc_ros.core.deformation.stitched_program import StitchedProgram

    with open_program(source) as file:
        program = StitchedProgram(file, job.step, units=units, size=job.material.size)
    offsets = []
    for figure in program.figures:
        lines = np.repeat(figure.lines, figure.steps).tolist()
        offsets.append(job.compensated(figure.path(job.depth, job.step), lines).offset)
    return ''.join(program.written(offsets))


def shifted_points(source: Path, job: Job) -> str:
    """Return a list of stitches, shifted."""
    import numpy as np

    from fuzzycnc_ros.core.deformation.stitch_path import LINE, StitchPath

    header, cells_of_line = table_cells(source, COLUMNS)
    taken = [name for name in ADDED if name in header]
    if taken:
        raise ValueError(
            f'line 1: expected no column {taken[0]}: is the path compensated already?'
        )
    for number, cells in cells_of_line.items():
        if len(cells) > len(header):
            raise ValueError(
                f'line {number}: expected {len(header)} cells, as in the header, but found '
                f'{len(cells)}'
            )
        cells += [''] * (len(header) - len(cells))
    numbers, rows = list(cells_of_line), list(cells_of_line.values())
    values = {
        name: _column(header, cells_of_line, name, default)
        for name, default in (('x_mm', 0.0), ('y_mm', 0.0), ('kind', float(LINE)), ('turn', 1.0))
    }
    points = 1e-3 * np.column_stack([values['x_mm'], values['y_mm']])
    if len(points) < 2:
        raise ValueError(f'expected two points or more but found {len(points)}')
    # What is said of a point is said of the step that leads to it.
    path = StitchPath(
        points, values['kind'][1:], depth=job.depth, step=job.step, turn=values['turn'][1:]
    )
    moving = path.lengths[path.lengths > 0.0]
    spacing = float(np.median(moving)) if len(moving) else 0.0
    if abs(spacing - job.step) > SPACING * job.step:
        raise ValueError(
            f'expected points that are stitches, {1e3 * job.step:g} mm apart, but found them '
            f'{1e3 * spacing:.3g} mm apart; give their spacing as --step'
        )
    found = job.compensated(path, numbers[1:])
    places = [header.index(name) for name in COLUMNS]
    flags = [0, *found.flag.tolist()]
    written = io.StringIO()
    writer = csv.writer(written, lineterminator='\n')
    writer.writerow([*header, *ADDED])
    for cells, place, offset, flag in zip(rows, found.commanded, found.offset, flags, strict=True):
        for column, value in zip(places, place, strict=True):
            cells[column] = f'{1e3 * value:.4f}'
        writer.writerow([*cells, *(f'{1e3 * value:.4f}' for value in offset), flag])
    return written.getvalue()


def _column(header: list[str], rows: dict[int, list[str]], name: str, default: float) -> Any:
    """Return the numbers of a column; a default where the file has none."""
    import numpy as np

    if name not in header:
        return np.full(len(rows), default)
    place, found = header.index(name), []
    for number, cells in rows.items():
        try:
            value = float(cells[place])
        except (IndexError, ValueError):
            value = float('nan')
        if not isfinite(value):
            raise ValueError(
                f'line {number}: {name}: expected a finite number but found {",".join(cells)!r}'
            )
        found.append(value)
    return np.array(found)


def sheet_size(text: str) -> tuple[float, float]:
    """Return lengths such as 150x100mm in m.

    Raises
    ------
    ValueError
        If they are none.
    """
    first, cross, last = text.lower().partition('x')
    try:
        if not cross:
            raise ValueError(text)
        height = quantity('--size', last, LENGTHS, example='100mm')
        unit = last.strip().lstrip('0123456789.+-e ')
        width = quantity('--size', f'{first}{unit}', LENGTHS, example='150mm')
    except ValueError as error:
        raise ValueError(
            f'--size: expected two lengths such as 150x100mm but found {text!r}'
        ) from error
    return width, height


def _reasons(flag: int) -> tuple[str, ...]:
    """Return what flags of steps say, in words."""
    from fuzzycnc_ros.core.deformation.compensation import StepFlag

    words = {
        StepFlag.OUTSIDE_DOMAIN: 'unlike the samples',
        StepFlag.RIGHT_TURN: 'arc to the right',
        StepFlag.ZERO_LENGTH: 'point given twice',
        StepFlag.RATE_LIMITED: 'output cut',
        StepFlag.OFFSET_LIMITED: 'offset cut',
        StepFlag.PROGRESS_LIMITED: 'held back',
        StepFlag.CLIPPED: 'edge of the sheet',
        StepFlag.NO_PROGRESS: 'no progress at the edge',
    }
    return tuple(text for bit, text in words.items() if flag & bit)


def _flags_table(flags: Sequence[LineFlags]) -> 'Table':
    """Return the lines with refused or limited steps."""
    from fuzzycnc_ros.studies.page.table import Column, Table

    columns = (
        Column('Line'), Column('steps'), Column('not compensated'), Column('limited'),
        Column('why', numeric=False),
    )  # fmt: skip
    rows = [
        (str(f.line), str(f.steps), str(f.refused), str(f.limited), ', '.join(f.reasons))
        for f in flags[:ROWS]
    ]
    if len(flags) > ROWS:
        rows.append(('...', '', '', '', f'{len(flags) - ROWS} more lines; --json has all'))
    return Table('Steps that were not compensated, or limited', columns, tuple(rows))


def read_model_file(path: Path) -> 'SoftModel':
    """Return the model of a file, or the offsets of a track.

    Raises
    ------
    ValueError
        If there is none, or it is no model.
    """
    from fuzzycnc_ros.core.deformation.soft_model import read_soft_model

    if not path.is_file():
        raise ValueError(f'{path}: expected a model file but found none')
    try:
        return read_soft_model(path.read_text(encoding='utf-8'))
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error

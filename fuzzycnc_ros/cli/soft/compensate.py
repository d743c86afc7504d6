# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc soft compensate`: a design, a program or a list of points, shifted for a sheet."""

import csv
import io
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    say,
    show,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.options import PROGRAM_UNITS, OptionalText, Report, choice, given
from fuzzycnc_ros.cli.programs.program_files import (
    STREAM,
    check_output,
    new_program,
    open_program,
    program_lines,
)
from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.core.units import FEEDS, LENGTHS
from fuzzycnc_ros.studies.number_table import table_cells

if TYPE_CHECKING:
    from fuzzycnc_ros.core.arrays import Array
    from fuzzycnc_ros.core.deformation.compensation import OffsetPath
    from fuzzycnc_ros.core.deformation.soft_model import SoftModel
    from fuzzycnc_ros.core.deformation.stitch_design import PlacedRun
    from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath
    from fuzzycnc_ros.studies.page.table import Table

COLUMNS = ('x_mm', 'y_mm')
"""Columns of a list of points; `kind` (1 arc, 2 line), `turn` (1 left, -1 right) and `jump` (1
where no stitch leads to the point) may follow."""

ADDED = ('offset_x_mm', 'offset_y_mm', 'flag')
"""Columns that are added."""

SPACING = 0.2
"""Tolerance of the spacing of points, as a share of the stitch step."""

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
            help='Embroidery file (.dst .pes .exp .jef .vp3 .hus and more), drawing (.svg .dxf), '
            'part program (G-code; - is standard input), or .csv of stitches with the columns '
            'x_mm, y_mm and, if wanted, kind (1 arc, 2 line), turn (1 left, -1 right) and jump '
            '(1 where no stitch leads to the point).',
        ),
    ],
    model: Annotated[
        Path, typer.Option(metavar='MODEL', help='File of `soft train` or `soft learn`.')
    ],
    thickness: Annotated[
        str, typer.Option(metavar='LENGTH', help='Thickness of the sheet, such as 15mm.')
    ],
    depth: Annotated[str, typer.Option(metavar='LENGTH', help='Feed depth, such as 6mm.')],
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE',
            help='The compensated path; - is standard output. Of a design its ending says which '
            'format: .dst .pes .pec .exp .jef .vp3 .xxx .u01 .tbf, .svg .dxf, .csv or .ngc.',
        ),
    ],
    step: Annotated[
        OptionalText,
        given(
            'Stitch step, such as 3mm; an embroidery file has its own in each run.',
            metavar='LENGTH',
        ),
    ] = None,
    size: Annotated[
        OptionalText,
        given(
            'Clamped area from the origin, such as 150x100mm; the tool is kept on it. A '
            'design is centred on it.',
            metavar='WIDTHxHEIGHT',
        ),
    ] = None,
    stitch_max: Annotated[
        OptionalText,
        given('Of a design: longest stitch of the machine, such as 7mm.', metavar='LENGTH'),
    ] = None,
    stitch_min: Annotated[
        str,
        typer.Option(
            metavar='LENGTH',
            help='Of a design: stitches that the offsets make shorter are merged.',
        ),
    ] = '0.3mm',
    feed: Annotated[
        str,
        typer.Option(metavar='FEED', help='Of a design that becomes a part program: its feed.'),
    ] = '1200mm/min',
    units: Annotated[
        str, choice('Unit before the program says G20 or G21.', PROGRAM_UNITS)
    ] = 'mm',
    in_place: Annotated[
        bool, typer.Option('--in-place', help='FILE may be the path itself.')
    ] = False,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    r"""Shift the stitches of a path, so that the relaxed sheet shows the path as it was meant.

    Moves with feed in X and Y are divided into stitches, a G1 each; a figure goes from one rapid
    to the next, and its first point stays where it is. All other lines stay as they are. Steps
    that the model was not trained for are not compensated, and listed by their lines, like those
    at which a limit was at work. A file of `soft learn` is for the figure that it was learnt on.

    Of a design the stitches move, run by run; jumps, trims, stops and colour changes stay where
    they are. Stitches that get longer than the format or the machine takes are split.

        fuzzycnc soft compensate quilt.ngc --model model.json --thickness 15mm --depth 6mm \
            --step 3mm --size 150x100mm --out quilt_compensated.ngc
        fuzzycnc soft compensate stitches.csv --model model.json --thickness 20mm --depth 8mm \
            --step 3mm --out stitches_compensated.csv
        fuzzycnc soft compensate leaf.dst --model model.json --thickness 15mm --depth 6mm \
            --out leaf_compensated.dst --report leaf.html
    """
    from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial

    depth_m, thickness_m = (
        quantity(option, text, LENGTHS, example=example)
        for option, text, example in (
            ('--depth', depth, '6mm'),
            ('--thickness', thickness, '15mm'),
        )
    )
    step_m = None if step is None else quantity('--step', step, LENGTHS, example='3mm')
    sheet = SheetMaterial(thickness_m, None if size is None else sheet_size(size))
    known = read_model_file(model)
    check_output(path, out, in_place)
    check_folder(report, json_file)
    job = PathCompensator(known, sheet, depth_m, step_m)
    if _is_design(path):
        from fuzzycnc_ros.cli.soft.designs import Sewing, shift_design

        sewing = Sewing(
            None
            if stitch_max is None
            else quantity('--stitch-max', stitch_max, LENGTHS, example='7mm'),
            quantity('--stitch-min', stitch_min, LENGTHS, example='0.3mm', zero=True),
            quantity('--feed', feed, FEEDS, example='1200mm/min'),
            1e-3 if units == 'mm' else 25.4e-3,
        )
        with job.about(path, model):
            lines = shift_design(path, out, job, sewing)
    else:
        lines = []
        table = path.suffix.lower() == '.csv'
        if step_m is None:
            raise ValueError('--step: expected the stitch step, such as 3mm, but found none')
        with program_lines(path) as source, job.about(path, model):
            text = shifted_points(source, job) if table else shifted_program(source, units, job)
            job.check()
            with new_program(out) as new:
                new.write(text)
    with redirect_stdout(sys.stderr) if str(out) == STREAM else nullcontext():
        if job.flags:
            show(_flags_table(job.flags, 'Run' if _is_design(path) else 'Line'))
        for line in [*lines, *job.lines(model)]:
            say(line)
        if str(out) != STREAM:
            say(f'{out}: the compensated path')
    if report is not None:
        from fuzzycnc_ros.studies.soft.design_page import design_page

        facts = {
            'Pattern': path.name, 'Model': model.name, 'Thickness': thickness, 'Depth': depth,
        }  # fmt: skip
        write_report(report, design_page(job.runs, [*lines, *job.lines(model)], facts))
    write_json(json_file, job.document())


def _is_design(path: Path) -> bool:
    from fuzzycnc_ros.studies.soft.design_files import is_design

    return str(path) != STREAM and is_design(path)


class PathCompensator:
    """Compensates paths, and keeps what is to be said of them."""

    def __init__(
        self, model: 'SoftModel', material: 'SheetMaterial', depth: float, step: float | None
    ) -> None:
        self.model, self.material, self.depth, self._step = model, material, depth, step
        self.flags: list[LineFlags] = []
        self.runs: list[PlacedRun] = []
        self.counts: dict[str, int] = {}
        self.steps = self.refused = self.limited = 0
        self.largest = 0.0
        self.elsewhere = ''  # why learnt offsets are not for a figure
        self._whole = ''  # why they are not for all figures together

    @property
    def step(self) -> float:
        """Nominal stitch step [m]."""
        assert self._step is not None
        return self._step

    @property
    def given_step(self) -> float | None:
        """Nominal stitch step [m], if there is one."""
        return self._step

    @contextmanager
    def about(self, path: Path, model: Path) -> Iterator[None]:
        """Say of an error which file it is about."""
        self.place, self.model_file = path, model
        try:
            yield
        except ValueError as error:
            said = str(error)
            if said.startswith((f'{path}: ', '--')):
                raise
            raise ValueError(f'{path}: {said}') from error

    def check(self) -> None:
        """Refuse a path of which the model knows nothing at all."""
        if self.elsewhere and self.refused == self.steps:
            centred = ', and --size as it was then' if _is_design(self.place) else ''
            raise ValueError(
                f'{self.place}: expected the stitches that {self.model_file} was learnt on but '
                f'found {self._whole}; give the path that was stitched then, without its '
                f'offsets{centred}'
            )

    def models(self, runs: Sequence['Array']) -> Sequence['SoftModel']:
        """Return what compensates each run, points of shape (k, 2) [m] each."""
        import numpy as np

        from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets

        if isinstance(self.model, StitchOffsets):
            own = self.model.of_runs(runs)
            if own is not None:
                return own
            self._whole = self.model.other_points(np.concatenate(runs))
        return [self.model] * len(runs)

    def compensated(
        self, path: 'StitchPath', lines: Sequence[int], model: 'SoftModel | None' = None
    ) -> 'OffsetPath':
        """Compensate a path whose steps are from certain lines, by its own model if it has one."""
        import numpy as np

        from fuzzycnc_ros.core.deformation.compensation import OffsetPath, StepFlag
        from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets
        from fuzzycnc_ros.core.deformation.soft_model import compensated

        model = self.model if model is None else model
        if isinstance(model, StitchOffsets) and model.other_points(path.points):
            self.elsewhere = model.other_points(path.points)
            self.steps += len(path.lengths)
            self.refused += len(path.lengths)
            return OffsetPath.unchanged(path.points)
        found = compensated(path, self.material, model)
        refused = found.refused
        limited = (found.flag & ~StepFlag.ZERO_LENGTH != 0) & ~refused
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
            **self.counts,
        }

    def lines(self, model: Path) -> list[str]:
        """Return what is to be said of all steps."""
        lines = [
            f'{self.steps:,} stitches, {self.refused:,} of them not compensated, '
            f'{self.limited:,} limited; largest offset {1e3 * self.largest:.3f} mm'
        ]
        if self.elsewhere:
            lines.append(
                f'note: {model} is for one figure alone; for the others it has {self.elsewhere}'
            )
        if getattr(self.model, 'thickness', 0.0) is None:
            lines.append(f'note: {model} does not say for what thickness; learn the offsets anew')
        if not self.largest and not (self.refused and getattr(self.model, 'corrects', True)):
            lines.append(f'note: {model} holds no correction; the path is as it was')
        return lines


def shifted_program(source: Path, units: str, job: PathCompensator) -> str:
    """Return a part program with its stitches shifted."""
    import numpy as np

    from fuzzycnc_ros.core.deformation.stitch_design import PlacedRun
    from fuzzycnc_ros.core.deformation.stitched_program import StitchedProgram

    with open_program(source) as file:
        program = StitchedProgram(file, job.step, units=units, size=job.material.size)
    offsets = []
    paths = [figure.path(job.depth, job.step) for figure in program.figures]
    models = job.models([path.points for path in paths])
    for figure, path, model in zip(program.figures, paths, models, strict=True):
        lines = np.repeat(figure.lines, figure.steps).tolist()
        found = job.compensated(path, lines, model)
        job.runs.append(PlacedRun(found.nominal, found.commanded, found.offset))
        offsets.append(found.offset)
    return ''.join(program.written(offsets))


def shifted_points(source: Path, job: PathCompensator) -> str:
    """Return a list of stitches, shifted."""
    import numpy as np

    from fuzzycnc_ros.core.deformation.stitch_design import PlacedRun
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
        for name, default in (
            ('x_mm', 0.0), ('y_mm', 0.0), ('kind', float(LINE)), ('turn', 1.0), ('jump', 0.0),
        )
    }  # fmt: skip
    points = 1e-3 * np.column_stack([values['x_mm'], values['y_mm']])
    if len(points) < 2:
        raise ValueError(f'expected two points or more but found {len(points)}')
    jump = values['jump'] != 0.0
    unknown = jump & (values['jump'] != 1.0)
    if unknown.any():
        at = int(unknown.argmax())
        raise ValueError(
            f'line {numbers[at]}: jump: expected 0 (stitched) or 1 (a jump) but found '
            f'{values["jump"][at]:g}'
        )
    lengths = np.hypot(*np.diff(points, axis=0).T)
    moving = lengths[(lengths > 0.0) & ~jump[1:]]
    spacing = float(np.median(moving)) if len(moving) else 0.0
    if abs(spacing - job.step) > SPACING * job.step:
        raise ValueError(
            f'expected points that are stitches, {1e3 * job.step:g} mm apart, but found them '
            f'{1e3 * spacing:.3g} mm apart; give their spacing as --step, and 1 in a column jump '
            'where no stitch leads to a point'
        )
    offset, flags = np.zeros_like(points), np.zeros(len(points), np.int64)
    runs = np.split(np.arange(len(points)), np.flatnonzero(jump[1:]) + 1)
    for run, model in zip(runs, job.models([points[run] for run in runs]), strict=True):
        if len(run) < 2:
            continue
        # What is said of a point is said of the step that leads to it.
        path = StitchPath(
            points[run], values['kind'][run[1:]], depth=job.depth, step=job.step,
            turn=values['turn'][run[1:]],
        )  # fmt: skip
        found = job.compensated(path, [numbers[at] for at in run[1:]], model)
        job.runs.append(PlacedRun(found.nominal, found.commanded, found.offset))
        offset[run], flags[run[1:]] = found.offset, found.flag
    places = [header.index(name) for name in COLUMNS]
    written = io.StringIO()
    writer = csv.writer(written, lineterminator='\n')
    writer.writerow([*header, *ADDED])
    for cells, place, off, flag in zip(rows, points + offset, offset, flags.tolist(), strict=True):
        for column, value in zip(places, place, strict=True):
            cells[column] = f'{1e3 * value:.4f}'
        writer.writerow([*cells, *(f'{1e3 * value:.4f}' for value in off), flag])
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


def _flags_table(flags: Sequence[LineFlags], what: str) -> 'Table':
    """Return the lines, or runs, with refused or limited steps."""
    from fuzzycnc_ros.studies.page.table import Column, Table

    columns = (
        Column(what), Column('steps'), Column('not compensated'), Column('limited'),
        Column('why', numeric=False),
    )  # fmt: skip
    rows = [
        (str(f.line), str(f.steps), str(f.refused), str(f.limited), ', '.join(f.reasons))
        for f in flags[:ROWS]
    ]
    if len(flags) > ROWS:
        more = f'{len(flags) - ROWS} more {what.lower()}s; --json has all'
        rows.append(('...', '', '', '', more))
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
        return read_soft_model(decoded(path.read_bytes()))
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error

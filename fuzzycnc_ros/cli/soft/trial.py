# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc soft pattern`, `simulate` and `measure`: a trial on a sheet, and its photograph."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    check_new,
    say,
    write_json,
    write_text,
)
from fuzzycnc_ros.cli.options import OptionalPath, OptionalText, given
from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.cli.soft.compensate import sheet_size
from fuzzycnc_ros.core.units import LENGTHS

if TYPE_CHECKING:
    from fuzzycnc_ros.core.arrays import Array

Force = Annotated[bool, typer.Option('--force', help='Overwrite the files.')]
Size = Annotated[
    str,
    typer.Option(metavar='WIDTHxHEIGHT', help='The clamped sheet; the design is centred on it.'),
]
Marks = Annotated[
    Path,
    typer.Option(
        metavar='CSV',
        help='Marks on the sheet: id, x_mm, y_mm and size_mm of ArUco squares (4x4_50).',
    ),
]
Thickness = Annotated[
    str, typer.Option(metavar='LENGTH', help='Thickness of the sheet, such as 15mm.')
]
Depth = Annotated[str, typer.Option(metavar='LENGTH', help='Feed depth, such as 6mm.')]


def write_trial(
    out: Annotated[
        Path, typer.Option(metavar='FILE', help='The pattern: .dst .pes .jef .svg .csv .ngc ...')
    ],
    size: Size = '200x120mm',
    step: Annotated[str, typer.Option(metavar='LENGTH', help='Usual stitch step.')] = '3mm',
    directions: Annotated[int, typer.Option(help='Directions over half a turn, 3 to 24.')] = 8,
    marks: Annotated[
        OptionalPath, given('Write places of eight marks for a photograph.', metavar='CSV')
    ] = None,
    marks_page: Annotated[
        OptionalPath, given('Write these marks as a page to be printed at 100 %.', metavar='SVG')
    ] = None,
    force: Force = False,
) -> None:
    """Write a pattern of straight lines that identifies a model, in few stitches.

    Lines of 50 mm lie in even directions, some of them both ways; two directions have other
    stitch steps as well, and two are stitched once more at the end, so that the order shows.

        fuzzycnc soft pattern --out trial.dst --marks marks.csv --marks-page marks.svg
    """
    import numpy as np

    from fuzzycnc_ros.core.deformation.stitch_design import Design, StitchLengths, placed_design
    from fuzzycnc_ros.core.deformation.trial_lines import trial_plan, trial_runs
    from fuzzycnc_ros.files.atomic import whole_file
    from fuzzycnc_ros.studies.soft.design_files import DesignFile, check_written, write_design
    from fuzzycnc_ros.studies.soft.sheet_marks import marks_around, printed_marks, write_marks

    area, usual = sheet_size(size), quantity('--step', step, LENGTHS, example='3mm')
    if not 3 <= directions <= 24:
        raise ValueError(f'--directions: expected 3 to 24 but found {directions}')
    check_written(out)
    for path in (out, marks, marks_page):
        if not force:
            check_new(path, remedy='add --force')
    check_folder(out, marks, marks_page)
    runs = trial_runs(trial_plan(directions, usual), area, MARGIN)
    design = Design.of_runs([np.round(run / GRID) * GRID for run in runs])
    placed = placed_design(design, np.zeros_like(design.points), StitchLengths())
    text = write_design(DesignFile(design), placed, out, FEED)
    around = marks_around(area)
    if marks is not None:
        write_text(marks, write_marks(around))
    if marks_page is not None:
        write_text(marks_page, printed_marks(around, area))
    with whole_file(out) as file:
        file.write(text)
    say(f'{out}: {len(runs)} lines, {sum(map(len, runs))} stitches')


MARGIN = 16e-3
"""Room for the marks at the edges [m]."""
GRID = 1e-4
"""Grid of embroidery files [m]: any format gets the same points."""
FEED = 0.02
"""Feed of a part program [m/s]."""


def simulate(
    path: Annotated[Path, typer.Argument(metavar='DESIGN', help='What is stitched.')],
    out: Annotated[Path, typer.Option(metavar='PNG', help='The photograph.')],
    marks: Marks,
    pattern: Annotated[
        OptionalPath,
        given('The design before compensation, centred on the sheet.', metavar='DESIGN'),
    ] = None,
    thickness: Thickness = '15mm',
    depth: Depth = '6mm',
    size: Size = '200x120mm',
    pixel: Annotated[str, typer.Option(metavar='LENGTH', help='A pixel on the sheet.')] = '0.1mm',
    seed: Annotated[int, typer.Option(help='Seed of sheet, stitches and photograph.')] = 0,
    force: Force = False,
) -> None:
    """Stitch a design on the simulated foam sheet, and draw a photograph of it.

    With slant, lens, shadow, blur and noise, to try `soft measure` without a machine.

        fuzzycnc soft simulate trial.dst --marks marks.csv --out photo.png
    """
    import numpy as np

    from fuzzycnc_ros.files.atomic import whole_file
    from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
    from fuzzycnc_ros.studies.requirement import require
    from fuzzycnc_ros.studies.soft.rendered_photo import Camera, rendered_photo
    from fuzzycnc_ros.studies.soft.sheet_marks import read_marks

    check_at_least('--seed', seed, 0)
    area = sheet_size(size)
    thick = quantity('--thickness', thickness, LENGTHS, example='15mm')
    deep = quantity('--depth', depth, LENGTHS, example='6mm')
    camera = Camera(pixel=quantity('--pixel', pixel, LENGTHS, example='0.1mm'))
    if out.suffix.lower() != '.png':
        raise ValueError(f'--out {out}: expected a file that ends in .png')
    if not force:
        check_new(out, remedy='add --force')
    check_folder(out)
    known = read_marks(marks)
    planned, runs = _planned(path if pattern is None else pattern, path, area)
    rng = np.random.default_rng(seed)
    sheet = FoamSheet(thick, area).scattered(rng)
    stitched = [sheet.stitch(run, deep, rng=rng) for run in runs]
    photo = rendered_photo(stitched, known, area, camera, rng)
    with whole_file(out) as file:
        file.write(require('cv2').imencode('.png', photo)[1].tobytes())
    rms = _rms_apart(stitched, planned)
    say(f'{out}: stitches lie {1e3 * rms:.3f} mm rms off the design')


def measure(
    photo: Annotated[Path, typer.Argument(metavar='PHOTO', help='Photograph of the sheet.')],
    pattern: Annotated[
        Path, typer.Option(metavar='DESIGN', help='The design that the sheet is to show.')
    ],
    marks: Marks,
    out: Annotated[
        Path, typer.Option(metavar='CSV', help='Stitches beside their plan, for `soft learn`.')
    ],
    stitched: Annotated[
        OptionalPath,
        given('The design as stitched, if it was compensated.', metavar='DESIGN'),
    ] = None,
    size: Size = '200x120mm',
    samples: Annotated[
        OptionalPath, given('Write samples for `soft train`, too.', metavar='CSV')
    ] = None,
    thickness: Annotated[
        OptionalText, given('Of the samples: thickness of the sheet.', metavar='LENGTH')
    ] = None,
    depth: Annotated[OptionalText, given('Of the samples: feed depth.', metavar='LENGTH')] = None,
    force: Force = False,
    json_file: JsonFile = None,
) -> None:
    """Measure on a photograph where the stitches of a design lie.

    Three or more marks give scale, slant and the bend of the lens. Each stitch is looked for near
    its place, and a run is followed from its first stitch. Stitches that are not seen, or lie far
    off their neighbours, are named, and given the place that their neighbours tell. Single seams
    can be measured; fills, whose stitches hide one another, cannot.

        fuzzycnc soft measure photo.jpg --pattern trial.dst --marks marks.csv --out measured.csv
    """
    import numpy as np

    from fuzzycnc_ros.core.names import first_names
    from fuzzycnc_ros.studies.soft.foam_records import NAMED
    from fuzzycnc_ros.studies.soft.sheet_marks import read_marks
    from fuzzycnc_ros.studies.soft.sheet_photo import (
        MARKS_OFF,
        measure_runs,
        read_photo,
        sheet_view,
    )

    area = sheet_size(size)
    lengths: list[float] = []
    if samples is not None:
        for option, text, example in (
            ('--thickness', thickness, '15mm'), ('--depth', depth, '6mm'),
        ):  # fmt: skip
            if text is None:
                raise ValueError(f'{option}: expected with --samples but found none')
            lengths.append(quantity(option, text, LENGTHS, example=example))
    for path in (out, samples):
        if not force:
            check_new(path, remedy='add --force')
    check_folder(out, samples, json_file)
    known = read_marks(marks)
    planned, commanded = _planned(pattern, stitched, area)
    image = read_photo(photo)
    try:
        view = sheet_view(image, known)
        found = measure_runs(image, view, known, commanded, area)
    except ValueError as error:
        raise ValueError(f'{photo}: {error}') from error
    seen, lost = sum(int(part.sum()) for part in found.found), found.lost()
    if not seen:
        raise ValueError(
            f'{photo}: expected stitches of {pattern} but found none; are --size, the marks and '
            'the design those of this sheet?'
        )
    rms = _rms_apart(found.runs, planned)
    say(
        f'{view.marks} marks, {1e3 * view.residual:.3f} mm off; a pixel is '
        f'{1e3 * view.pixel:.3f} mm'
    )
    if view.residual > MARKS_OFF:
        say(
            'note: the marks do not lie where they should; is the sheet flat, and the file theirs?'
        )
    if lost:
        say(f'not found: {len(lost)} of {seen + len(lost)} stitches: {first_names(lost, NAMED)}')
    say(f'{seen} stitches, {1e3 * rms:.3f} mm rms off the design')
    rows = ['x_mm,y_mm,stitched_x_mm,stitched_y_mm,offset_x_mm,offset_y_mm,jump,found']
    for run, (plan, command) in enumerate(zip(planned, commanded, strict=True)):
        table = 1e3 * np.column_stack([command, found.runs[run], command - plan])
        for number, cells in enumerate(table.tolist()):
            texts = ','.join(f'{cell:.4f}' for cell in cells)
            rows.append(f'{texts},{int(number == 0)},{int(found.found[run][number])}')
    write_text(out, '\n'.join([*rows, '']))
    if samples is not None:
        _write_samples(samples, planned, commanded, found.runs, lengths)
    write_json(
        json_file,
        {
            'stitches': seen, 'lost': lost, 'rms_deviation': rms, 'marks': view.marks,
            'marks_residual': view.residual, 'pixel': view.pixel, 'lens': view.bend,
        },
    )  # fmt: skip


def _planned(
    pattern: Path, stitched: Path | None, size: tuple[float, float]
) -> 'tuple[list[Array], list[Array]]':
    """Return the runs of a design, and those that were commanded, amid a sheet [m]."""
    import numpy as np

    from fuzzycnc_ros.studies.soft.design_files import TABLE, bounds, read_design

    one = read_design(pattern, None).design
    low, high = bounds(one)
    # A list has its places on the sheet, as `soft compensate` takes them.
    listed = pattern.suffix.lower() in TABLE
    shift = np.zeros(2) if listed else 0.5 * (np.array(size) - low - high)
    planned = [one.points[run] + shift for run in one.runs()]
    if stitched is None:
        return planned, planned
    other = read_design(stitched, None).design
    runs = [other.points[run] + shift for run in other.runs()]
    counts = [[len(run) for run in side] for side in (planned, runs)]
    if counts[0] != counts[1]:
        raise ValueError(
            f'{stitched}: expected the stitches of {pattern}, {sum(counts[0])} in '
            f'{len(counts[0])} runs, but found {sum(counts[1])} in {len(counts[1])}; compensate '
            'it without splitting or merging stitches'
        )
    # A format that puts the design at the edge of its frame has moved all of it.
    first = np.array([a[0] - b[0] for a, b in zip(planned, runs, strict=True)])
    moved = np.median(first, axis=0)
    return planned, [run + moved for run in runs]


def _rms_apart(runs: 'list[Array]', others: 'list[Array]') -> float:
    """Return the root mean square distance between the points of runs [m]."""
    import numpy as np

    apart = np.concatenate([a - b for a, b in zip(runs, others, strict=True)])
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def _write_samples(
    path: Path,
    planned: 'list[Array]',
    commanded: 'list[Array]',
    found: 'list[Array]',
    lengths: list[float],
) -> None:
    """Write the samples that lines of a measured trial give."""
    import numpy as np

    from fuzzycnc_ros.core.deformation.samples import RecordedPath, samples_of_paths
    from fuzzycnc_ros.core.deformation.stitch_path import LINE, SheetMaterial
    from fuzzycnc_ros.studies.soft.foam_records import COLUMNS

    thickness, depth = lengths
    paths = []
    for plan, command, place in zip(planned, commanded, found, strict=True):
        steps = len(plan) - 1
        if steps < 1:
            continue
        step = float(np.median(np.hypot(*np.diff(plan, axis=0).T)))
        paths.append(
            RecordedPath(
                path_id='trial', material=SheetMaterial(thickness), nominal=plan,
                offset=command - plan, stitched=place, primitive=np.zeros(steps, np.int64),
                kind=np.full(steps, float(LINE)), turn=np.zeros(steps),
                depth=np.full(steps, depth), step=np.full(steps, step),
            )
        )  # fmt: skip
    samples = samples_of_paths(paths)
    if not len(samples.x):
        reasons: dict[str, Any] = dict(samples.left_out)
        raise ValueError(
            f'--samples {path}: expected lines of 50 mm that were not compensated but found none: '
            f'{", ".join(reasons)}'
        )
    rows = np.column_stack([samples.x, samples.s])
    lines = [','.join(f'{cell:.5g}' for cell in row) for row in rows.tolist()]
    write_text(path, '\n'.join([','.join(COLUMNS), *lines, '']))
    say(f'{path}: {len(rows)} samples')

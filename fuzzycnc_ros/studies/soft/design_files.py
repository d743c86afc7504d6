# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Designs in the files of stitching and cutting machines: read, and written with moved stitches.

Embroidery formats are pyembroidery's affair, SVG is svgelements', and DXF is ezdxf's; all are
loaded on use.
"""

from __future__ import annotations

import io
import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.stitch_design import (
    Design,
    Move,
    PlacedDesign,
    StitchLengths,
    stitches_along,
)
from fuzzycnc_ros.studies.number_table import read_numbers
from fuzzycnc_ros.studies.requirement import require

UNIT = 1e-4
"""Unit of embroidery formats [m]."""

EMBROIDERY = tuple(
    '.dst .pes .pec .exp .jef .vp3 .xxx .u00 .u01 .u02 .tbf .hus .sew .shv .10o .100 .bro .dat '
    '.dsb .dsz .emd .e00 .e01 .e02 .f00 .f01 .f02 .gt .inb .ksm .tap .spx .stx .phb .phc .new '
    '.max .mit .pcd .pcq .pcm .pcs .jpx .stc .zhs .z00 .z01 .z02'.split()
)
"""Endings of embroidery files that are read."""

WRITTEN = ('.dst', '.pes', '.pec', '.exp', '.jef', '.vp3', '.xxx', '.u01', '.tbf')
"""Endings of embroidery files that are written."""

DRAWN = ('.svg', '.dxf')
"""Endings of drawings, which are read and written."""

TABLE, PROGRAM = ('.csv',), ('.ngc', '.nc', '.gcode')
"""Endings of lists of stitches, and of part programs, which are read elsewhere."""

_PROGRAMS_TOO = ('.tap', '.100', '.dat', '.max', '.new', '.10o')
"""Endings that part programs have as well; these are text."""

LARGEST = 64 * 1024 * 1024
"""Largest file that is read [bytes]."""
STITCHES_MAX = 2_000_000
"""Most commands of a design."""
PARTS_MAX = 200_000
"""Most parts of a drawing."""
FARTHEST = 10.0
"""Farthest point from the origin [m]: no frame is larger."""

_SIGNATURES = {
    '.dst': b'LA:',
    '.pes': b'#PE',
    '.pec': b'#PEC',
    '.vp3': b'%vsm%',
}
"""First bytes of the files of a format."""

_ENDED = ('.dst', '.pes', '.vp3', '.hus', '.xxx', '.u01', '.tbf')
"""Formats that say where they end: a file that ends before is damaged."""

_FLATTENED = 2e-5
"""Tolerance of a flattened curve [m]."""
_JOINED = 1e-5
"""Gap of a drawing that is none [m]."""
_POINT = 25.4e-3 / 96.0
"""Unit of SVG [m]."""
_SHARES = np.linspace(0.0, 1.0, 17).tolist()
_DXF_UNITS = {1: 25.4e-3, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 13: 1e-6}
"""Units of $INSUNITS [m]; a drawing without is in those that the reader was told."""
_DXF_KINDS = ('LINE', 'LWPOLYLINE', 'POLYLINE', 'ARC', 'CIRCLE', 'ELLIPSE', 'SPLINE')


@dataclass(eq=False)
class DesignFile:
    """A design and the file that it is from.

    Attributes
    ----------
    design : Design
        Its commands [m], Y upwards.
    pattern : pyembroidery.EmbPattern or None
        The embroidery file, which keeps threads, names and commands; none of a drawing.
    notes : list of str
        What was left out.
    """

    design: Design
    pattern: Any = None
    notes: list[str] = field(default_factory=list)


def is_design(path: Path) -> bool:
    """Return whether a file is a design by its ending, and no part program in spite of it."""
    ending = path.suffix.lower()
    if ending in _PROGRAMS_TOO and path.is_file():
        with path.open('rb') as file:
            head = file.read(4096)
        return any(byte > 126 or (byte < 32 and byte not in b'\t\r\n\f') for byte in head)
    return ending in EMBROIDERY or ending in DRAWN


def stitch_lengths(ending: str, longest: float, shortest: float) -> StitchLengths:
    """Return what a format and a machine take.

    Parameters
    ----------
    ending : str
        Ending of the file, such as `.dst`.
    longest, shortest : float
        Longest and shortest stitch of the machine [m].
    """
    if ending not in WRITTEN:
        return StitchLengths(0.0, np.inf, longest, shortest)
    units = getattr(_format(ending)['writer'], 'MAX_STITCH_DISTANCE', np.inf)
    return StitchLengths(UNIT, UNIT * units, longest, shortest)


def read_design(path: Path, step: float | None, unit: float = 1e-3) -> DesignFile:
    """Read a design.

    Parameters
    ----------
    path : Path
        Embroidery file, SVG or DXF, or a list of stitches, as a design is written to a .csv.
    step : float, optional
        Stitch step of a drawing [m]; an embroidery file has its own.
    unit : float
        Unit of a DXF drawing that does not say it [m].

    Raises
    ------
    ModuleNotFoundError
        If the package that reads it is not installed.
    ValueError
        If there is no such file, it is damaged, too large or holds nothing to stitch.
    """
    if not path.is_file():
        raise ValueError(f'{path}: expected a design but found no file')
    if path.stat().st_size > LARGEST:
        raise ValueError(
            f'{path}: expected a design of at most {LARGEST >> 20} MB but found '
            f'{path.stat().st_size >> 20} MB'
        )
    ending = path.suffix.lower()
    if ending in DRAWN:
        if step is None:
            raise ValueError(
                f'{path}: expected a stitch step, which a drawing has not, but found none; give '
                'the design as .dst or .csv, which hold the stitches'
            )
        lines, notes = (_svg_lines if ending == '.svg' else _dxf_lines)(path, unit)
        _check_extent(path, np.concatenate([np.zeros((1, 2)), *lines]))
        way = sum(float(np.hypot(*np.diff(line, axis=0).T).sum()) for line in lines)
        if way > STITCHES_MAX * step:
            raise ValueError(
                f'{path}: expected at most {STITCHES_MAX:,} stitches but found lines of '
                f'{way:.3g} m at {1e3 * step:g} mm a stitch; take a longer step'
            )
        runs = [run for run in (stitches_along(line, step) for line in lines) if len(run) > 1]
        found = DesignFile(Design.of_runs(runs), None, notes)
    elif ending in TABLE:
        table = read_numbers(path, ('x_mm', 'y_mm'), optional=('jump',)).values
        begins = np.flatnonzero(table[1:, 2:].any(axis=1)) + 1
        found = DesignFile(Design.of_runs(np.split(1e-3 * table[:, :2], begins)))
    elif ending not in EMBROIDERY:
        raise ValueError(
            f'{path}: expected a design but found {ending or "no ending"}; give the stitches as '
            '.dst or .csv'
        )
    else:
        found = _embroidery(path)
    if not (found.design.move == Move.STITCH).any():
        left = f': {", ".join(found.notes)}' if found.notes else ''
        raise ValueError(f'{path}: expected something to stitch but found nothing{left}')
    _check_extent(path, found.design.points)
    return found


def _check_extent(path: Path, points: Array) -> None:
    """Refuse points that no frame reaches."""
    largest = float(np.abs(points).max())
    if not largest <= FARTHEST:
        raise ValueError(
            f'{path}: expected points within {FARTHEST:g} m of the origin but found one '
            f'{largest:.3g} m away; is it damaged?'
        )


def write_design(source: DesignFile, placed: PlacedDesign, out: Path, feed: float) -> bytes:
    """Return a design with its stitches in new places, as the file that an ending asks for.

    Parameters
    ----------
    source : DesignFile
        The design as it was read.
    placed : PlacedDesign
        Its new places.
    out : Path
        Whose ending counts.
    feed : float
        Feed of a part program [m/s].

    Raises
    ------
    ValueError
        If nobody writes such files, or the format cannot hold the design.
    """
    ending = out.suffix.lower()
    if ending in WRITTEN:
        return _embroidered(source, placed, ending)
    makers: dict[str, Callable[[PlacedDesign], str]] = {
        '.svg': _as_svg,
        '.dxf': _as_dxf,
        '.csv': _as_table,
        **dict.fromkeys(PROGRAM, lambda design: _as_program(design, feed)),
    }
    check_written(out)
    return makers[ending](placed).encode()


def check_written(out: Path) -> None:
    """Refuse an ending that no design is written to.

    Raises
    ------
    ValueError
        If it is none.
    """
    known = (*WRITTEN, *DRAWN, *TABLE, *PROGRAM)
    if out.suffix.lower() not in known:
        raise ValueError(
            f'--out {out}: expected a file that ends in {", ".join(known)} but found '
            f'{out.suffix or "no ending"}'
        )


def _format(ending: str) -> dict[str, Any]:
    """Return what pyembroidery knows of an ending."""
    for known in require('pyembroidery').EmbPattern.supported_formats():
        endings = known['extensions']
        if ending[1:] in ((endings,) if isinstance(endings, str) else endings):
            return dict(known)
    raise AssertionError(f'pyembroidery has no format {ending}')


class _Watched(io.BytesIO):
    """Bytes that know whether somebody asked for more than there are."""

    short = False

    def read(self, size: int | None = -1, /) -> bytes:
        """Return bytes as a file does."""
        found = super().read(size)
        self.short = self.short or (size is not None and size > len(found))
        return found


def _embroidery(path: Path) -> DesignFile:
    """Read an embroidery file."""
    ending, text = path.suffix.lower(), path.read_bytes()
    pe = require('pyembroidery')
    begins = _SIGNATURES.get(ending, b'')
    if not text.startswith(begins):
        raise ValueError(
            f'{path}: expected a {ending} file, which begins with {begins!r}, but found '
            f'{text[: len(begins)]!r}; is it another format, or damaged?'
        )
    watched = _Watched(text)
    pattern = pe.EmbPattern()
    with _one_line(path, f'a {ending} file'):
        pe.EmbPattern.read_embroidery(_format(ending)['reader'], watched, None, pattern)
    if watched.short and ending in _ENDED and not _told_whole(text, ending):
        raise ValueError(
            f'{path}: expected a whole {ending} file but found that it ends too early'
        )
    if len(pattern.stitches) > STITCHES_MAX:
        raise ValueError(
            f'{path}: expected at most {STITCHES_MAX:,} commands but found '
            f'{len(pattern.stitches):,}'
        )
    with _one_line(path, f'a {ending} file'):
        rows = np.array([[x, y, command & 0xFF] for x, y, command in pattern.stitches], float)
    rows = rows.reshape(-1, 3)
    if not np.isfinite(rows).all():
        raise ValueError(f'{path}: expected finite points but found some that are not')
    kinds = {
        pe.STITCH: Move.STITCH, pe.SEQUIN_EJECT: Move.STITCH, pe.NEEDLE_AT: Move.STITCH,
        pe.SEW_TO: Move.STITCH, pe.JUMP: Move.JUMP, pe.STOP: Move.PAUSE, pe.SLOW: Move.PAUSE,
        pe.FAST: Move.PAUSE, pe.SEQUIN_MODE: Move.PAUSE,
    }  # fmt: skip
    move = np.array([kinds.get(int(kind), Move.CUT) for kind in rows[:, 2]], dtype=np.int64)
    return DesignFile(Design(rows[:, :2] * [UNIT, -UNIT], move), pattern)


def _told_whole(text: bytes, ending: str) -> bool:
    """Return whether a DST file without an end holds about as many stitches as its header says."""
    place = text[:512].find(b'ST:')
    if ending != '.dst' or place < 0:
        return False
    with suppress(ValueError):
        return int(text[place + 3 : place + 10]) <= 1.01 * ((len(text) - 512) // 3)
    return False


@contextmanager
def _one_line(path: Path, what: str) -> Iterator[None]:
    """Say in one line that a library cannot read a file: it may raise anything on a bad one."""
    try:
        yield
    except (KeyboardInterrupt, ModuleNotFoundError):
        raise
    except (Exception, RecursionError) as error:
        reason = ' '.join(str(error).split())[:120] or type(error).__name__
        raise ValueError(
            f'{path}: expected {what} but found that it cannot be read ({reason}); is it damaged?'
        ) from error


def _embroidered(source: DesignFile, placed: PlacedDesign, ending: str) -> bytes:
    """Return a design as an embroidery file."""
    pe = require('pyembroidery')
    old = source.pattern
    if old is None:
        pattern = pe.EmbPattern()
        commands = {Move.STITCH: pe.STITCH, Move.JUMP: pe.JUMP, Move.CUT: pe.TRIM}
        rows = [
            [*point, commands[Move(kind)]]
            for point, kind in zip(placed.points, placed.design.move.tolist(), strict=True)
        ]
        stitches = [[x / UNIT, -y / UNIT, command] for x, y, command in rows]
    else:
        pattern = old.copy()
        stitches = [list(row) for row in old.stitches]
        changed = (placed.points != placed.design.points).any(axis=1)
        for place in np.flatnonzero(changed).tolist():
            x, y = placed.points[place] / UNIT
            stitches[place][:2] = [round(x), round(-y)]
    written = []
    for place, row in enumerate(stitches):
        written += [
            [round(x / UNIT), round(-y / UNIT), pe.STITCH]
            for x, y in placed.added.get(place, np.empty((0, 2)))
        ]
        if not placed.merged[place]:
            written.append(row)
    if old is None:
        written.append([*written[-1][:2], pe.END])
    pattern.stitches = written
    # A writer would draw colours for threads that the source does not know.
    kinds = [row[2] & 0xFF for row in written]
    sewn = kinds[kinds.index(pe.STITCH) :] if pe.STITCH in kinds else []
    changes = sewn.count(pe.COLOR_CHANGE) + sewn.count(pe.NEEDLE_SET)
    for _ in range(len(pattern.threadlist), changes + 1):
        pattern.add_thread({'color': 0x000000})
    file = io.BytesIO()
    # Its writer would take the time of day.
    settings = {'date': '20000101000000'} if ending == '.jef' else None
    try:
        pe.EmbPattern.write_embroidery(_format(ending)['writer'], pattern, file, settings)
    except Exception as error:
        raise ValueError(
            f'expected a design that a {ending} file can hold but found that it cannot '
            f'({str(error)[:120] or type(error).__name__}); choose another format'
        ) from error
    return file.getvalue()


def _svg_lines(path: Path, unit: float) -> tuple[list[Array], list[str]]:
    """Return the flattened paths of an SVG drawing [m], Y upwards."""
    svg = require('svgelements')
    lines: list[Array] = []
    left: Counter[str] = Counter()
    with _one_line(path, 'an SVG drawing'):
        text = path.read_bytes()
        if b'<!ENTITY' in text:
            raise ValueError('entities are not read')
        if _parts(ElementTree.fromstring(text)) > PARTS_MAX:
            raise ValueError('more parts than any drawing has, by use of others')
        for element in svg.SVG.parse(str(path)).elements():
            if isinstance(element, (svg.Text, svg.Image)):
                left[type(element).__name__.lower()] += 1
            if not isinstance(element, svg.Shape):
                continue
            for part in svg.Path(element).as_subpaths():
                lines.append(_POINT * _flattened(svg.Path(part)) * [1.0, -1.0])
    return _finite(lines), [f'left out: {count} {name} elements' for name, count in left.items()]


def _parts(root: ElementTree.Element) -> int:
    """Return how many parts a drawing has, those that use others counted each time.

    Raises
    ------
    RecursionError
        If a part uses itself.
    """
    named = {name: part for part in root.iter() if (name := part.get('id'))}
    known: dict[ElementTree.Element, int] = {}

    def count(part: ElementTree.Element) -> int:
        if part not in known:
            used = part.get('href') or part.get('{http://www.w3.org/1999/xlink}href') or ''
            found = named.get(used.removeprefix('#'))
            known[part] = 1 + sum(map(count, part)) + (0 if found is None else count(found))
        return known[part]

    return count(root)


def _flattened(path: Any) -> Array:
    """Return the points of a path of SVG, in its own unit."""
    points: list[tuple[float, float]] = []
    for segment in path:
        if segment.end is None or segment.start is None:
            continue
        kind, count = type(segment).__name__, 1
        if kind == 'Move':
            points = [(segment.end.x, segment.end.y)]
            continue
        if kind not in ('Line', 'Close'):
            # n chords of a circle are off by pi / (4 n^2) of its length; others bend unevenly.
            rough = np.array([(place.x, place.y) for place in map(segment.point, _SHARES)])
            length = 1.1 * float(np.hypot(*np.diff(rough, axis=0).T).sum()) * _POINT
            count = int(min(max(8.0, 1.6 * (length / _FLATTENED) ** 0.5), 2000.0))
        if not points:
            points = [(segment.start.x, segment.start.y)]
        points += [
            (place.x, place.y)
            for place in (segment.point(share / count) for share in range(1, count + 1))
        ]
    return np.array(points, float).reshape(-1, 2)


def _dxf_lines(path: Path, unit: float) -> tuple[list[Array], list[str]]:
    """Return the flattened lines of a DXF drawing [m], those that meet joined."""
    ezdxf = require('ezdxf')
    make_path = require('ezdxf.path').make_path
    logging.getLogger('ezdxf').setLevel(logging.ERROR)
    lines: list[Array] = []
    left: Counter[str] = Counter()
    with _one_line(path, 'a DXF drawing'):
        drawing = ezdxf.readfile(path)
        factor = _DXF_UNITS.get(int(drawing.header.get('$INSUNITS', 0)), unit)
        for entity in drawing.modelspace():
            if entity.dxftype() not in _DXF_KINDS:
                left[entity.dxftype()] += 1
                continue
            points = make_path(entity).flattening(_FLATTENED / factor)
            lines.append(factor * np.array([(point.x, point.y) for point in points]))
    notes = [f'left out: {count} {name} entities' for name, count in sorted(left.items())]
    return _joined(_finite(lines)), notes


def _finite(lines: list[Array]) -> list[Array]:
    """Return those lines that have a length."""
    if any(not np.isfinite(line).all() for line in lines):
        raise ValueError('expected finite points in the drawing but found some that are not')
    return [line for line in lines if len(line) > 1]


def _joined(lines: Sequence[Array]) -> list[Array]:
    """Return lines with those that begin where the last one ends joined to it."""
    found: list[Array] = []
    for line in lines:
        if found and np.hypot(*(found[-1][-1] - line[0])) < _JOINED:
            found[-1] = np.concatenate([found[-1], line[1:]])
        else:
            found.append(line)
    return found


def _as_svg(placed: PlacedDesign) -> str:
    """Return the runs of a design as an SVG drawing in millimetres."""
    runs = [1e3 * run * [1.0, -1.0] for run in placed.runs()]
    everything = np.concatenate(runs)
    # A drawing that was read from the corner of its page keeps its place on it.
    low = np.minimum(everything.min(axis=0), 0.0)
    size = everything.max(axis=0) - low
    lines = [
        '<polyline points="' + ' '.join(f'{x:.4f},{y:.4f}' for x, y in run) + '"/>' for run in runs
    ]
    return '\n'.join([
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size[0]:.4f}mm" height="{size[1]:.4f}mm"'
        f' viewBox="{low[0]:.4f} {low[1]:.4f} {size[0]:.4f} {size[1]:.4f}" fill="none" '
        'stroke="black" stroke-width="0.2">',
        *lines,
        '</svg>',
        '',
    ])  # fmt: skip


def _as_dxf(placed: PlacedDesign) -> str:
    """Return the runs of a design as polylines of a DXF drawing in millimetres."""
    ezdxf = require('ezdxf')
    drawing = ezdxf.new('R2000', units=4)
    for run in placed.runs():
        drawing.modelspace().add_lwpolyline(1e3 * run)
    text = io.StringIO()
    drawing.write(text)
    return text.getvalue()


def _as_table(placed: PlacedDesign) -> str:
    """Return the runs of a design as a list of stitches, in which a jump begins each run."""
    rows = ['x_mm,y_mm,jump']
    for run in placed.runs():
        rows += [f'{1e3 * x:.4f},{1e3 * y:.4f},{int(n == 0)}' for n, (x, y) in enumerate(run)]
    return '\n'.join([*rows, ''])


def _as_program(placed: PlacedDesign, feed: float) -> str:
    """Return the runs of a design as a part program: a rapid to each, and a G1 for each stitch."""
    lines = ['G21 G90']
    for number, run in enumerate(1e3 * run for run in placed.runs()):
        x, y = run[0]
        lines.append(f'G0 X{x:.4f} Y{y:.4f} (run {number + 1})')
        for count, (x, y) in enumerate(run[1:]):
            lines.append(f'G1 X{x:.4f} Y{y:.4f}' + (f' F{60e3 * feed:g}' if not count else ''))
    return '\n'.join([*lines, 'M30', ''])


def bounds(design: Design) -> tuple[Array, Array]:
    """Return the least and the largest coordinates of the stitches of a design [m]."""
    stitches = design.points[design.move == Move.STITCH]
    low, high = stitches.min(axis=0), stitches.max(axis=0)
    assert isfinite(float(low.sum() + high.sum()))
    return low, high

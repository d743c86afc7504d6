# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files of stitching and cutting machines: what is kept, and what is refused."""

from itertools import pairwise

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.stitch_design import Move, placed_design
from fuzzycnc_ros.studies.soft.design_files import (
    UNIT,
    WRITTEN,
    is_design,
    read_design,
    stitch_lengths,
    write_design,
)

_MISSING = "it is missing: pip install 'fuzzycnc_ros[designs]'"
ezdxf = pytest.importorskip('ezdxf', reason=_MISSING)
pe = pytest.importorskip('pyembroidery', reason=_MISSING)
pytest.importorskip('svgelements', reason=_MISSING)
embroidery = pytest.importorskip('designs').embroidery

STEP = 3e-3
MOVING = (pe.STITCH, pe.JUMP)
GRID = {'.vp3': 1e-4}
"""A file that says its middle moves by half of its grid."""


def rewritten(path, out, offset=None):
    """Return the bytes of a design with offsets of its stitches."""
    source = read_design(path, STEP)
    shift = np.zeros_like(source.design.points) if offset is None else offset(source.design)
    placed = placed_design(source.design, shift, stitch_lengths(out.suffix, np.inf, 0.0))
    return write_design(source, placed, out, 0.02)


@pytest.mark.parametrize('ending', WRITTEN)
def test_without_offsets_a_file_is_what_its_own_library_writes(tmp_path, ending):
    path, own = embroidery(tmp_path / f'leaf{ending}'), tmp_path / f'own{ending}'
    pe.write(pe.read(str(path)), str(own), {'date': '20000101000000'})
    known = bool(pe.read(str(path)).threadlist)
    if known or ending in ('.dst', '.exp', '.u01'):
        assert rewritten(path, own) == own.read_bytes()
    assert rewritten(path, own) == rewritten(path, own)


@pytest.mark.parametrize('ending', WRITTEN)
def test_only_stitches_move(tmp_path, ending):
    path = embroidery(tmp_path / f'leaf{ending}')
    out, own = tmp_path / f'out{ending}', tmp_path / f'own{ending}'
    shift = np.array([3e-4, 2e-4])

    def offset(design):
        found = np.where((design.move == Move.STITCH)[:, np.newaxis], shift, 0.0)
        found[[run[0] for run in design.runs()]] = 0.0
        return found

    out.write_bytes(rewritten(path, out, offset))
    pe.write(pe.read(str(path)), str(own))
    plan, found = read_design(own, None), read_design(out, None)
    assert [len(run) for run in found.design.runs()] == [len(run) for run in plan.design.runs()]
    for one, other in zip(plan.design.runs(), found.design.runs(), strict=True):
        moved = found.design.points[other] - plan.design.points[one]
        wanted = np.broadcast_to(shift, (len(one) - 1, 2))
        np.testing.assert_allclose(moved[1:], wanted, atol=1e-9 + GRID.get(ending, 0.0))
    kept = [
        [row[2] & 0xFF for row in file.pattern.stitches if row[2] & 0xFF not in MOVING]
        for file in (plan, found)
    ]
    assert kept[0] == kept[1]
    if path_has_threads := read_design(path, None).pattern.threadlist:
        colours = [thread.color for thread in found.pattern.threadlist]
        assert colours[: len(path_has_threads)] == [thread.color for thread in path_has_threads]


@pytest.mark.parametrize('ending', WRITTEN)
def test_no_stitch_gets_longer_than_the_format_takes(tmp_path, ending):
    path, out = embroidery(tmp_path / 'leaf.pes'), tmp_path / f'out{ending}'

    def offset(design):
        back = np.arange(len(design.points)) % 2 * 20e-3
        return np.column_stack([back, np.zeros_like(back)])

    out.write_bytes(rewritten(path, out, offset))
    rows = pe.read(str(out)).stitches
    limit = stitch_lengths(ending, np.inf, 0.0).along_axis / UNIT
    steps = [
        max(abs(b[0] - a[0]), abs(b[1] - a[1]))
        for a, b in pairwise(rows)
        if a[2] & 0xFF == b[2] & 0xFF == pe.STITCH
    ]
    assert max(steps) <= limit + 1e-6


@pytest.mark.parametrize('ending', ['.dst', '.pes', '.pec', '.vp3'])
def test_another_format_under_its_name_is_refused(tmp_path, ending):
    path = tmp_path / f'leaf{ending}'
    path.write_bytes(b'%PDF-1.4 no design at all' * 40)
    with pytest.raises(ValueError, match='which begins with'):
        read_design(path, None)


@pytest.mark.parametrize('ending', ['.dst', '.pes', '.vp3', '.xxx', '.u01'])
def test_a_file_that_ends_too_early_is_refused(tmp_path, ending):
    path = embroidery(tmp_path / f'leaf{ending}')
    content = path.read_bytes()
    keep = {'.pes': 0.55, '.xxx': 0.5}.get(ending, 0.9)
    path.write_bytes(content[: int(keep * len(content))])
    with pytest.raises(ValueError, match=r'ends too early|cannot be read'):
        read_design(path, None)


def test_a_file_without_a_stitch_is_refused(tmp_path):
    pe.write(pe.EmbPattern(), str(tmp_path / 'none.dst'))
    with pytest.raises(ValueError, match=r'none\.dst: expected something to stitch'):
        read_design(tmp_path / 'none.dst', None)


def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch):
    path = embroidery(tmp_path / 'leaf.dst')
    monkeypatch.setitem(__import__('sys').modules, 'pyembroidery', None)
    with pytest.raises(ModuleNotFoundError, match=r'fuzzycnc_ros\[designs\]'):
        read_design(path, None)


SVG = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60">
<text x="5" y="5">a name</text>
<path d="M 10 10 H 40 V 25"/>
<circle cx="70" cy="30" r="12"/>
</svg>"""


def test_paths_of_svg_become_runs_in_millimetres_with_y_upwards(tmp_path):
    (tmp_path / 'a.svg').write_text(SVG)
    found = read_design(tmp_path / 'a.svg', STEP)
    line, circle = (found.design.points[run] for run in found.design.runs())
    np.testing.assert_allclose(
        line[[0, 10, -1]], [[0.01, -0.01], [0.04, -0.01], [0.04, -0.025]], atol=1e-7
    )
    np.testing.assert_allclose(np.hypot(*(circle - [0.07, -0.03]).T), 0.012, atol=3e-5)
    np.testing.assert_allclose(np.hypot(*np.diff(circle, axis=0).T), STEP, rtol=0.03)
    assert found.notes == ['left out: 1 text elements']
    with pytest.raises(ValueError, match='expected a stitch step'):
        read_design(tmp_path / 'a.svg', None)


@pytest.mark.parametrize(('units', 'length'), [(4, 1e-3), (1, 25.4e-3), (0, 25.4e-3)])
def test_lines_of_dxf_that_meet_are_one_run(tmp_path, units, length):
    drawing = ezdxf.new('R2000', units=units)
    space = drawing.modelspace()
    space.add_lwpolyline([(0, 0), (1, 0), (1, 1)])
    space.add_line((1, 1), (0, 1))
    space.add_arc((5, 5), 2, 0, 90)
    space.add_text('a name')
    drawing.saveas(tmp_path / 'a.dxf')
    found = read_design(tmp_path / 'a.dxf', 0.25 * length, 25.4e-3)
    first, arc = (found.design.points[run] / length for run in found.design.runs())
    assert len(first) == 13
    np.testing.assert_allclose(first[[0, 4, 8, 12]], [[0, 0], [1, 0], [1, 1], [0, 1]], atol=1e-9)
    np.testing.assert_allclose(np.hypot(*(arc - 5.0).T), 2.0, atol=0.02)
    assert found.notes == ['left out: 1 TEXT entities']


@pytest.mark.parametrize('ending', ['.svg', '.dxf', '.csv'])
def test_drawings_and_lists_are_written_as_they_are_read(tmp_path, ending):
    path = embroidery(tmp_path / 'leaf.dst')
    out = tmp_path / f'out{ending}'
    out.write_bytes(rewritten(path, out))
    plan, found = read_design(path, None), read_design(out, 2.5e-3)
    runs = [run for run in plan.design.runs() if len(run) > 1]
    assert len(found.design.runs()) == len(runs)
    page = np.array([0.02, -0.015]) * (ending == '.svg')  # from the corner of the page
    for one, other in zip(runs, found.design.runs(), strict=True):
        ends = plan.design.points[one[[0, -1]]] + page
        np.testing.assert_allclose(found.design.points[other[[0, -1]]], ends, atol=2e-6)


@pytest.mark.parametrize(
    'text',
    [
        '<svg', '<!DOCTYPE svg [<!ENTITY a "b">]><svg>&a;</svg>',
        '<svg xmlns="http://www.w3.org/2000/svg"><path d="M nan 0 L 5 5"/></svg>', '\x00\x01',
    ],
)  # fmt: skip
def test_bad_drawings_are_refused_in_one_line(tmp_path, text):
    for ending in ('.svg', '.dxf'):
        path = tmp_path / f'a{ending}'
        path.write_text(text)
        with pytest.raises(ValueError, match='expected') as refusal:
            read_design(path, STEP)
        assert str(refusal.value).startswith(f'{path}: ')
        assert '\n' not in str(refusal.value)


def test_a_part_program_may_have_the_ending_of_a_design(tmp_path):
    (tmp_path / 'a.tap').write_text('G0 X0 Y0\nG1 X30 F600\n')
    (tmp_path / 'b.tap').write_bytes(bytes(range(256)))
    assert not is_design(tmp_path / 'a.tap')
    assert is_design(tmp_path / 'b.tap')
    assert not is_design(tmp_path / 'a.csv')

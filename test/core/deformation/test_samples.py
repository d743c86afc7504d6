# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.samples import RecordedPath, joined_groups, samples_of_paths
from fuzzycnc_ros.core.deformation.stitch_path import ARC, LINE, Primitive, SheetMaterial
from fuzzycnc_ros.simulation.soft.foam_samples import true_compensation
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

MATERIAL = SheetMaterial(15e-3, (0.2, 0.12), 'foam')
SHEET = FoamSheet(15e-3)
CENTRE = np.array([0.1, 0.06])


def recorded(nominal, primitive, kind, turn, *, offset=None, step=3e-3, depth=6e-3, rng=None):
    """Stitch a path on the sheet and return the record."""
    nominal = np.asarray(nominal)
    steps = len(nominal) - 1
    offset = np.zeros_like(nominal) if offset is None else offset
    kind, turn = np.broadcast_to(kind, steps), np.broadcast_to(turn, steps)
    stitched = SHEET.stitch(nominal + offset, depth, np.sign(turn), rng)
    return RecordedPath(
        path_id='p', material=MATERIAL, nominal=nominal, offset=offset, stitched=stitched,
        primitive=np.asarray(primitive), kind=kind.astype(float), turn=turn.astype(float),
        depth=np.full(steps, depth), step=np.full(steps, step),
    )  # fmt: skip


def line(angle, length=50e-3, step=3e-3):
    """Return a line that begins 25 mm before the middle of the sheet."""
    along = np.array([np.cos(angle), np.sin(angle)])
    start = CENTRE - 25e-3 * along
    points = [
        start,
        *Primitive(tuple(start), tuple(start + length * along), 6e-3, step).stitches(),
    ]
    return recorded(points, np.zeros(len(points) - 1, int), LINE, 0.0, step=step)


def arc(angle, step=3e-3, turn=30.0 / 25.0):
    """Return an arc of 30 mm around 25 mm whose middle lies in the middle of the sheet."""
    ways = np.linspace(-0.5, 0.5, round(30e-3 / step) + 1) * turn
    along = np.array([np.cos(angle), np.sin(angle)])
    left = np.sign(turn) * np.array([-along[1], along[0]])
    size = np.abs(ways) * np.sign(ways) * np.sign(turn)
    points = CENTRE + 25e-3 * (np.outer(np.sin(size), along) + np.outer(1 - np.cos(size), left))
    return recorded(points, np.zeros(len(points) - 1, int), ARC, turn, step=step)


def track(angle=45.0, offset=None, rng=None):
    parallelogram = FoamTrack.parallelogram(np.radians(angle), centre=tuple(CENTRE))
    sides = np.repeat(np.arange(4), np.diff(parallelogram.corners))
    return recorded(parallelogram.points, sides, LINE, 0.0, offset=offset, rng=rng)


def test_each_run_between_jumps_is_on_a_fresh_sheet():
    one, other = line(np.radians(10.0)), line(np.radians(50.0))

    def both(name, between=()):
        return np.concatenate([getattr(one, name), *between, getattr(other, name)])

    names = ('kind', 'turn', 'depth', 'step')
    steps = len(one.kind)
    joined = replace(
        one,
        **{name: both(name) for name in ('nominal', 'offset', 'stitched')},
        **{name: both(name, ([getattr(other, name)[0]],)) for name in names},
        primitive=np.repeat([0, 1], [steps, steps + 1]),
        jump=np.arange(2 * steps + 1) == steps,
    )
    apart, found = samples_of_paths([one, other]), samples_of_paths([joined])
    np.testing.assert_array_equal(found.x, apart.x)
    np.testing.assert_array_equal(found.s, apart.s)
    assert (found.path.tolist(), found.relaxed, found.left_out) == ([0, 0], 0, {})


@pytest.mark.parametrize('angle', [0.0, 30.0, 60.0, 180.0, 215.0])
@pytest.mark.parametrize('step', [2e-3, 3e-3, 4e-3, 5e-3])
def test_single_primitives_give_the_samples_of_the_sheet(angle, step):
    paths = [line(np.radians(angle), step=step), arc(np.radians(angle), step=step)]
    found = samples_of_paths(paths)
    assert found.relaxed == 0
    assert found.left_out == {}
    assert found.x[:, 0] == pytest.approx(angle % 180.0, abs=1e-9)
    np.testing.assert_allclose(found.x[:, 1:], [[6, 2, 1e3 * step, 15], [6, 1, 1e3 * step, 15]])
    np.testing.assert_allclose(found.s, true_compensation(found.x), rtol=1e-9)


def test_a_longer_line_counts_as_far_as_a_sample_goes():
    short, long = samples_of_paths([line(0.3, 51e-3)]), samples_of_paths([line(0.3, 72e-3)])
    assert long.s == pytest.approx(short.s, rel=1e-9)


def test_sides_of_a_track_are_taken_by_fading_as_they_would_be_on_a_fresh_sheet():
    """The opposite sides of a centred track lie in like places, one is fresh and one is not."""
    found = samples_of_paths([track(rng=np.random.default_rng(1))])
    assert found.relaxed == 3
    assert found.left_out == {}
    np.testing.assert_allclose(found.s[2], found.s[0], rtol=0.08)
    np.testing.assert_allclose(found.x[2], found.x[0], atol=1e-9)
    np.testing.assert_allclose(found.x[:, 0], [0.0, 45.0, 0.0, 45.0], atol=1e-9)


def test_compensated_sides_give_about_the_same_ratio_to_the_truth():
    """Both were stitched in the same places; only the way that the foot went differs."""
    plain = track()
    offset = plain.nominal - plain.stitched
    ratios = []
    for path in (plain, track(offset=offset)):
        found = samples_of_paths([path])
        truth = true_compensation(found.x)
        ratios.append((found.s * truth).sum() / (truth**2).sum())
    assert found.relaxed == 4
    assert ratios[1] == pytest.approx(ratios[0], rel=0.1)


def test_what_cannot_be_taken_is_left_out_and_named():
    square = track()
    compensated = line(0.0)
    compensated = replace(compensated, offset=np.full_like(compensated.nominal, 1e-3))
    mixed = arc(0.0)
    end = mixed.nominal[-1] + np.outer(np.arange(1, 8), [3e-3, 0.0])
    points = np.concatenate([mixed.nominal, end])
    mixed = recorded(points, [0] * 10 + [1] * 7, [ARC] * 10 + [LINE] * 7, [1.2] * 10 + [0.0] * 7)
    uneven = replace(
        square, stitched=square.nominal - 2e-3 * np.random.default_rng(0).random((81, 2))
    )
    deep = line(0.0)
    deep = replace(deep, depth=np.full(17, 12.1e-3))
    found = samples_of_paths(
        [line(0.0, 30e-3), arc(0.0, turn=-1.2), deep, compensated, mixed, uneven]
    )
    said = dict(found.left_out)
    assert said.pop('single primitives shorter than 45 mm') == 1
    assert said.pop('arcs that turn right') == 1
    assert said.pop('depths of more than 0.8 of the thickness') == 1
    assert said.pop('later or compensated primitives of a path with arcs') == 1
    assert said.pop('later or compensated primitives of a path without two sides of 4 steps') == 1
    assert sum(said.values()) == 3
    (reason,) = said
    assert reason.startswith('later or compensated sides of a path whose')
    assert found.path.tolist() == [4, 5]  # the arc, and the first side


def test_no_path_gives_no_sample():
    found = samples_of_paths([])
    assert found.x.shape == (0, 5)
    assert found.s.shape == (0, 2)


def test_rows_that_share_a_label_belong_together():
    assert joined_groups([0, 1, 2, 0], [3, 3, 0, 1]).tolist() == [0, 0, 1, 0]
    assert joined_groups([0, 1, 2]).tolist() == [0, 1, 2]
    assert joined_groups([0, 1, 2, 3], [0, 0, 1, 1], [0, 1, 1, 2]).tolist() == [0, 0, 0, 0]

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The patterns that the operator of a simulated machine has it stitch, by name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import radians

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.deformation.stitch_path import ARC, Primitive
from fuzzycnc_ros.simulation.soft.foam_samples import (
    ARC_LENGTH,
    ARC_RADIUS,
    LINE_LENGTH,
    foam_samples,
)
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack

TRACK, CALIBRATION = 'parallelogram', 'calibration'
_SYNTAX = (
    'parallelogram:ANGLE or calibration[:COUNT], as parallelogram:45, '
    'parallelogram:30:thickness=0.02:depth=0.008 or calibration:40'
)
_TRACK = {'depth': 6e-3, 'step': 3e-3, 'base': 70e-3, 'side': 50e-3}
_SAMPLES_SEED = 0
"""Seed of the process values of calibration; what is stitched is drawn by the machine."""


@dataclass(frozen=True)
class PatternOnSheet:
    """A pattern and the sheet that it is stitched on."""

    name: str
    primitives: tuple[Primitive, ...]
    sheet: FoamSheet

    @property
    def length(self) -> float:
        """Nominal length [m]."""
        return sum(item.length for item in self.primitives)


def parse_patterns(names: Sequence[str], sheet: FoamSheet) -> list[PatternOnSheet]:
    """Return the patterns that names stand for.

    Parameters
    ----------
    names : sequence of str
        `parallelogram:ANGLE` with the interior angle in degrees: a closed track in the middle
        of the sheet, and behind it `thickness`, `depth`, `step`, `base` and
        `side` in metres where they differ, as `parallelogram:30:thickness=0.02:depth=0.008`; or
        `calibration:COUNT`: so many single lines and arcs spread over the 265 samples of
        `foam_samples`, thin sheets first, each from a fresh start in the middle of a sheet of
        200 x 120 mm; all of them without a count.
    sheet : FoamSheet
        Sheet for tracks that say nothing of it, and friction of all.

    Raises
    ------
    ValueError
        If a name is none of these.
    """
    found: list[PatternOnSheet] = []
    for name in names:
        kind, *words = name.split(':')
        try:
            if kind == TRACK and words:
                found.append(_track(name, words, sheet))
            elif kind == CALIBRATION and len(words) <= 1:
                found += _calibration(words, sheet)
            else:
                raise ValueError(f'expected {_SYNTAX}')
        except ValueError as error:
            raise ValueError(f'patterns: {name!r}: {error}') from error
    return found


def track_of(name: str, sheet: FoamSheet) -> FoamTrack:
    """Return the closed track that a name `parallelogram:...` stands for.

    Raises
    ------
    ValueError
        If it is none.
    """
    kind, *words = name.split(':')
    if kind != TRACK or not words:
        raise ValueError(f'{name!r}: expected {TRACK}:ANGLE')
    return _foam_track(words[0], _settings(words[1:], sheet), sheet)


def _foam_track(angle: str, values: Mapping[str, float], sheet: FoamSheet) -> FoamTrack:
    return FoamTrack.parallelogram(
        radians(_number(angle, 'an angle in degrees')),
        values['base'],
        values['side'],
        centre=(0.5 * sheet.size[0], 0.5 * sheet.size[1]),
        step=values['step'],
    )


def _track(name: str, words: Sequence[str], sheet: FoamSheet) -> PatternOnSheet:
    values = _settings(words[1:], sheet)
    track = _foam_track(words[0], values, sheet)
    corners = [(float(x), float(y)) for x, y in track.points[list(track.corners)]]
    sides = tuple(
        Primitive(start, end, values['depth'], values['step']) for start, end in pairwise(corners)
    )
    own = FoamSheet(values['thickness'], sheet.size, friction=sheet.friction)
    return PatternOnSheet(name, sides, own)


def _settings(words: Sequence[str], sheet: FoamSheet) -> dict[str, float]:
    values = {**_TRACK, 'thickness': sheet.thickness}
    for word in words:
        key, equals, value = word.partition('=')
        if key not in values or not equals:
            raise ValueError(f'expected {", ".join(values)} as depth=0.008 but found {word!r}')
        values[key] = _number(value, f'{key} in m')
    return values


def _calibration(words: Sequence[str], sheet: FoamSheet) -> list[PatternOnSheet]:
    rows = foam_samples(_SAMPLES_SEED).x
    count = len(rows)
    if words:
        number = _number(words[0], 'a number of samples')
        if not (number.is_integer() and 1 <= number <= count):
            raise ValueError(f'expected 1 to {count} samples but found {words[0]}')
        count = int(number)
    chosen = np.linspace(0, len(rows) - 1, count).round().astype(int)
    found = []
    for number, index in enumerate(chosen.tolist()):
        angle, depth, kind, step, thickness = rows[index].tolist()
        own = FoamSheet(1e-3 * thickness, friction=sheet.friction)
        primitive = sample_primitive(angle, 1e-3 * depth, kind, 1e-3 * step, own)
        found.append(PatternOnSheet(f'{CALIBRATION}_{number + 1}', (primitive,), own))
    return found


def sample_primitive(
    angle: float, depth: float, kind: float, step: float, sheet: FoamSheet
) -> Primitive:
    """Return the primitive of a sample, the middle of which lies in the middle of its sheet.

    Parameters
    ----------
    angle : float
        Direction in the middle [deg].
    depth, step : float
        Feed depth and stitch step [m].
    kind : float
        1 arc, 2 line.
    sheet : FoamSheet
        The sheet.
    """
    middle = complex(0.5 * sheet.size[0], 0.5 * sheet.size[1])
    along = complex(portable.cos(radians(angle)), portable.sin(radians(angle)))
    if kind != ARC:
        half = 0.5 * LINE_LENGTH * along
        return Primitive(_pair(middle - half), _pair(middle + half), depth, step)
    centre = middle + 1j * ARC_RADIUS * along
    turn = ARC_LENGTH / ARC_RADIUS
    half_turn = complex(portable.cos(0.5 * turn), portable.sin(0.5 * turn))
    arm = middle - centre
    return Primitive(
        _pair(centre + arm / half_turn),
        _pair(centre + arm * half_turn),
        depth,
        step,
        _pair(centre),
        turn,
    )


def _pair(place: complex) -> tuple[float, float]:
    return place.real, place.imag


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f'expected {what} but found {text!r}') from None

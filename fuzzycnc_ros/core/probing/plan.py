# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A probing cycle: places along the axes, the touches that measure each, the box they stay in.

All coordinates are machine coordinates of the probe tip, as the control shows them with the probe
in the spindle.
"""

import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from math import copysign
from typing import Any

PROBED_AXES = ('X', 'Y', 'Z')
SIGNATURES = 1_000_000
"""Number of signatures: what every control can pass on as a number without rounding it."""
DOWN_LEAST = 1e-4
"""Least way down to a start [m]: a control refuses to probe along no way at all."""

Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Touch:
    """Way of the probe onto a surface.

    Attributes
    ----------
    start : tuple of float
        Where the probe stands before [m].
    surface : float
        Where the centre of its tip is expected at the touch, along the axis of the place [m].
    end : float
        Where the search ends [m].
    """

    start: Corner
    surface: float
    end: float


@dataclass(frozen=True)
class Place:
    """Place along an axis, measured by a touch or by the mean of two from both sides.

    Attributes
    ----------
    name : str
        Name of its artefact.
    axis : str
        Axis along which it is measured.
    position : float
        Its nominal coordinate [m].
    touches : tuple of Touch
        One or two.
    """

    name: str
    axis: str
    position: float
    touches: tuple[Touch, ...]


@dataclass(frozen=True)
class ProbePlan:
    """Probing cycle.

    Attributes
    ----------
    places : tuple of Place
        Places in the order in which they are probed.
    box : mapping of str to (float, float)
        Lower and upper end of each axis; the probe leaves it nowhere [m].
    travel_height : float
        Z at which it moves across [m].
    approach_feed, feed : float
        Feed of the first touch and of the ways between, and of the touches that count [m/s].
    back_off : float
        Way back between two touches [m].
    repeats : int
        Touches of a side that count.
    tool : int
        Number of the probe in the tool table; 0 if it is not checked.

    Raises
    ------
    ValueError
        If the probe would leave the box, or a place cannot be measured.
    """

    places: tuple[Place, ...]
    box: Mapping[str, tuple[float, float]]
    travel_height: float
    approach_feed: float
    feed: float
    back_off: float
    repeats: int
    tool: int = 0

    def __post_init__(self) -> None:
        if not self.places:
            raise ValueError('expected a place to probe but found none')
        for place in self.places:
            for touch in place.touches:
                for where, point in self._corners(place, touch):
                    self._check(f'{place.name}, {place.axis}: {where}', point)
                if self.travel_height - touch.start[2] < DOWN_LEAST:
                    raise ValueError(
                        f'{place.name}, {place.axis}: expected a start below travel_height '
                        f'{1e3 * self.travel_height:g} mm but found Z {1e3 * touch.start[2]:g} mm'
                    )

    def _corners(self, place: Place, touch: Touch) -> Iterator[tuple[str, Corner]]:
        """Yield the ends of all straight ways of a touch.

        A touch that counts may begin and end by `back_off` beside the first one, wherever in the
        search that one was.
        """
        x, y, _ = touch.start
        yield 'the way across', (x, y, self.travel_height)
        column = PROBED_AXES.index(place.axis)
        way = copysign(self.back_off, touch.end - touch.start[column])
        for where, along in (
            ('the start', touch.start[column] - way),
            ('the end of the search', touch.end + way),
        ):
            end = list(touch.start)
            end[column] = along
            yield where, (end[0], end[1], end[2])

    def _check(self, where: str, point: Corner) -> None:
        for axis, value in zip(PROBED_AXES, point, strict=True):
            low, high = self.box[axis]
            if not low <= value <= high:
                raise ValueError(
                    f'{where}: expected {axis} within the box, {1e3 * low:g} to {1e3 * high:g} '
                    f'mm, but found {1e3 * value:g} mm; move the artefact or widen the box'
                )

    @property
    def touches(self) -> tuple[tuple[int, Place, Touch], ...]:
        """All touches with their place and the number before the first of their repeats."""
        sides = [(place, touch) for place in self.places for touch in place.touches]
        return tuple((self.repeats * i, *side) for i, side in enumerate(sides))

    @property
    def count(self) -> int:
        """Number of touches that count in a cycle."""
        return self.repeats * len(self.touches)

    def place_of(self, number: int) -> Place:
        """Return the place of a touch that counts, by its number from 1 to `count`."""
        _, place, _ = self.touches[(number - 1) // self.repeats]
        return place

    @property
    def axes(self) -> tuple[str, ...]:
        """Axis of each place."""
        return tuple(place.axis for place in self.places)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channel of each place: its axis, and for further places along it the name too."""
        return tuple(
            place.axis if place.axis not in self.axes[:i] else f'{place.axis} {place.name}'
            for i, place in enumerate(self.places)
        )

    @property
    def signature(self) -> int:
        """Number by which results tell which plan their program was written from."""
        return zlib.crc32(self.to_json().encode()) % (SIGNATURES - 1) + 1

    def to_json(self) -> str:
        """Return the plan as text."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> 'ProbePlan':
        """Read what `to_json` has written.

        Raises
        ------
        ValueError
            If it is none.
        """
        try:
            found: dict[str, Any] = json.loads(text)
            places = tuple(
                Place(
                    **{name: item[name] for name in ('name', 'axis', 'position')},
                    touches=tuple(
                        Touch(tuple(way['start']), way['surface'], way['end'])
                        for way in item['touches']
                    ),
                )
                for item in found.pop('places')
            )
            box = {axis: tuple(ends) for axis, ends in found.pop('box').items()}
            return cls(places=places, box=box, **found)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f'expected a plan of a probing cycle but found {error}') from error

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says what is probed: artefacts, and the box in which the probe moves."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from fuzzycnc_ros.adapters.yaml_model import (
    Choice,
    Field,
    Fields,
    Number,
    Numbers,
    Text,
    model_validator,
    read_file,
    wrong,
)
from fuzzycnc_ros.core.probing.plan import PROBED_AXES, Corner, Place, ProbePlan, Touch
from fuzzycnc_ros.ros.parameters import ParameterError

MM = 1e-3
MINUTE = 60.0
FACES = tuple(f'{axis}{sign}' for axis in PROBED_AXES for sign in '+-')
KINDS = ('sphere', 'ring', 'block', 'setter')
SPAN_MAX = 1e5
"""Largest coordinate [mm]."""

_Length = Annotated[float, Number(1e-3, 1e4, 'mm')]
_Feed = Annotated[float, Number(1.0, 1e4, 'mm/min')]


class _Artefact(Fields):
    name: Annotated[str, Text()] = Field(description='Name, kept in channels and messages')
    kind: Annotated[str, Choice(KINDS)] = Field(
        description='sphere; ring: bore with its axis along Z; block: one face; setter: from above'
    )
    at: Annotated[tuple[float, ...], Numbers()] = Field(
        description='Machine coordinates X, Y, Z of the tip at its centre, or on its face [mm]'
    )
    diameter: Annotated[float, Number(0.0, 1e4, 'mm')] = Field(
        0.0, description='Diameter of a sphere or of the bore of a ring [mm]'
    )
    axes: Annotated[str, Text('[XYZ]{1,3}')] = Field(
        '', description='Axes to measure, such as XZ; all that it has if left out'
    )
    face: Annotated[str, Choice(FACES)] = Field(
        'Z+', description='Face of a block that is touched: the way in which it looks'
    )

    @model_validator(mode='after')
    def _check(self) -> '_Artefact':
        if len(self.at) != 3 or not all(abs(value) <= SPAN_MAX for value in self.at):
            raise wrong('expected three coordinates, such as [50, 40, -120]', 'at')
        round_one = self.kind in ('sphere', 'ring')
        if round_one != (self.diameter > 0.0):
            raise wrong(f'expected {"a" if round_one else "no"} diameter of a {self.kind}', 'kind')
        unknown = [axis for axis in self.axes if axis not in self.measured]
        if unknown or len(set(self.axes)) != len(self.axes):
            raise wrong(
                f'expected some of {"".join(self.measured)}, each once, for a {self.kind} but '
                f'found {self.axes}',
                'axes',
            )
        return self

    @property
    def measured(self) -> tuple[str, ...]:
        """Axes that its kind has."""
        return {
            'sphere': PROBED_AXES,
            'ring': PROBED_AXES[:2],
            'block': (self.face[0],),
            'setter': PROBED_AXES[2:],
        }[self.kind]


class ProbeFields(Fields):
    """Surfaces to probe, and the box in which the probe moves; lengths in mm."""

    box: dict[str, Annotated[tuple[float, ...], Numbers()]] = Field(
        description='Lower and upper end of each axis, machine coordinates [mm]'
    )
    travel_height: Annotated[float, Number(-SPAN_MAX, SPAN_MAX, 'mm')] = Field(
        description='Z at which the probe moves across [mm]'
    )
    tip: _Length = Field(description='Diameter of the tip [mm]')
    clearance: _Length = Field(3.0, description='Way from a start to the surface [mm]')
    overtravel: _Length = Field(
        1.0, description='Way beyond the surface up to which it is looked for [mm]'
    )
    back_off: _Length = Field(0.5, description='Way back between two touches [mm]')
    approach_feed: _Feed = Field(300.0, description='Feed down and of first touches [mm/min]')
    feed: _Feed = Field(30.0, description='Feed of the touches that count [mm/min]')
    repeats: Annotated[int, Number(1, 20, whole=True)] = Field(
        3, description='Touches of a side that count; their spread is the noise'
    )
    tool: Annotated[int, Number(0, 99999, whole=True)] = Field(
        0, description='Tool number of the probe; 0: the program does not look'
    )
    artefacts: list[_Artefact] = Field(description='What is probed, in this order')

    @model_validator(mode='after')
    def _check(self) -> 'ProbeFields':
        if set(self.box) != set(PROBED_AXES):
            raise wrong('expected the two ends of X, Y and Z', 'box')
        for axis, ends in self.box.items():
            if len(ends) != 2 or not -SPAN_MAX <= ends[0] < ends[1] <= SPAN_MAX:
                raise wrong('expected two ends, the lower one first, as [0, 300]', 'box', axis)
        if self.back_off >= self.clearance:
            raise wrong('expected less than clearance', 'back_off')
        names = [item.name for item in self.artefacts]
        if len(set(names)) != len(names):
            raise wrong('expected another name for each artefact', 'artefacts')
        least = self.tip + self.clearance + self.overtravel
        for item in self.artefacts:
            if item.kind == 'ring' and item.diameter <= least:
                raise wrong(
                    f'{item.name}: expected a bore of over {least:g} mm, in which the tip and its '
                    f'way fit, but found {item.diameter:g} mm; make clearance or overtravel '
                    'smaller',
                    'artefacts',
                )
        return self

    def plan(self) -> ProbePlan:
        """Return the cycle.

        Raises
        ------
        ValueError
            If the probe would leave the box, or there is nothing to probe.
        """
        return ProbePlan(
            places=tuple(place for item in self.artefacts for place in self._places(item)),
            box={axis: (MM * ends[0], MM * ends[1]) for axis, ends in self.box.items()},
            travel_height=MM * self.travel_height,
            approach_feed=MM * self.approach_feed / MINUTE,
            feed=MM * self.feed / MINUTE,
            back_off=MM * self.back_off,
            repeats=self.repeats,
            tool=self.tool,
        )

    def _places(self, item: _Artefact) -> Iterator[Place]:
        for axis in item.axes or item.measured:
            column = PROBED_AXES.index(axis)
            touches = tuple(self._touch(item, column, sign) for sign in self._sides(item, column))
            yield Place(item.name, axis, MM * item.at[column], touches)

    def _sides(self, item: _Artefact, column: int) -> tuple[int, ...]:
        """Return from which sides of the surface the probe comes along an axis."""
        if item.kind == 'block':
            return (1 if item.face[1] == '+' else -1,)
        return (1,) if column == 2 else (-1, 1)

    def _touch(self, item: _Artefact, column: int, sign: int) -> Touch:
        """Return the touch of a surface from the side of `sign`; in a bore from within."""
        radius, tip = item.diameter / 2.0, self.tip / 2.0
        if item.kind == 'sphere':
            surface = item.at[column] + sign * (radius + tip)
        elif item.kind == 'ring':
            sign = -sign
            surface = item.at[column] - sign * (radius - tip)
        else:
            surface = item.at[column]
        start = list(item.at)
        start[column] = surface + sign * self.clearance
        at: Corner = (MM * start[0], MM * start[1], MM * start[2])
        return Touch(at, MM * surface, MM * (surface - sign * self.overtravel))


def read_plan(path: Path) -> ProbePlan:
    """Read and check a file of a probing cycle.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    ParameterError
        If something in it is missing, unknown, out of bounds, or the probe would leave the box.
    """
    fields = read_file(path, ProbeFields, 'a file of a probing cycle')
    try:
        return fields.plan()
    except ValueError as error:
        raise ParameterError(f'{path}: {error}') from error

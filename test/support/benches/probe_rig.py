# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A component `probe_cycle`, and a probe that touches where the thermal error puts things."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from benches.component_bench import Bench, applied

from fuzzycnc_ros.components.probing.probe_cycle import ProbeCycle, ProbeCycleConfig
from fuzzycnc_ros.core.probing.plan import Place, ProbePlan, Touch
from fuzzycnc_ros.runtime.enums import TouchKind
from fuzzycnc_ros.runtime.records import (
    ProbeStatus,
    ProbeTouch,
    ThermalReference,
    nanoseconds,
)

MM, MICRON = 1e-3, 1e-6
BOX = {'X': (0.0, 0.3), 'Y': (-0.2, 0.0), 'Z': (-0.15, -0.005)}


def reference_at(stamp: int) -> ThermalReference:
    """Return a thermal reference that is taken at a stamp [ns]."""
    return ThermalReference(
        stamp=stamp,
        cold_since=stamp,
        set_by='test',
        sensor=('T1',),
        temperature=np.array([20.0]),
        samples=3,
    )


def sphere() -> ProbePlan:
    """Return a cycle on a sphere: Y from both sides, Z from above."""
    ways = (
        Touch((0.05, -0.0585, -0.12), -0.0555, -0.0545),
        Touch((0.05, -0.0215, -0.12), -0.0245, -0.0255),
    )
    down = Touch((0.05, -0.04, -0.1015), -0.1045, -0.1055)
    return ProbePlan(
        places=(Place('left', 'Y', -0.04, ways), Place('left', 'Z', -0.12, (down,))),
        box=BOX,
        travel_height=-0.01,
        approach_feed=0.005,
        feed=0.0005,
        back_off=0.0005,
        repeats=3,
    )


def two_blocks() -> ProbePlan:
    """Return a cycle on two faces, at either end of Y."""
    places = tuple(
        Place(f'at {y}', 'Y', y, (Touch((0.05, y + 0.003, -0.12), y, y - 0.001),))
        for y in (-0.03, -0.17)
    )
    return replace(sphere(), places=places)


class ProbeRig(Bench):
    """A probing cycle with a machine around it, in seconds and micrometres.

    Attributes
    ----------
    error : mapping of str to float
        Thermal error of each axis [um].
    offset, slope : list of float
        Offsets in force on Y and Z at zero [um], and their slopes [um/m].
    applied : CompensationApplied
        The last read-back.
    includes_offset : bool
        Whether the control tells coordinates with the offset in force.
    """

    def __init__(self, *, plan: ProbePlan | None = None, **changes: Any) -> None:
        super().__init__(ProbeCycle(ProbeCycleConfig(**changes)))
        self.plan = plan or sphere()
        self.error: Mapping[str, float] = {'Y': 0.0, 'Z': 0.0}
        self.offset, self.slope = [0.0, 0.0], [0.0, 0.0]
        self.includes_offset = False
        self.time = 1000.0
        assert self.request('use_plan', plan=self.plan.to_json()).success

    def reference(self) -> None:
        """Take the thermal reference now."""
        self.give('thermal_reference', reference_at(nanoseconds(self.time)))

    def ask(self, due: bool, reason: str = 'the band is wide') -> None:
        """Tell what the predictor wants."""
        self.give('probe_status', status(nanoseconds(self.time), due=due, reason=reason))

    def tell(self, kind: TouchKind, number: int, position: float = np.nan) -> None:
        """Tell a touch, two seconds later."""
        self.time += 2.0
        self.applied = applied(
            self.time,
            MICRON * np.array(self.offset),
            slope=MICRON * np.array(self.slope),
            position=np.zeros(2),
        )
        self.push('compensation_applied', self.applied)
        stamp = nanoseconds(self.time)
        if self.includes_offset and kind is TouchKind.TOUCH:
            position += self.applied.offset_at(self.plan.place_of(number).axis, position)
        record = ProbeTouch(
            stamp=stamp,
            kind=int(kind),
            number=number,
            position=position,
            includes_offset=self.includes_offset,
        )
        self.give('probe_touch', record)

    def begin(self) -> None:
        """Begin a cycle."""
        self.tell(TouchKind.BEGIN, self.plan.signature)

    def touch(self, number: int, wrong: float = 0.0) -> None:
        """Make a touch, wrong by so much [um] along its axis."""
        _, place, touch = self.plan.touches[(number - 1) // self.plan.repeats]
        # What the tool is off the workpiece the machine has gone less far.
        column = 'YZ'.index(place.axis)
        moved = self.error[place.axis] + self.offset[column] + self.slope[column] * touch.surface
        self.tell(TouchKind.TOUCH, number, touch.surface - MICRON * (moved - wrong))

    def cycle(self, wrong: Mapping[int, float] | None = None) -> None:
        """Run a cycle; `wrong` [um] by the number of the touch."""
        self.begin()
        for number in range(1, self.plan.count + 1):
            self.touch(number, (wrong or {}).get(number, 0.0))
        self.tell(TouchKind.END, 0)

    @property
    def state(self) -> Any:
        """The newest state."""
        return self.records('probe_cycle_state')[-1]

    @property
    def probes(self) -> list[Any]:
        """Displacements so far."""
        return self.records('displacement')


def status(stamp: int, *, due: bool, reason: str = 'the band is wide') -> ProbeStatus:
    """Return what the predictor wants."""
    return ProbeStatus(
        stamp=stamp,
        due=due,
        reason=reason,
        due_at=0,
        probed_at=0,
        axis=('Y', 'Z'),
        channel=('Y', 'Z'),
        band=np.ones(2),
        change=np.ones(2),
    )


def zeroed(**changes: Any) -> ProbeRig:
    """Return a rig that has its zero."""
    rig = ProbeRig(**changes)
    rig.reference()
    rig.cycle()
    return rig

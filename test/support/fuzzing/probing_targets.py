# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The probing cycle at work."""

from benches.component_bench import applied
from benches.probe_rig import MICRON, ProbeRig, status, zeroed
from fuzzing.targets import CopiedTarget

from fuzzycnc_ros.runtime.enums import TouchKind
from fuzzycnc_ros.runtime.records import (
    SECOND,
    ProbeTouch,
    ThermalReference,
    nanoseconds,
)


class ProbeCycleTarget(CopiedTarget):
    """A cycle that has its zero."""

    component = 'probe_cycle'
    inputs = ('thermal_reference', 'compensation_applied', 'probe_status', 'probe_touch')
    start = 2000 * SECOND

    def make(self) -> ProbeRig:
        return zeroed()

    def good(self, name, stamp, rng):
        rig = self.prepared
        if name == 'thermal_reference':
            found = rig.component.last(rig.component.REFERENCE)
            return ThermalReference(**{**vars(found), 'stamp': stamp})
        if name == 'compensation_applied':
            return applied(stamp / SECOND)
        if name == 'probe_status':
            return status(stamp, due=rng.random() < 0.5)
        number = rng.randrange(10)
        return ProbeTouch(
            stamp=stamp,
            kind=rng.randrange(4),
            number=number,
            position=0.0,
            includes_offset=rng.random() < 0.5,
        )

    def recover(self, bench, stamp):
        bench.time = stamp / SECOND + 7200.0
        bench.error, bench.offset = {'Y': 0.0, 'Z': 0.0}, [0.0, 0.0]
        bench.reference()
        bench.tell(TouchKind.END, 0)
        bench.cycle()
        bench.error = {'Y': 3.0, 'Z': -4.0}
        bench.cycle()
        found = bench.probes[-1]
        assert found.stamp > nanoseconds(7200.0)
        assert abs(found.displacement / MICRON - [3.0, -4.0]).max() < 1e-6

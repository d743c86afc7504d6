# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Patterns on the simulated soft sheet: compensated, scheduled and stitched, in one process.

The components, their order of turns and the requests are those of a live lock-step graph, so
that both give the same outputs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.machine.machine_patterns import track_of
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.soft.deformation_compensator import (
    DeformationCompensator,
    DeformationCompensatorConfig,
)
from fuzzycnc_ros.runtime.graph import Sink
from fuzzycnc_ros.runtime.records import CompensatedPath, Material, StitchedPath
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.soft.foam_tracks import TrackQuality
from fuzzycnc_ros.studies.evaluated_graph import judged_graph
from fuzzycnc_ros.studies.record_log import RecordLog

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StitchedPattern:
    """A pattern as it was commanded and stitched; n + 1 stitches.

    Attributes
    ----------
    name : str
        Name of the pattern.
    path : CompensatedPath
        What was commanded: points, offsets, flags and the process values of the steps.
    size : tuple of float
        Lengths of the sheet along X and Y [m].
    time : ndarray, shape (n + 1,)
        Time since the first stitch [s].
    tool : ndarray, shape (n + 1, 2)
        Where the tool was at each stitch [m]; NaN where nobody measured it.
    stitched : ndarray, shape (n + 1, 2)
        Where the stitches lie [m].
    """

    name: str
    path: CompensatedPath
    size: tuple[float, float]
    time: Floats
    tool: Floats
    stitched: Floats

    @property
    def nominal(self) -> Floats:
        """Nominal positions of the stitches [m], shape (n + 1, 2)."""
        return self.path.nominal.reshape(-1, 2)

    @property
    def commanded(self) -> Floats:
        """Commanded positions of the needle [m], shape (n + 1, 2)."""
        return (self.path.nominal + self.path.offset).reshape(-1, 2)

    @property
    def deviation(self) -> Floats:
        """Distance of the stitches from where they are to lie [m], shape (n + 1,)."""
        return np.asarray(np.hypot(*(self.stitched - self.nominal).T))

    @property
    def primitive_time(self) -> Floats:
        """Time from the first to the last stitch of each primitive, with the rest at its end [s].

        A primitive begins with the last stitch of the one before.
        """
        last = np.flatnonzero(np.append(np.diff(self.path.primitive.astype(int)) != 0, True)) + 1
        return np.diff(self.time[np.append(0, last)])

    def quality(self) -> TrackQuality:
        """Return how well a closed track was stitched, its time as measured.

        Raises
        ------
        ValueError
            If the pattern is none of the machine's own tracks, in the middle of its sheet.
        """
        name = self.name.partition('_')[0]  # one that came again has a number
        track = track_of(name, FoamSheet(self.path.thickness, self.size))
        found = track.measure(self.stitched, self.tool)
        return found._replace(time=float(self.primitive_time.mean()))


class PatternLog(RecordLog):
    """The records of stitching; a sink for `InProcessGraph`, or read from a bag."""

    TOPICS = MappingProxyType(
        {
            'material': Material,
            'compensated_path': CompensatedPath,
            'stitched_path': StitchedPath,
        }
    )
    REQUIRED = ('compensated_path', 'stitched_path', 'material')

    def patterns(self) -> tuple[StitchedPattern, ...]:
        """Return the patterns that were stitched, in the order in which they were finished.

        Raises
        ------
        ValueError
            If the stitches of one are not those of the path that was commanded.
        """
        return tuple(self._joined(item) for item in self._records['stitched_path'])

    def _joined(self, stitched: StitchedPath) -> StitchedPattern:
        """Return the stitches with the newest path of their name before them."""
        paths = [
            item
            for item in self._between('compensated_path', 0, stitched.stamp + 1)
            if item.path_id == stitched.path_id
        ]
        if not paths or len(paths[-1].nominal) != len(stitched.stitched):
            raise ValueError(
                f'stitched_path of {stitched.path_id}: expected as many stitches as the '
                'compensated_path of that name before it has, but found '
                f'{len(stitched.stitched) // 2}; record both topics from the start'
            )
        return StitchedPattern(
            name=stitched.path_id,
            path=paths[-1],
            size=self._size(paths[-1].stamp),
            time=stitched.time,
            tool=stitched.tool.reshape(-1, 2),
            stitched=stitched.stitched.reshape(-1, 2),
        )

    def _size(self, stamp: int) -> tuple[float, float]:
        """Return the size of the sheet that lay there at machine time `stamp` [ns]."""
        sheets = self._between('material', 0, stamp + 1)
        if not sheets or len(sheets[-1].size) != 2:
            raise ValueError('material: expected a sheet of known size before its first pattern')
        x, y = sheets[-1].size.tolist()
        return x, y


TRACK = 'parallelogram:45'
"""The test track: a parallelogram like that of [deng2014]."""
STITCH_BLEND = 10e-6
"""Blend at a stitch within a primitive [m]; at 0 the tool would stop at each."""


class PatternError(RuntimeError):
    """A pattern was not stitched to its end; the text names it and says why."""


def run_patterns(
    patterns: Sequence[str] = (TRACK,),
    model: str = '',
    *,
    offsets: str = '',
    compensator: DeformationCompensatorConfig | None = None,
    scheduler: FeedrateSchedulerConfig | None = None,
    machine: SimulatedMachineConfig | None = None,
    name: str = 'mill',
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[StitchedPattern, ...]:
    """Have the simulated machine stitch patterns, one after the other.

    Parameters
    ----------
    patterns : sequence of str
        Patterns as parameter `patterns` of `simulated_machine` takes them.
    model, offsets : str
        Text of a model file and of learnt offsets; empty for none.
    compensator : DeformationCompensatorConfig, optional
        How outputs of the model become offsets.
    scheduler : FeedrateSchedulerConfig, optional
        Method, tolerance and limits; by default its own with `STITCH_BLEND`.
    machine : SimulatedMachineConfig, optional
        The machine; its duties, paths and patterns are replaced.
    name : str
        Name of the machine, the first part of all frame ids.
    sink : callable, optional
        Takes every published record, configurations, requests and turns included.
    progress : callable, optional
        Told ticks done and in all; an exception that it raises ends the run.

    Returns
    -------
    tuple of StitchedPattern
        One per pattern, as `PatternLog.from_bag` gives for a bag of the run.

    Raises
    ------
    ValueError
        If a pattern is unknown, a file no model or offsets, or parameters do not fit each other.
    PatternError
        If a pattern was not stitched to its end.
    """
    settings = machine or SimulatedMachineConfig()
    mill = SimulatedMachine(replace(settings, duties=(), paths=(), patterns=tuple(patterns)))
    shifter = DeformationCompensator(compensator)
    planner = FeedrateScheduler(scheduler or FeedrateSchedulerConfig(blend=STITCH_BLEND))
    log = PatternLog()
    graph = judged_graph(mill, [shifter, planner], log, sink, name)
    for what, text in (('model', model), ('offsets', offsets)):
        if text:
            answer = graph.request(shifter.NAME, f'use_{what}', **{what: text})
            if not answer.success:
                raise ValueError(f'{what}: {answer.message}')
    for component in (shifter, planner):
        graph.request(component.NAME, 'activate')
    graph.run(progress)
    if mill.failure:
        said = '; '.join(
            f'{component.NAME}: {item.message}'
            for component in (shifter, planner)
            for item in component.health()
        )
        raise PatternError(f'{mill.failure} {said}')
    return log.patterns()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Patterns on the simulated soft sheet: compensated, scheduled and stitched, in one process.

The components, their order of turns and the requests are those of a live lock-step graph, so
that both give the same outputs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

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
from fuzzycnc_ros.studies.evaluated_graph import judged_graph
from fuzzycnc_ros.studies.soft.pattern_log import PatternLog, StitchedPattern

TRACK = 'parallelogram:45'
"""Test track of method sheet 000 section 8."""
STITCH_BLEND = 10e-6
"""How far the tool may pass by a stitch within a primitive [m]; at 0 it would stop at each."""


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

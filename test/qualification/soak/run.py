# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The thermal graph for hundreds of hours of machine time, in this process, and what of it grows.

The mill runs two duties in turn, one a day from cold, a tick a minute; hours count while a duty
runs.  Nothing is kept of what is published but its hash, so that what grows belongs to the graph.
"""

import gc
import hashlib
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.canonical import combined_hash, topic_hashes
from fuzzycnc_ros.bags.typestore import ROSBAGS
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.component import Component
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.graph import InProcessGraph
from fuzzycnc_ros.runtime.records import Record
from fuzzycnc_ros.simulation.thermal.duties import DUTIES
from soak.growth import (
    GROWTH_MAX,
    LATENCY_GROWTH_MAX,
    Growth,
    growths,
    held_by,
)

TICK = 60.0
"""Machine time of a tick [s]."""

SOAK_DUTIES = ('T2', 'T3')
"""Duties that are run in turn."""

CYCLE = round(sum(DUTIES[name].duration for name in SOAK_DUTIES) / TICK)
"""Ticks after which the same duty begins again."""

SEGMENT = 100
"""Ticks between two samples; what they published is kept so long, to be hashed."""

WARM_UP = 0.1
"""Share of the ticks that is warm-up [-], one cycle of duties at least."""

TICKS_MIN = 2 * CYCLE

EVERY_TICK = ('machine_state', 'sensor_readings', 'temperatures', 'thermal_error', 'compensation')
"""Topics on which every tick brings a message with its stamp."""

HELD = ('memory [MiB]', 'Python blocks', 'threads', 'open files')
"""Figures of the process."""

Progress = Callable[[int, int], None]
"""Told ticks done and in all."""


@dataclass(frozen=True, eq=False)
class SoakRun:
    """What came of a soak.

    Parameters
    ----------
    ticks : int
        Ticks of the machine.
    figures : tuple of str
        Names of the columns of `samples`, with the unit; times end with [us] or [ms].
    samples : ndarray, shape (n, k)
        One row every so often.
    settled : int
        First row after the warm-up.
    missed : mapping of str to int
        Messages that were published and not taken, by `component input`, and ticks without an
        answer, by topic; only what is not zero.
    hashes : ndarray of bytes
        Canonical hash of what was published in each part of the run; all parts are equally long.
    """

    ticks: int
    figures: tuple[str, ...]
    samples: NDArray[np.float64]
    settled: int
    missed: Mapping[str, int]
    hashes: NDArray[np.bytes_]

    @property
    def hash(self) -> str:
        """One hash of all parts."""
        return hashlib.sha256(b''.join(self.hashes.tolist())).hexdigest()

    @property
    def growths(self) -> tuple[Growth, ...]:
        """How each figure changed after the warm-up."""
        limits = [
            LATENCY_GROWTH_MAX if name.endswith(('[us]', '[ms]')) else GROWTH_MAX
            for name in self.figures
        ]
        return growths(self.figures, self.samples[self.settled :], limits)

    @property
    def problems(self) -> list[str]:
        """What is wrong, a line each."""
        found = [
            f'{item.name} grew by {100.0 * item.growth:.1f} %, from {item.before:.6g} to '
            f'{item.after:.6g}'
            for item in self.growths
            if item.grows
        ]
        return found + [f'{name}: {count} missed' for name, count in self.missed.items()]

    def parts_at(self, other: 'SoakRun') -> float | None:
        """Return the hour of machine time up to which another run is equal; None if all of it is.

        Raises
        ------
        ValueError
            If the other run is of another length.
        """
        if self.hashes.shape != other.hashes.shape:
            raise ValueError(f'expected a run of {self.ticks} ticks but found {other.ticks}')
        differs = np.flatnonzero(self.hashes != other.hashes)
        hours = self.ticks * TICK / 3600.0
        return None if len(differs) == 0 else float(differs[0]) / len(self.hashes) * hours


class SoakGraph(InProcessGraph):
    """A graph that hashes what is published, times its stages, and counts what gets lost."""

    def __init__(self, machine: SimulatedMachine, components: Sequence[Component]) -> None:
        super().__init__(machine, components, sink=self._take)
        self.stages = (machine.NAME, *(item.NAME for item in components))
        self._took = np.zeros((SEGMENT, len(self.stages)))
        self._row = self._column = 0
        self._since = 0.0
        self._published: dict[str, int] = {}
        self._newest: dict[str, int] = {}
        self._unanswered = dict.fromkeys(EVERY_TICK, 0)
        self._kept: list[tuple[str, str, int, Any]] = []

    def step(self) -> int:
        """Run one tick; note how long each stage took and whether all answered.

        Counted is the processor's time, which other work on the host does not change.
        """
        self._column, self._since = 0, time.thread_time()
        stamp = super().step()
        self._end_stage()
        self._row += 1
        for topic in EVERY_TICK:
            self._unanswered[topic] += self._newest.get(topic) != stamp
        return stamp

    def segment(self) -> tuple[str, NDArray[np.float64]]:
        """Return hash and median times [s] since the last call, and begin anew."""
        digest = combined_hash(topic_hashes(self._kept))
        took = np.median(self._took[: self._row], axis=0)
        self._kept.clear()
        self._row = 0
        return digest, took

    def missed(self) -> dict[str, int]:
        """Return what was lost: by component and input, and ticks without an answer by topic."""
        lost = {topic: count for topic, count in self._unanswered.items() if count}
        for merger in self._mergers.values():
            for item in merger.component.INPUTS:
                count = merger.counts[item.name]
                untaken = self._published.get(item.name, 0) - count.received
                late = count.late if item.driving else 0
                total = untaken + count.dropped + count.refused + late
                if total:
                    lost[f'{merger.component.NAME} {item.name}'] = total
        return lost

    def _note_turn(self, node: str, stamp: int) -> None:
        """End the stage before a component's turn."""
        self._end_stage()
        super()._note_turn(node, stamp)

    def _end_stage(self) -> None:
        now = time.thread_time()
        self._took[self._row, self._column] = now - self._since
        self._column, self._since = self._column + 1, now

    def _take(self, topic: str, record: Record) -> None:
        self._published[topic] = self._published.get(topic, 0) + 1
        self._newest[topic] = record.stamp
        self._kept.append((topic, record.TYPE, record.stamp, encode(record, ROSBAGS)))


def run_soak(
    model_text: str,
    ticks: int,
    seed: int = 0,
    *,
    replaced: Mapping[str, type[Component]] | None = None,
    progress: Progress | None = None,
) -> SoakRun:
    """Run the thermal graph for many ticks.

    Parameters
    ----------
    model_text : str
        Text of a model file for the predictor.
    ticks : int
        Ticks of the machine, `TICKS_MIN` or more; rounded up to whole segments.
    seed : int
        Seed of all measuring noise.
    replaced : mapping of str to type, optional
        Components that take the place of those of the same name.
    progress : callable, optional
        Told how far it is.

    Raises
    ------
    ValueError
        If there are too few ticks, or the model cannot be used.
    """
    if ticks < TICKS_MIN:
        raise ValueError(f'ticks: expected {TICKS_MIN} or more but found {ticks}')
    segments = -(-ticks // SEGMENT)
    config = SimulatedMachineConfig(
        duties=soak_duties(segments * SEGMENT), tick_period=TICK, seed=seed
    )
    types = {**COMPONENTS, **(replaced or {})}
    graph = SoakGraph(SimulatedMachine(config), [types[name]() for name in config.lockstep_nodes])
    for node, name, given in (
        ('thermal_predictor', 'use_model', {'model': model_text}),
        ('compensator', 'activate', {}),
    ):
        answer = graph.request(node, name, **given)
        if not answer.success:
            raise ValueError(answer.message)
    # Filled in place: lists of samples would grow themselves.
    samples = np.zeros((segments, len(HELD) + len(graph.stages)))
    hashes = np.zeros(segments, 'S64')
    for number in range(segments):
        for _ in range(SEGMENT):
            graph.step()
        hashes[number], took = graph.segment()
        gc.collect()
        held = held_by()
        samples[number] = (
            held.memory / 2**20,
            sys.getallocatedblocks(),
            held.threads,
            held.files,
            *(1e6 * took),
        )
        if progress is not None:
            progress((number + 1) * SEGMENT, segments * SEGMENT)
    figures = (*HELD, *(f'{name} [us]' for name in graph.stages))
    settled = max(round(WARM_UP * segments), CYCLE // SEGMENT)
    return SoakRun(segments * SEGMENT, figures, samples, settled, graph.missed(), hashes)


def soak_duties(ticks: int) -> tuple[str, ...]:
    """Return duties that last for so many ticks at least."""
    left = ticks

    def needed(name: str) -> bool:
        nonlocal left
        before, left = left, left - round(DUTIES[name].duration / TICK)
        return before > 0

    return tuple(takewhile(needed, cycle(SOAK_DUTIES)))

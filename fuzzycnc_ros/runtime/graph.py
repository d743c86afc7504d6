# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A graph of components in one process, without DDS: the same ticks, turns and merge as live."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from fuzzycnc_ros.runtime.component import Answer, Component, Emission, TickingComponent
from fuzzycnc_ros.runtime.host import MachineTick
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.provenance import configuration_record, event_record
from fuzzycnc_ros.runtime.records import Record

Sink = Callable[[str, Record], None]
"""Takes every published record with its topic, in the order of publication."""

_LIFECYCLE = {'activate': 'active', 'deactivate': 'inactive'}
"""State of a managed node after a request."""


class InProcessGraph:
    """Run a simulated machine and the components that serve it.

    Parameters
    ----------
    machine : TickingComponent
        The machine; it makes time.
    components : sequence of Component
        The other components, in the order of their turns: a component stands behind those
        whose outputs it reads.
    sink : callable, optional
        Takes every published record.
    name : str
        Name of the machine, the first part of all frame ids.
    provenance : bool
        Whether the sink also gets what nodes say of themselves: configurations, requests and
        turns, so that a bag of it can be replayed.
    """

    def __init__(
        self,
        machine: TickingComponent[Any],
        components: Sequence[Component[Any]],
        *,
        sink: Sink | None = None,
        name: str = 'mill',
        provenance: bool = False,
    ) -> None:
        self.machine = machine
        self.components = tuple(components)
        self._sink = sink
        self._provenance = sink if provenance else None
        self._tick = 0
        self._mergers = {item.NAME: Merger(item) for item in (machine, *components)}
        self._readers: dict[str, list[Merger]] = {}
        for merger in self._mergers.values():
            merger.component.machine = name
            for item in merger.component.INPUTS:
                self._readers.setdefault(item.name, []).append(merger)
            state = 'inactive' if merger.component.MANAGED else 'active'
            self._announce(merger, state)

    def publish(self, emissions: Iterable[Emission]) -> None:
        """Hand emissions to the sink and to every component that reads them."""
        for emission in emissions:
            if self._sink is not None:
                self._sink(emission.output, emission.record)
            for merger in self._readers.get(emission.output, ()):
                merger.push(emission.output, emission.record)

    def request(self, node: str, name: str, **arguments: object) -> Answer:
        """Send a request to a component at its present machine time."""
        merger = self._mergers[node]
        answer = merger.component.on_request(name, arguments, merger.time)
        if answer.success and self._provenance is not None:
            event = event_record(merger.component, merger.time, name, arguments)
            self._provenance('node_event', event)
        self.publish(answer.emissions)
        if answer.success:
            self._announce(merger, _LIFECYCLE.get(name, 'active'))
        return answer

    def step(self) -> int:
        """Run one tick of the machine and every component's turn; return its stamp [ns].

        Raises
        ------
        RuntimeError
            If the machine's programme is over.
        """
        merger = self._mergers[self.machine.NAME]
        # What is there already may bring the next tick forward.
        self.publish(merger.advance(merger.time))
        stamp = self.machine.next_tick
        if stamp is None:
            raise RuntimeError('the programme of the simulated machine is over')
        self.publish(merger.advance(stamp))
        self.publish(self.machine.tick())
        self._tick += 1
        for component in self.components:
            self._note_turn(component.NAME, stamp)
            self.publish(self._mergers[component.NAME].advance(stamp))
        return stamp

    def run(self, progress: Callable[[int, int], None] | None = None) -> None:
        """Run the whole programme; `progress` is told the ticks done and in all."""
        total, count = self.machine.total_ticks, 0
        while self.machine.next_tick is not None:
            self.step()
            count += 1
            if progress is not None and count % 50 == 0:
                progress(self.machine.ticks_done, total)

    def _announce(self, merger: Merger, lifecycle_state: str) -> None:
        """Tell the sink what a component runs with."""
        if self._provenance is not None:
            record = configuration_record(merger.component, merger.time, lifecycle_state)
            self._provenance('node_configuration', record)

    def _note_turn(self, node: str, stamp: int) -> None:
        """Tell the sink that a component works up to a stamp; nothing is to be waited for."""
        if self._provenance is not None:
            turn = MachineTick(
                stamp=stamp,
                tick=self._tick,
                node=node,
                probe=False,
                topic=(),
                published=np.zeros(0, np.uint64),
                readers=np.zeros(0, np.uint32),
            )
            self._provenance(f'machine_tick/{node}', turn)

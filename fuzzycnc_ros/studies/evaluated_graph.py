# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs in one process whose run is judged by a log, and published to whoever else wants it."""

from collections.abc import Callable, Sequence

from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachine
from fuzzycnc_ros.runtime.component import Component
from fuzzycnc_ros.runtime.graph import InProcessGraph, Sink
from fuzzycnc_ros.runtime.records import Record


def judged_graph(
    machine: SimulatedMachine,
    components: Sequence[Component],
    log: Sink,
    sink: Sink | None,
    name: str = 'mill',
) -> InProcessGraph:
    """Return a graph that tells a log every record, and a sink also what nodes say of themselves.

    Parameters
    ----------
    machine : SimulatedMachine
        The machine; it makes time.
    components : sequence of Component
        The other components, in the order of their turns.
    log : callable
        Takes what it judges by.
    sink : callable or None
        Takes every published record, configurations, requests and turns included.
    name : str
        Name of the machine, the first part of all frame ids.
    """
    if sink is None:
        return InProcessGraph(machine, components, sink=log, name=name)

    def both(topic: str, record: Record) -> None:
        log(topic, record)
        sink(topic, record)

    return InProcessGraph(machine, components, sink=both, provenance=True, name=name)


def run_served(
    machine: SimulatedMachine,
    component: Component,
    log: Sink,
    sink: Sink | None,
    progress: Callable[[int, int], None] | None = None,
) -> str:
    """Run the machine's whole programme with one managed component, which is activated first.

    Parameters
    ----------
    machine : SimulatedMachine
        The machine.
    component : Component
        What serves it.
    log, sink : callable
        As for `judged_graph`.
    progress : callable, optional
        Told ticks done and in all; an exception that it raises ends the run.

    Returns
    -------
    str
        Why the machine gave up, and what the component said; empty if it did not.
    """
    graph = judged_graph(machine, [component], log, sink)
    graph.request(component.NAME, 'activate')
    graph.run(progress)
    if not machine.failure:
        return ''
    said = '; '.join(item.message for item in component.health())
    return f'{machine.failure} {component.NAME}: {said}'

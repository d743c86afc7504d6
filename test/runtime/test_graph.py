# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The graph in one process: what it publishes, in which order, and the same every time."""

from dataclasses import fields

import numpy as np
import pytest

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.probing.probe_cycle import ProbeCycle
from fuzzycnc_ros.components.thermal.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisition
from fuzzycnc_ros.registry import COMPONENTS, MACHINES
from fuzzycnc_ros.runtime.component import LATCHED, Component
from fuzzycnc_ros.runtime.graph import InProcessGraph
from fuzzycnc_ros.runtime.records import Record

MINUTES = 20


def graph_of(published: list, *, name: str = 'mill', seed: int = 1) -> InProcessGraph:
    """Return a short run of machine, acquisition and compensator."""
    machine = SimulatedMachine(
        SimulatedMachineConfig(duties=('T2',), seed=seed, duty_duration=60.0 * MINUTES)
    )
    return InProcessGraph(
        machine,
        (TemperatureAcquisition(), Compensator(CompensatorConfig())),
        sink=lambda topic, record: published.append((topic, record)),
        name=name,
    )


def as_text(published: list) -> list[str]:
    """Return everything that was published, to the last bit."""
    lines = []
    for topic, record in published:
        values = [getattr(record, item.name) for item in fields(record)]
        shown = [v.tobytes().hex() if isinstance(v, np.ndarray) else repr(v) for v in values]
        lines.append(f'{topic} {" ".join(shown)}')
    return lines


def test_two_runs_are_equal_to_the_last_bit():
    runs = []
    for _ in range(2):
        published: list = []
        graph = graph_of(published)
        graph.request('compensator', 'activate')
        graph.run()
        runs.append(as_text(published))
    assert runs[0] == runs[1]
    assert len(runs[0]) > 300


def test_another_seed_gives_another_run():
    runs = []
    for seed in (1, 2):
        published: list = []
        graph_of(published, seed=seed).run()
        runs.append(as_text(published))
    assert runs[0] != runs[1]


def test_every_topic_has_the_records_that_it_declares():
    published: list = []
    graph_of(published).run()
    declared = {item.name: item for c in COMPONENTS.values() for item in c.OUTPUTS}
    for topic, record in published:
        if topic in declared:
            assert type(record) is declared[topic].record
            assert record.frame_id.startswith('mill/')
    counts = {topic: sum(t == topic for t, _ in published) for topic in declared}
    assert counts['sensor_readings'] == 5 * MINUTES
    assert counts['temperatures'] == MINUTES
    assert counts['displacement'] == MINUTES
    assert counts['thermal_reference'] == 1
    assert counts['compensation'] == 0


def test_name_of_the_machine_is_the_first_part_of_every_frame():
    published: list = []
    graph_of(published, name='grinder_2').run()
    frames = {record.frame_id.split('/')[0] for _, record in published}
    assert frames == {'grinder_2'}


def test_stamps_of_a_topic_never_go_back():
    published: list = []
    graph_of(published).run()
    newest: dict[str, int] = {}
    for topic, record in published:
        assert isinstance(record, Record)
        assert record.stamp >= newest.get(topic, 0)
        newest[topic] = record.stamp


def test_progress_is_told():
    told = []
    graph = graph_of([])
    graph.run(lambda done, total: told.append((done, total)))
    assert told
    assert told[-1][0] <= told[-1][1] == graph.machine.total_ticks == 5 * MINUTES


def test_a_step_beyond_the_programme_is_an_error():
    graph = graph_of([])
    graph.run()
    with pytest.raises(RuntimeError, match='programme of the simulated machine is over'):
        graph.step()


def test_request_reaches_the_component_at_its_machine_time():
    published: list = []
    graph = graph_of(published)
    for _ in range(20):
        stamp = graph.step()
    answer = graph.request('temperature_acquisition', 'set_thermal_reference', set_by='operator')
    assert answer.success
    graph.run()
    references = [record for topic, record in published if topic == 'thermal_reference']
    assert references[-1].set_by == 'operator'
    assert references[-1].cold_since == stamp


def test_one_driving_input_and_one_writer_a_topic():
    """What merge and turns rest on."""
    used = [c for name, c in COMPONENTS.items() if name not in MACHINES[1:]]  # one is the machine
    writers = [item.name for c in used for item in c.OUTPUTS]
    # Paths have as many sources as there are ways to make them, motion has programs and joints; a
    # run in lock-step uses one.  A probing cycle needs a control, which knows no lock-step.
    several = {name for name in writers if writers.count(name) > 1}
    assert several <= {'tool_path', 'trajectory', 'displacement'}
    for component in COMPONENTS.values():
        assert sum(item.driving for item in component.INPUTS) <= 1
        names = [item.name for item in component.INPUTS]
        assert len(names) == len(set(names))


def test_writer_and_readers_agree_on_type_and_durability():
    written = {item.name: item for c in COMPONENTS.values() for item in c.OUTPUTS}
    for component in COMPONENTS.values():
        for item in component.INPUTS:
            if item.name in written:
                assert item.record is written[item.name].record
                assert item.durability is written[item.name].durability


def test_a_component_stands_behind_those_whose_outputs_it_reads():
    """Turns go in the order of the registry; only the machine reads what comes after it.

    So does the probing cycle, which takes no turns.
    """
    order = list(COMPONENTS)
    assert order[: len(MACHINES)] == list(MACHINES)
    writer = {item.name: c.NAME for c in COMPONENTS.values() for item in c.OUTPUTS}
    for component in list(COMPONENTS.values())[len(MACHINES) :]:
        for item in component.INPUTS:
            if item.name in writer and (component, item.name) != (ProbeCycle, 'probe_status'):
                assert order.index(writer[item.name]) < order.index(component.NAME)


@pytest.mark.parametrize('component', COMPONENTS.values(), ids=list(COMPONENTS))
def test_component_declares_itself(component: type[Component]):
    assert component.NAME == component.__module__.rpartition('.')[2]
    assert component.SUMMARY.endswith('.')
    assert isinstance(component().configuration, component.CONFIG)
    assert component().next_deadline is None or component.MANAGED
    driving = [item.name for item in component.INPUTS if item.driving]
    assert all(callable(getattr(component, f'on_{name}')) for name in driving)
    assert not any(
        item.persistent and item.durability is not LATCHED for item in component.OUTPUTS
    )
    refused = component().on_request('nonsense', {}, 0)
    assert not refused.success
    assert component.NAME in refused.message

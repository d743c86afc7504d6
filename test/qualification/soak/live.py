# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A soak over DDS: each node a process, watched from outside, and the bag that was recorded."""

import json
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.canonical import combined_hash, excluded, topic_hashes
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.recorder import REPORT_NAME
from fuzzycnc_ros.cli.console import Tell
from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.cli.live.supervision_monitor import Monitor
from fuzzycnc_ros.graph.bring_up import node_specs
from fuzzycnc_ros.ros.presence import MACHINE, GraphError
from soak.growth import held_by
from soak.run import EVERY_TICK, TICK, SoakRun, soak_duties

NAME = 'soak'
"""Namespace of the graph."""

PERIOD = 0.5
"""Wall time between two samples [s]."""

WARM_UP_LIVE = 6000
"""Ticks of warm-up: publishers keep 2,000 messages for slow readers, the recorder 5,000."""

SPEED_MIN = 20.0
"""Ticks per second of wall time below which a run is given up."""


def soak_live(model_text: str, ticks: int, seed: int, tell: Tell) -> SoakRun:
    """Run the thermal graph over DDS in lock-step, with a recorder.

    Parameters
    ----------
    model_text : str
        Text of a model file for the predictor.
    ticks : int
        Ticks of the machine, twice the warm-up or more; rounded up to whole duties.
    seed : int
        Seed of all measuring noise.
    tell : callable
        Shows the progress.

    Raises
    ------
    ValueError
        If there are too few ticks.
    GraphError
        If a node fails, or the run takes too long.
    """
    if ticks < 2 * WARM_UP_LIVE:
        raise ValueError(
            f'--hours: expected {2 * WARM_UP_LIVE * TICK / 3600.0:g} or more with --live, as '
            f'queues fill up for {WARM_UP_LIVE * TICK / 3600.0:g} h, but found '
            f'{ticks * TICK / 3600.0:g}'
        )
    own_domain()
    with tempfile.TemporaryDirectory(prefix='fuzzycnc-soak-') as name:
        folder = Path(name)
        model = folder / 'model.json'
        model.write_text(model_text, encoding='utf-8')
        specs = node_specs(
            duties=soak_duties(ticks),
            model=model,
            record=folder / 'bag',
            lockstep=True,
            autostart=True,
            machine_parameters={'seed': seed, 'tick_period': TICK},
        )
        with GraphProcesses(NAME, folder=folder / 'log') as graph:
            for spec in specs:
                graph.start(spec)
            samples = _watch(graph, [spec.name for spec in specs], ticks, tell)
            outcome = graph.outcome(MACHINE)
            graph.stop()
            graph.check()
        done = int(outcome.get('ticks', 0))
        missed = _missed(folder / 'bag', done)
        if outcome.get('degraded', True):
            missed[f'nodes lost: {", ".join(outcome.get("lost", ()))}; turns'] = max(
                1, int(outcome.get('missed', 0))
            )
        digest = combined_hash(topic_hashes(folder / 'bag'))
    return SoakRun(
        ticks=done,
        figures=tuple(
            f'{spec.name} {what}'
            for spec in specs
            for what in ('memory [MiB]', 'threads', 'open files', 'latency [ms]')
        ),
        samples=samples,
        settled=round(len(samples) * WARM_UP_LIVE / max(done, 1)),
        missed=missed,
        hashes=np.array([digest], 'S64'),
    )


def _watch(graph: GraphProcesses, names: list[str], ticks: int, tell: Tell) -> NDArray[np.float64]:
    """Return a row of figures of all nodes for every period until the machine has ended."""
    started, rows = time.monotonic(), []
    monitor = Monitor([NAME])
    try:
        while MACHINE not in graph.poll():
            graph.check()
            tell(f'soaking over DDS, {time.monotonic() - started:.0f} s', 0, 1)
            if time.monotonic() - started > ticks / SPEED_MIN + 60.0:
                raise GraphError(f'expected {SPEED_MIN:g} ticks per second or more; given up')
            monitor.spin(PERIOD)
            row: list[float] = []
            for name in names:
                try:
                    held = held_by(graph.pid(name))
                except OSError:  # it has just ended
                    break
                latency = monitor.view(NAME, name).activity.get('latency [ms]', '0')
                row += [held.memory / 2**20, held.threads, held.files, float(latency)]
            else:
                rows.append(row)
    finally:
        monitor.close()
    graph.check()
    # The last one may have been taken while the machine was ending.
    return np.array(rows[:-1], dtype=np.float64).reshape(-1, 4 * len(names))


def _missed(bag: Path, ticks: int) -> dict[str, int]:
    """Return what the recorder lost, and ticks without an answer, by topic."""
    with BagReader(bag) as reader:
        counted = json.loads(reader.attachments()[REPORT_NAME].data)['topics']
        lost = {topic: int(item['missing'] + item['dropped']) for topic, item in counted.items()}
        missed = {
            f'{topic} while recording': count
            for topic, count in lost.items()
            if count and not excluded(topic)  # diagnostics are no data: their queues are short
        }
        for name in EVERY_TICK:
            topic = f'/{NAME}/{name}'
            there = reader.connections[topic].message_count if topic in reader.connections else 0
            if there < ticks:
                missed[f'{topic} in the bag'] = ticks - there
    return missed

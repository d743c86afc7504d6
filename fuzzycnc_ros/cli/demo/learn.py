# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `learn` of the demo: three days from no model at all, with a probe an hour."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzzycnc_ros.cli.demo.steps import RUN_TIMEOUT, Outcome, Steps, ended, lockstep_graph
from fuzzycnc_ros.ros.bring_up import NodeSpec

MACHINE = 'mill'


@dataclass
class LearnResult:
    """What the demo found, as it is written to `summary.json`."""

    days: dict[str, dict[str, dict[str, float]]]
    probe_every_s: float
    wall_s: float
    hash: str
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float
    seed: int


def learn(out: Path, seed: int, progress: Steps) -> Outcome:
    """Run the scenario; its replay is to be identical."""
    from fuzzycnc_ros.bags.replay import replay
    from fuzzycnc_ros.studies.shift.learnt_days import (
        DAYS,
        EVERY,
        NOISE,
        days_line,
        days_page,
        days_table,
        learning_parameters,
        learnt_days,
    )
    from fuzzycnc_ros.studies.shift.shift_log import ShiftLog

    given = learning_parameters(DAYS, seed)
    given['compensator'] |= {'autostart': True}
    specs = [NodeSpec(name, {'lockstep': True, **values}) for name, values in given.items()]
    with lockstep_graph(MACHINE, specs, out / 'bag', out / 'log') as graph:
        started = time.monotonic()
        with progress.step(f'ran the days {", ".join(DAYS)} live over DDS, in lock-step'):
            graph.wait('simulated_machine', RUN_TIMEOUT)
        live_s = time.monotonic() - started
        outcome: dict[str, Any] = ended(graph)
    with progress.step('replayed the bag and compared every output'):
        replayed = replay(out / 'bag')
    days = learnt_days(ShiftLog.from_bag(out / 'bag'), DAYS)
    ticks = int(outcome.get('ticks', 0))
    result = LearnResult(
        days={day.name: day.figures() for day in days},
        probe_every_s=EVERY,
        wall_s=0.0,
        hash=replayed.hash,
        replay_identical=replayed.identical,
        degraded=bool(outcome.get('degraded', True)),
        ticks=ticks,
        ticks_per_second=round(ticks / live_s, 1),
        seed=seed,
    )
    facts = {
        'Machine': f'simulated mill, duties {", ".join(DAYS)}, noise seed {seed}',
        'Model': 'none; all of the error is learnt',
        'Probes': f'every {EVERY / 60.0:g} min, {1e6 * NOISE:g} µm of noise',
        'Ticks': f'{ticks}, {result.ticks_per_second:.0f} per second over DDS',
        'Replay': 'identical' if replayed.identical else 'differs',
        'Canonical hash': replayed.hash,
    }
    return Outcome(
        result,
        lambda: days_page(days, facts),
        (days_table(days),),
        (
            days_line(days),
            f'replay of the bag: {"identical" if replayed.identical else "DIFFERS"}, '
            f'hash {replayed.hash[:16]}',
            f'{ticks} ticks at {result.ticks_per_second:.0f} per second',
        ),
        ''
        if replayed.identical and not result.degraded
        else 'the run was degraded or its replay differs; see the report',
    )

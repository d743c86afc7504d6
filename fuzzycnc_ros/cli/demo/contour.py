# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `contour` of the demo: the butterfly, scheduled and followed live at 1 ms over DDS."""

import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzzycnc_ros.cli.demo.steps import RUN_TIMEOUT, Outcome, Steps, ended, lockstep_graph
from fuzzycnc_ros.graph.bring_up import NodeSpec

MACHINE = 'mill'
PATHS = ('butterfly',)
TOLERANCE = 5e-5


@dataclass
class ContourResult:
    """Figures of the demo, as written to `summary.json`."""

    paths: dict[str, dict[str, float]]
    in_process: dict[str, dict[str, float]]
    tolerance_mm: float
    wall_s: float
    hash: str
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float


def contour(out: Path, seed: int, progress: Steps) -> Outcome:
    """Run the scenario; its contour error is to be that of the same run in one process."""
    from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
    from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
    from fuzzycnc_ros.replay.replay import replay
    from fuzzycnc_ros.studies.contour.contouring import SETTLE, ContouringLog, run_contouring
    from fuzzycnc_ros.studies.contour.contouring_page import contouring_page, contouring_table

    scheduler = FeedrateSchedulerConfig(tolerance=TOLERANCE, settle=SETTLE)
    outcome, live_s = _run_live(out, scheduler, seed, progress)
    with progress.step('read the contour error from the bag'):
        followed = ContouringLog.from_bag(out / 'bag').paths()
    with progress.step('replayed the bag and compared every output'):
        replayed = replay(out / 'bag')
    with progress.step('ran the same in one process') as bar:
        alone = run_contouring(
            PATHS, scheduler, SimulatedMachineConfig(seed=seed), progress=bar.update
        )
    ticks = int(outcome.get('ticks', 0))
    result = ContourResult(
        paths=_figures(followed),
        in_process=_figures(alone),
        tolerance_mm=1e3 * TOLERANCE,
        wall_s=0.0,
        hash=replayed.hash,
        replay_identical=replayed.identical,
        degraded=bool(outcome.get('degraded', True)),
        ticks=ticks,
        ticks_per_second=round(ticks / live_s, 1),
    )
    equal = result.paths == result.in_process
    proven = equal and replayed.identical and not result.degraded
    facts = {
        'Machine': 'simulated contouring machine, position gain 40 1/s, no feedforward',
        'Ticks': f'{ticks}, {result.ticks_per_second:.0f} per second over DDS',
        'Same run in one process': 'equal contour error' if equal else 'another contour error',
        'Replay': 'identical' if replayed.identical else 'differs',
        'Canonical hash': replayed.hash,
    }
    return Outcome(
        result,
        lambda: contouring_page(
            'The butterfly at a tolerance',
            'The butterfly of the interpolator literature, scheduled for a contour error of '
            f'{1e3 * TOLERANCE:g} mm, sent over DDS as a trajectory in parts, and followed by the '
            'simulated axes at 1 ms.',
            followed,
            facts,
        ),
        (contouring_table(followed),),
        (
            f'contour error over DDS and in one process: {"equal" if equal else "NOT EQUAL"}',
            f'replay of the bag: {"identical" if replayed.identical else "DIFFERS"}, '
            f'hash {replayed.hash[:16]}',
            f'{ticks} ticks of 1 ms at {result.ticks_per_second:.0f} per second',
        ),
        '' if proven else 'the run was degraded or differs from its replay; see the report',
    )


def _run_live(
    out: Path, scheduler: Any, seed: int, progress: Steps
) -> tuple[dict[str, Any], float]:
    """Run the graph; return how the machine says it went, and the time."""
    chosen = {'tolerance': scheduler.tolerance, 'settle': scheduler.settle}
    specs = [
        NodeSpec('feedrate_scheduler', {'lockstep': True, 'autostart': True, **chosen}),
        NodeSpec('simulated_machine', {'duties': [''], 'paths': list(PATHS), 'seed': seed}),
    ]
    with ExitStack() as stack:
        with progress.step(f'started {len(specs) + 1} nodes'):
            graph = stack.enter_context(lockstep_graph(MACHINE, specs, out / 'bag', out / 'log'))
        started = time.monotonic()
        with progress.step(f'followed {", ".join(PATHS)} live over DDS, in lock-step at 1 ms'):
            graph.wait('simulated_machine', RUN_TIMEOUT)
        live_s = time.monotonic() - started
        return ended(graph), live_s


def _figures(paths: Any) -> dict[str, dict[str, float]]:
    return {
        path.name: {
            'time_s': path.duration,
            'error_max_mm': 1e3 * path.error_max,
            'error_mean_mm': 1e3 * path.error_mean,
        }
        for path in paths
    }

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `contour` of the demo: the butterfly, scheduled and followed live at 1 ms over DDS."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from fuzzycnc_ros.cli.demo.steps import ANSWER_TIMEOUT, RUN_TIMEOUT, Steps, finish, progress_of
from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.ros.bring_up import NodeSpec

MACHINE = 'mill'
PATHS = ('butterfly',)
TOLERANCE = 5e-5


@dataclass
class ContourResult:
    """What the demo found, as it is written to `summary.json`."""

    paths: dict[str, dict[str, float]]
    in_process: dict[str, dict[str, float]]
    tolerance_mm: float
    wall_s: float
    hash: str
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float


def contour_demo(console: Console, out: Path, seed: int) -> None:
    """Run the scenario into an empty folder and show what came of it.

    Raises
    ------
    GraphError
        If a node fails, the run was degraded, its replay differs, or the contour error is not
        that of the same run in one process.
    """
    started = time.monotonic()
    with progress_of(console) as progress:
        result, table = _run(out, seed, progress)
    same = 'equal' if result.paths == result.in_process else 'NOT EQUAL'
    replayed = 'identical' if result.replay_identical else 'DIFFERS'
    proven = not result.degraded and result.replay_identical and same == 'equal'
    finish(
        console,
        out,
        result,
        (table,),
        (
            f'contour error over DDS and in one process: {same}',
            f'replay of the bag: {replayed}, hash {result.hash[:16]}',
            f'{result.ticks} ticks of 1 ms at {result.ticks_per_second:.0f} per second',
        ),
        started=started,
        problem=''
        if proven
        else 'the run was degraded or differs from its replay; see the report',
    )


def _run(out: Path, seed: int, progress: Steps) -> tuple[ContourResult, Any]:
    from fuzzycnc_ros.bags.replay import replay
    from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
    from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
    from fuzzycnc_ros.studies.contour.contouring import SETTLE, run_contouring
    from fuzzycnc_ros.studies.contour.contouring_log import ContouringLog
    from fuzzycnc_ros.studies.contour.contouring_page import contouring_page, contouring_table
    from fuzzycnc_ros.studies.page.html import render_page

    own_domain()
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
    with progress.step('wrote the report'):
        page = contouring_page(
            'The butterfly at a tolerance',
            'The butterfly of the interpolator literature, scheduled for a contour error of '
            f'{1e3 * TOLERANCE:g} mm, sent over DDS as a trajectory in parts, and followed by the '
            'simulated axes at 1 ms.',
            followed,
            {
                'Machine': 'simulated contouring machine, position gain 40 1/s, no feedforward',
                'Ticks': f'{ticks}, {result.ticks_per_second:.0f} per second over DDS',
                'Same run in one process': 'equal contour error'
                if result.paths == result.in_process
                else 'another contour error',
                'Replay': 'identical' if replayed.identical else 'differs',
                'Canonical hash': replayed.hash,
            },
        )
        (out / 'report.html').write_text(render_page(page), encoding='utf-8')
    return result, contouring_table(followed)


def _run_live(
    out: Path, scheduler: Any, seed: int, progress: Steps
) -> tuple[dict[str, Any], float]:
    """Run the graph; return how the machine says it went, and the time."""
    specs = [
        NodeSpec(
            'feedrate_scheduler',
            {
                'lockstep': True,
                'autostart': True,
                'tolerance': scheduler.tolerance,
                'settle': scheduler.settle,
            },
        ),
        NodeSpec('recorder', {'lockstep': True, 'output': str(out / 'bag')}),
        NodeSpec(
            'simulated_machine',
            {
                'duties': [''],
                'paths': list(PATHS),
                'seed': seed,
                'lockstep': True,
                'lockstep_nodes': ['feedrate_scheduler'],
                'lockstep_recorder': True,
                'answer_timeout': ANSWER_TIMEOUT,
            },
        ),
    ]
    with GraphProcesses(MACHINE, folder=out / 'log') as graph:
        with progress.step(f'started {len(specs)} nodes'):
            for spec in specs:
                graph.start(spec)
        started = time.monotonic()
        with progress.step(f'followed {", ".join(PATHS)} live over DDS, in lock-step at 1 ms'):
            graph.wait('simulated_machine', RUN_TIMEOUT)
        live_s = time.monotonic() - started
        outcome = graph.outcome('simulated_machine')
        graph.stop()
        graph.check()
    return outcome, live_s


def _figures(paths: Any) -> dict[str, dict[str, float]]:
    return {
        path.name: {
            'time_s': path.duration,
            'error_max_mm': 1e3 * path.error_max,
            'error_mean_mm': 1e3 * path.error_mean,
        }
        for path in paths
    }

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `pattern` of the demo: a track on a soft sheet, stitched live, plain and by a model."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from fuzzycnc_ros.cli.demo.shift_quilter import trained_foam
from fuzzycnc_ros.cli.demo.steps import ANSWER_TIMEOUT, RUN_TIMEOUT, Steps, finish, progress_of
from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.ros.bring_up import NodeSpec

MACHINE = 'mill'
TRACK = 'parallelogram:45'
BAGS = {'before': 'before', 'after': 'bag'}
"""Bag of each run."""


@dataclass
class PatternResult:
    """What the demo found, as it is written to `summary.json`."""

    runs: dict[str, dict[str, float]]
    in_process: dict[str, dict[str, float]]
    published: dict[str, dict[str, float]]
    wall_s: float
    hash: dict[str, str]
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float


def pattern_demo(console: Console, out: Path, seed: int) -> None:
    """Run the scenario into an empty folder and show what came of it.

    Raises
    ------
    GraphError
        If a node fails, a run was degraded, its replay differs, or its stitches are not those of
        the same run in one process.
    """
    started = time.monotonic()
    with progress_of(console) as progress:
        result, table = _run(out, seed, progress)
    same = 'equal' if result.runs == result.in_process else 'NOT EQUAL'
    replayed = 'identical' if result.replay_identical else 'DIFFERS'
    proven = not result.degraded and result.replay_identical and same == 'equal'
    finish(
        console,
        out,
        result,
        (table,),
        (
            f'stitches over DDS and in one process: {same}',
            f'replay of both bags: {replayed}, hash {result.hash["after"][:16]}',
            f'{result.ticks} ticks of 1 ms at {result.ticks_per_second:.0f} per second',
        ),
        started=started,
        problem='' if proven else 'a run was degraded or differs from its replay; see the report',
    )


def _run(out: Path, seed: int, progress: Steps) -> tuple[PatternResult, Any]:
    from fuzzycnc_ros.bags.replay import replay
    from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
    from fuzzycnc_ros.studies.page.html import render_page
    from fuzzycnc_ros.studies.soft.pattern import run_patterns
    from fuzzycnc_ros.studies.soft.pattern_log import PatternLog
    from fuzzycnc_ros.studies.soft.pattern_page import PUBLISHED_OF, pattern_page, pattern_table

    own_domain()
    with progress.step('trained a T-S fuzzy neural network on 265 samples'):
        model = trained_foam(seed)
        (out / 'model.json').write_text(model, encoding='utf-8')
    live, alone, replayed, outcomes, live_s = {}, {}, {}, [], 0.0
    for name, folder in BAGS.items():
        file = '' if name == 'before' else str(out / 'model.json')
        outcome, spent = _run_live(out, folder, file, seed, progress)
        outcomes.append(outcome)
        live_s += spent
    for name, folder in BAGS.items():
        with progress.step(f'replayed {folder} and compared every output'):
            (live[name],) = PatternLog.from_bag(out / folder).patterns()
            replayed[name] = replay(out / folder)
    with progress.step('ran the same in one process') as bar:
        for name in BAGS:
            (alone[name],) = run_patterns(
                (TRACK,),
                '' if name == 'before' else model,
                machine=SimulatedMachineConfig(seed=seed, sheet_seed=seed),
                progress=bar.update,
            )
    identical = all(report.identical for report in replayed.values())
    ticks = sum(int(outcome.get('ticks', 0)) for outcome in outcomes)
    published = {
        name: dict(zip(('angle_error_deg', 'straightness_mm', 'time_s'), values, strict=True))
        for name, values in PUBLISHED_OF.items()
    }
    result = PatternResult(
        runs=_figures(live),
        in_process=_figures(alone),
        published=published,
        wall_s=0.0,
        hash={name: report.hash for name, report in replayed.items()},
        replay_identical=identical,
        degraded=any(bool(outcome.get('degraded', True)) for outcome in outcomes),
        ticks=ticks,
        ticks_per_second=round(ticks / live_s, 1),
    )
    with progress.step('wrote the report'):
        equal = result.runs == result.in_process
        page = pattern_page(
            live,
            {
                'Sheet': 'simulated foam, 150 x 100 x 15 mm, 6 mm deep, steps of 3 mm',
                'Ticks': f'{ticks}, {result.ticks_per_second:.0f} per second over DDS',
                'Same runs in one process': 'equal stitches' if equal else 'other stitches',
                'Replay': 'identical' if identical else 'differs',
                'Canonical hash': result.hash['after'],
            },
        )
        (out / 'report.html').write_text(render_page(page), encoding='utf-8')
    return result, pattern_table(live)


def _run_live(
    out: Path, folder: str, model: str, seed: int, progress: Steps
) -> tuple[dict[str, Any], float]:
    """Run the graph; return how the machine says it went, and the time."""
    from fuzzycnc_ros.studies.soft.pattern import STITCH_BLEND

    specs = [
        NodeSpec('deformation_compensator', {'lockstep': True, 'autostart': True, 'model': model}),
        NodeSpec(
            'feedrate_scheduler', {'lockstep': True, 'autostart': True, 'blend': STITCH_BLEND}
        ),
        NodeSpec('recorder', {'lockstep': True, 'output': str(out / folder)}),
        NodeSpec(
            'simulated_machine',
            {
                'duties': [''],
                'patterns': [TRACK],
                'seed': seed,
                'sheet_seed': seed,
                'lockstep': True,
                'lockstep_nodes': ['deformation_compensator', 'feedrate_scheduler'],
                'lockstep_recorder': True,
                'answer_timeout': ANSWER_TIMEOUT,
            },
        ),
    ]
    how = 'with the model' if model else 'without compensation'
    with GraphProcesses(MACHINE, folder=out / 'log' / folder) as graph:
        started = time.monotonic()
        with progress.step(f'stitched {TRACK} live over DDS, in lock-step at 1 ms, {how}'):
            for spec in specs:
                graph.start(spec)
            graph.wait('simulated_machine', RUN_TIMEOUT)
        live_s = time.monotonic() - started
        outcome = graph.outcome('simulated_machine')
        graph.stop()
        graph.check()
    return outcome, live_s


def _figures(runs: dict[str, Any]) -> dict[str, dict[str, float]]:
    return {name: _quality(run) for name, run in runs.items()}


def _quality(run: Any) -> dict[str, float]:
    found = run.quality()
    return {
        'angle_error_deg': float(np.degrees(found.angle_error)),
        'straightness_mm': 1e3 * found.straightness,
        'time_s': found.time,
        'closure_gap_mm': 1e3 * found.closure_gap,
        'rms_deviation_mm': 1e3 * found.rms_deviation,
        'max_deviation_mm': 1e3 * found.max_deviation,
    }

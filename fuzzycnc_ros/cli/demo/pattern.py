# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `pattern` of the demo: a track on a soft sheet, stitched live, plain and by a model."""

import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fuzzycnc_ros.cli.demo.shift_quilter import quilt_specs, trained_foam
from fuzzycnc_ros.cli.demo.steps import RUN_TIMEOUT, Outcome, Steps, ended, lockstep_graph

MACHINE = 'mill'
BAGS = {'before': 'before', 'after': 'bag'}
"""Bag of each run."""


@dataclass
class PatternResult:
    """Figures of the demo, as written to `summary.json`."""

    runs: dict[str, dict[str, float]]
    in_process: dict[str, dict[str, float]]
    published: dict[str, dict[str, float]]
    wall_s: float
    hash: dict[str, str]
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float


def pattern(out: Path, seed: int, progress: Steps) -> Outcome:
    """Run the scenario; its stitches are to be those of the same runs in one process."""
    from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
    from fuzzycnc_ros.replay.replay import replay
    from fuzzycnc_ros.studies.soft.pattern import TRACK, PatternLog, run_patterns
    from fuzzycnc_ros.studies.soft.pattern_page import PUBLISHED_OF, pattern_page, pattern_table

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
    equal = result.runs == result.in_process
    proven = equal and identical and not result.degraded
    facts = {
        'Sheet': 'simulated foam, 150 x 100 x 15 mm, 6 mm deep, steps of 3 mm',
        'Ticks': f'{ticks}, {result.ticks_per_second:.0f} per second over DDS',
        'Same runs in one process': 'equal stitches' if equal else 'other stitches',
        'Replay': 'identical' if identical else 'differs',
        'Canonical hash': result.hash['after'],
    }
    return Outcome(
        result,
        lambda: pattern_page(live, facts),
        (pattern_table(live),),
        (
            f'stitches over DDS and in one process: {"equal" if equal else "NOT EQUAL"}',
            f'replay of both bags: {"identical" if identical else "DIFFERS"}, '
            f'hash {result.hash["after"][:16]}',
            f'{ticks} ticks of 1 ms at {result.ticks_per_second:.0f} per second',
        ),
        '' if proven else 'a run was degraded or differs from its replay; see the report',
    )


def _run_live(
    out: Path, folder: str, model: str, seed: int, progress: Steps
) -> tuple[dict[str, Any], float]:
    """Run the graph; return how the machine says it went, and the time."""
    from fuzzycnc_ros.studies.soft.pattern import TRACK

    how = 'with the model' if model else 'without compensation'
    with ExitStack() as stack:
        started = time.monotonic()
        with progress.step(f'stitched {TRACK} live over DDS, in lock-step at 1 ms, {how}'):
            graph = stack.enter_context(
                lockstep_graph(
                    MACHINE, quilt_specs(model, seed), out / folder, out / 'log' / folder
                )
            )
            graph.wait('simulated_machine', RUN_TIMEOUT)
        live_s = time.monotonic() - started
        return ended(graph), live_s


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

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `pattern` of the demo: a track on a soft sheet, stitched live, plain and by a model."""

from pathlib import Path
from typing import Any

import numpy as np

from fuzzycnc_ros.cli.demo.live_run import run_live
from fuzzycnc_ros.cli.demo.shift_quilter import quilt_specs, trained_foam
from fuzzycnc_ros.cli.demo.steps import Outcome, Steps

BAGS = {'before': 'before', 'after': 'bag'}
"""Bag of each run."""


def pattern(out: Path, seed: int, progress: Steps) -> Outcome:
    """Run the scenario; its stitches are to be those of the same runs in one process."""
    from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
    from fuzzycnc_ros.studies.soft.pattern import TRACK, PatternLog, run_patterns
    from fuzzycnc_ros.studies.soft.pattern_page import PUBLISHED_OF, pattern_page, pattern_table

    with progress.step('trained a T-S fuzzy neural network on 265 samples'):
        model = trained_foam(seed)
        (out / 'model.json').write_text(model, encoding='utf-8')
    live, alone, runs = {}, {}, {}
    for name, folder in BAGS.items():
        file, how = str(out / 'model.json'), 'with the model'
        if name == 'before':
            file, how = '', 'without compensation'
        label = f'stitched {TRACK} at 1 ms, {how},'
        runs[name] = run_live(quilt_specs(file, seed), label, out, progress, folder)
        (live[name],) = PatternLog.from_bag(out / folder).patterns()
    with progress.step('ran the same in one process') as bar:
        for name in BAGS:
            (alone[name],) = run_patterns(
                (TRACK,),
                '' if name == 'before' else model,
                machine=SimulatedMachineConfig(seed=seed, sheet_seed=seed),
                progress=bar.update,
            )
    published = {
        name: dict(zip(('angle_error_deg', 'straightness_mm', 'time_s'), values, strict=True))
        for name, values in PUBLISHED_OF.items()
    }
    both = runs['after']._replace(
        replay_identical=all(run.replay_identical for run in runs.values()),
        degraded=any(run.degraded for run in runs.values()),
        ticks=sum(run.ticks for run in runs.values()),
    )
    result = {
        'runs': _figures(live),
        'in_process': _figures(alone),
        'published': published,
        'wall_s': 0.0,
        **both._asdict(),
        'hash': {name: run.hash for name, run in runs.items()},
    }
    equal = result['runs'] == result['in_process']
    facts = {
        'Sheet': 'simulated foam, 150 x 100 x 15 mm, 6 mm deep, steps of 3 mm',
        'Same runs in one process': 'equal stitches' if equal else 'other stitches',
        **both.facts(),
    }
    return Outcome(
        result,
        lambda: pattern_page(live, facts),
        (pattern_table(live),),
        (
            f'stitches over DDS and in one process: {"equal" if equal else "NOT EQUAL"}',
            *both.lines(),
        ),
        both.problem() if equal else 'a run differs from that in one process; see the report',
    )


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

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `contour` of the demo: the butterfly, scheduled and followed live at 1 ms over DDS."""

from pathlib import Path
from typing import Any

from fuzzycnc_ros.cli.demo.live_run import run_live
from fuzzycnc_ros.cli.demo.steps import Outcome, Steps
from fuzzycnc_ros.graph.bring_up import NodeSpec

PATHS = ('butterfly',)
TOLERANCE = 5e-5


def contour(out: Path, seed: int, progress: Steps) -> Outcome:
    """Run the scenario; its contour error is to be that of the same run in one process."""
    from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
    from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
    from fuzzycnc_ros.studies.contour.contouring import SETTLE, ContouringLog, run_contouring
    from fuzzycnc_ros.studies.contour.contouring_page import contouring_page, contouring_table

    scheduler = FeedrateSchedulerConfig(tolerance=TOLERANCE, settle=SETTLE)
    chosen = {'tolerance': scheduler.tolerance, 'settle': scheduler.settle}
    specs = [
        NodeSpec('feedrate_scheduler', {'lockstep': True, 'autostart': True, **chosen}),
        NodeSpec('simulated_machine', {'duties': [''], 'paths': list(PATHS), 'seed': seed}),
    ]
    run = run_live(specs, f'followed {", ".join(PATHS)} at 1 ms', out, progress)
    with progress.step('read the contour error from the bag'):
        followed = ContouringLog.from_bag(out / 'bag').paths()
    with progress.step('ran the same in one process') as bar:
        alone = run_contouring(
            PATHS, scheduler, SimulatedMachineConfig(seed=seed), progress=bar.update
        )
    result = {
        'paths': _figures(followed),
        'in_process': _figures(alone),
        'tolerance_mm': 1e3 * TOLERANCE,
        'wall_s': 0.0,
        **run._asdict(),
    }
    equal = result['paths'] == result['in_process']
    facts = {
        'Machine': 'simulated contouring machine, position gain 40 1/s, no feedforward',
        'Same run in one process': 'equal contour error' if equal else 'another contour error',
        **run.facts(),
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
            *run.lines(),
        ),
        run.problem() if equal else 'the run differs from that in one process; see the report',
    )


def _figures(paths: Any) -> dict[str, dict[str, float]]:
    return {
        path.name: {
            'time_s': path.duration,
            'error_max_mm': 1e3 * path.error_max,
            'error_mean_mm': 1e3 * path.error_mean,
        }
        for path in paths
    }

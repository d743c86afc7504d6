# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `shift` of the demo: a mill with everything on for eight hours, beside a quilter."""

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzzycnc_ros.cli.demo.shift_quilter import (
    PATTERN_BAGS,
    QUILT,
    first_piece,
    pattern_alone,
    quilt_specs,
    trained_foam,
)
from fuzzycnc_ros.cli.demo.steps import Outcome, Steps, ended, lockstep_graph
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.graph.bring_up import NodeSpec

LIVE_TIMEOUT = 1200.0
"""Wall time [s] that a live run may take: a busy host may be ten times slower than an idle one."""
MILL = 'mill'
LIVE = {MILL: 'bag', QUILT: 'quilt'}
"""Bag of each machine over DDS."""
THERMAL_MAX, POSITIONING_MAX, ANGLE_CUT = 5e-6, 2e-6, 0.8
"""Targets: thermal and positioning error [m], part of the angle error cut [-]."""


def whole_shift(out: Path, seed: int, progress: Steps, program: str = '') -> Outcome:
    """Run the scenario; its outputs are to be those of one process.

    `program` is the text of the part program, as `check_program` takes it; empty for the
    machine's own.
    """
    from fuzzycnc_ros.core.thermal.model import load_model
    from fuzzycnc_ros.studies.shift.whole_shift import ShiftSettings, judged_shift
    from fuzzycnc_ros.studies.shift.whole_shift_log import ShiftLogs
    from fuzzycnc_ros.studies.shift.whole_shift_page import job_table, shift_page
    from fuzzycnc_ros.studies.soft.pattern import PatternLog
    from fuzzycnc_ros.studies.soft.pattern_page import pattern_table

    settings = ShiftSettings(program=program, seed=seed)
    with progress.step('trained the models of thermal error and foam'):
        thermal, foam = _models(seed)
        (out / 'model.json').write_text(thermal, encoding='utf-8')
        (out / 'foam_trained.json').write_text(foam, encoding='utf-8')
    live = _run_both(out, settings, thermal, foam, progress)
    outcomes, live_s, before = live.outcomes, live.seconds, live.before
    with progress.step('judged the bags and compared every topic'):
        after = judged_shift(ShiftLogs.from_bag(out / 'bag'), load_model(thermal), settings)
        patterns = {
            name: PatternLog.from_bag(out / folder).patterns()[0]
            for name, folder in PATTERN_BAGS.items()
        }
        topics, differing = _compared(out)
    degraded = any(bool(item.get('degraded', True)) for item in outcomes.values())
    ticks = {name: int(item.get('ticks', 0)) for name, item in outcomes.items()}
    result = {
        **_figures(before, after, patterns),
        'topics': topics,
        'differing': differing,
        'degraded': degraded,
        'ticks': ticks,
        'live_s': round(live_s, 2),
        'wall_s': 0.0,
        'seed': seed,
    }
    lines = [f'{name}: {"met" if met else "NOT MET"}' for name, met in result['met'].items()]
    for machine, names in differing.items():
        same = f'DIFFER in {", ".join(names)}' if names else 'equal on every topic'
        lines.append(f'{machine}: hashes over DDS and in one process: {same}')
    if degraded:
        lines.append('a node missed a turn or was lost (see log)')
    differs, all_ticks = any(differing.values()), sum(ticks.values())
    facts = {
        'Mill': 'simulated mill, three ball-screw axes, one shift of 8 h',
        'Quilter': 'simulated foam sheet, 150 x 100 x 15 mm, 6 mm deep, steps of 3 mm',
        'Foam model': 'trained on 265 samples, gains of X and Y from the first piece',
        'Contour tolerance': f'{result["contour_tolerance_um"]:g} µm',
        'Ticks': f'{all_ticks} in {live_s:.0f} s over DDS',
        'Same runs in one process': 'DIFFER' if differs else 'equal on every topic',
        'Noise seed': str(seed),
    }
    return Outcome(
        result,
        lambda: shift_page(before, after, patterns, facts),
        (job_table(before, after), pattern_table(patterns)),
        (*lines, f'{all_ticks} ticks in {live_s:.0f} s over DDS'),
        'a run differs from that in one process; see summary.json' if differs else '',
    )


def _models(seed: int) -> tuple[str, str]:
    """Return the texts of a thermal model of calibration runs and of a foam model of samples."""
    from fuzzycnc_ros.core.thermal.fit import train_model
    from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration
    from fuzzycnc_ros.studies.shift.whole_shift import TICK

    period = {'simulated_machine': {'tick_period': TICK}}
    runs = record_calibration(seed=seed, parameters=period).runs
    return train_model(runs).to_json(), trained_foam(seed)


@dataclass
class _Live:
    """Both machines over DDS: how they say it went, the time, and the shift before."""

    outcomes: dict[str, dict[str, Any]]
    seconds: float
    before: Any


def _run_both(out: Path, settings: Any, thermal: str, foam: str, progress: Steps) -> _Live:
    """Run both machines over DDS, and beside the mill, which takes longest, what needs no DDS."""
    from fuzzycnc_ros.studies.shift.whole_shift import run_whole_shift

    started = time.monotonic()

    def until_over(graph: GraphProcesses) -> float:
        with progress.step('ran the shift of the mill live over DDS, in lock-step'):
            graph.wait('simulated_machine', LIVE_TIMEOUT)
            return time.monotonic()

    specs = mill_specs(out / 'model.json', settings)
    # An interrupt reaches this thread, which then ends the mill, and with it the one that waits.
    with ThreadPoolExecutor(1) as pool, _started(out, MILL, specs) as mill:
        shift = pool.submit(until_over, mill)
        with progress.step('stitched a first piece as drawn, fitted the gains of the foam model'):
            adapted = first_piece(out, foam, settings.seed)
        with progress.step('had the quilter stitch its pattern live over DDS, in lock-step'):
            specs = quilt_specs(str(out / 'foam.json'), settings.seed)
            with _started(out, QUILT, specs) as quilter:
                quilter.wait('simulated_machine', LIVE_TIMEOUT)
                until, quilted = time.monotonic(), ended(quilter)
        with progress.step('ran the same in one process') as bar:
            _run_alone(out, settings, thermal, adapted, bar)
        with progress.step('ran the mill without compensation, at the programmed feed') as bar:
            before = run_whole_shift(thermal, settings, compensated=False, progress=bar.update)
            pattern_alone(out / PATTERN_BAGS['trained'], foam, settings.seed)
        over = shift.result()
        outcome = ended(mill)
    return _Live({MILL: outcome, QUILT: quilted}, max(over, until) - started, before)


def _started(
    out: Path, machine: str, specs: list[NodeSpec]
) -> AbstractContextManager[GraphProcesses]:
    """Start the graph of a machine, recorded into its bag."""
    bag = LIVE[machine]
    return lockstep_graph(machine, specs, out / bag, out / 'log' / bag)


def mill_specs(model: Path, settings: Any) -> list[NodeSpec]:
    """Return the nodes of the mill in the order of their turns, the machine last."""
    from fuzzycnc_ros.studies.shift.whole_shift import AXES, CONTROLLER, SCHEDULER

    turn = {'lockstep': True}
    managed = {**turn, 'autostart': True}
    return [
        NodeSpec('temperature_acquisition', turn),
        NodeSpec('sensor_selector', turn),
        NodeSpec('thermal_predictor', {**turn, 'model': str(model)}),
        NodeSpec('compensator', managed),
        NodeSpec('feedrate_scheduler', {**managed, **_lists(SCHEDULER)}),
        NodeSpec('servo_controller', {**managed, 'axes': list(AXES), 'controller': CONTROLLER}),
        NodeSpec('simulated_machine', _lists(settings.machine())),
    ]


def _lists(values: dict[str, Any]) -> dict[str, Any]:
    """Return parameters as a file of parameters has them."""
    return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}


def _run_alone(out: Path, settings: Any, thermal: str, foam: str, bar: Any) -> None:
    """Run both machines in this process, into bags of their own."""
    from fuzzycnc_ros.studies.published_bag import PublishedBag
    from fuzzycnc_ros.studies.shift.whole_shift import run_whole_shift

    with PublishedBag(out / 'alone' / LIVE[MILL], machine=MILL) as bag:
        run_whole_shift(thermal, settings, sink=bag, progress=bar.update)
    pattern_alone(out / 'alone' / LIVE[QUILT], foam, settings.seed)


def _compared(out: Path) -> tuple[dict[str, dict[str, str]], dict[str, list[str]]]:
    """Return the canonical hash of every topic by bag over DDS, and those that differ from it."""
    from fuzzycnc_ros.bags.canonical import topic_hashes
    from fuzzycnc_ros.registry import COMPONENTS

    outputs = {item.name for component in COMPONENTS.values() for item in component.OUTPUTS}
    topics, differing = {}, {}
    for folder in LIVE.values():
        found = topic_hashes(out / folder)
        alone = topic_hashes(out / 'alone' / folder)
        judged = {
            topic: digest for topic, digest in found.items() if topic.rpartition('/')[2] in outputs
        }
        topics[folder] = judged
        differing[folder] = [
            topic for topic, digest in judged.items() if alone.get(topic) != digest
        ]
    return topics, differing


def _figures(before: Any, after: Any, patterns: Any) -> dict[str, Any]:
    """Return the figures of a shift before and after, but for those of the live run."""
    import numpy as np

    from fuzzycnc_ros.studies.shift.whole_shift import TOLERANCE

    figures = {
        name: {
            'angle_error_deg': float(np.degrees(run.quality().angle_error)),
            'straightness_mm': 1e3 * float(run.quality().straightness),
        }
        for name, run in patterns.items()
    }
    cut = 1.0 - figures['after']['angle_error_deg'] / figures['before']['angle_error_deg']
    jobs = [
        {
            'job': new.name,
            'start_s': new.start,
            'error_before_um': 1e6 * old.error,
            'error_after_um': 1e6 * new.error,
            'thermal_before_um': 1e6 * old.left,
            'thermal_after_um': 1e6 * new.left,
            'axes_before_um': 1e6 * old.own,
            'contour_um': 1e6 * new.contour,
            'positioning_um': 1e6 * new.positioning,
        }
        for old, new in zip(before.jobs, after.jobs, strict=True)
    ]
    return {
        'jobs': jobs,
        'thermal_max_um': 1e6 * after.thermal_max,
        'thermal_before_max_um': 1e6 * before.thermal_max,
        'contour_max_um': 1e6 * after.contour_max,
        'contour_tolerance_um': 1e6 * TOLERANCE,
        'positioning_max_um': 1e6 * after.positioning_max,
        'pattern': figures,
        'angle_error_cut': cut,
        'met': {
            f'thermal error at most {1e6 * THERMAL_MAX:g} µm': after.thermal_max <= THERMAL_MAX,
            'contour error within its tolerance': after.contour_max <= TOLERANCE,
            f'positions within {1e6 * POSITIONING_MAX:g} µm': bool(
                after.positioning_max <= POSITIONING_MAX
            ),
            f'angle error of the pattern cut by {ANGLE_CUT:.0%}': cut >= ANGLE_CUT,
        },
    }

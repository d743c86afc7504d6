# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `thermal` of the demo: calibrate, then compensate unseen duties live over DDS."""

import time
from pathlib import Path
from typing import Any

import numpy as np

from fuzzycnc_ros.cli.demo.live_run import LiveRun
from fuzzycnc_ros.cli.demo.steps import RUN_TIMEOUT, Outcome, Steps, ended
from fuzzycnc_ros.cli.live.free_domain import other_domain
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.graph.bring_up import node_specs

MACHINE = 'mill'
CALIBRATION = ('D0', 'D0b', 'T1')
UNSEEN = ('T2', 'T3')


def thermal(out: Path, seed: int, progress: Steps) -> Outcome:
    """Run the scenario; its replay is to be identical."""
    from fuzzycnc_ros.cli.live.latency import measure_latency
    from fuzzycnc_ros.components.thermal.compensator import CompensatorConfig
    from fuzzycnc_ros.core.thermal.model import load_model
    from fuzzycnc_ros.replay.replay import replay
    from fuzzycnc_ros.studies.shift.shift_log import ShiftLog, compensation_runs
    from fuzzycnc_ros.studies.shift.shift_report import shift_report
    from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration
    from fuzzycnc_ros.studies.thermal.report_data import Latency
    from fuzzycnc_ros.studies.thermal.report_page import report_page
    from fuzzycnc_ros.studies.thermal.summary import summary_document, summary_table

    with progress.step(f'recorded calibration runs {", ".join(CALIBRATION)}') as bar:
        calibration = record_calibration(
            CALIBRATION,
            seed,
            folder=out / 'calibration',
            progress=lambda text, done, total: bar.update(done, total),
        )
    outcome, live_s = _run_live(out, [Path(bag) for bag in calibration.bags], seed, progress)
    model_file = out / 'model.json'
    model = load_model(model_file)
    with progress.step('replayed the bag and compared every output'):
        replayed = replay(out / 'bag')
    with progress.step('measured latency between two processes'), other_domain():
        latency = measure_latency(model_file, out / 'latency')
    log = ShiftLog.from_bag(out / 'bag')
    runs = compensation_runs(log, model, UNSEEN, offset_max=CompensatorConfig().offset_max)
    run = LiveRun.of(outcome, live_s, replayed)
    median, p99 = (1e3 * float(np.quantile(latency, share)) for share in (0.5, 0.99))
    result = {
        'runs': summary_document(runs),
        'latency_ms': {'median': median, 'p99': p99},
        'wall_s': 0.0,
        **run._asdict(),
        'sensors': list(model.inputs),
        'model': dict(zip(model.channel, model.default, strict=True)),
        'seed': seed,
    }
    report = shift_report(
        runs,
        model,
        model_file.read_text(encoding='utf-8'),
        title='Thermal compensation of two shifts',
        summary=(
            'Two duties that no model had seen, compensated live over DDS. The residual is the '
            'measured displacement minus the prediction.'
        ),
        notes=replayed.notes,
        calibration=calibration.runs,
        latency=Latency(np.array(latency)),
        facts={
            'Machine': f'simulated mill, duties {", ".join(UNSEEN)}, noise seed {seed}',
            **run.facts(),
        },
    )
    return Outcome(
        result,
        lambda: report_page(report),
        (summary_table(runs),),
        (
            f'temperatures to compensation over DDS: median {median:.2f} ms, p99 {p99:.2f} ms',
            *run.lines(),
        ),
        run.problem(),
    )


def _run_live(
    out: Path, bags: list[Path], seed: int, progress: Steps
) -> tuple[dict[str, Any], float]:
    """Run the graph over the unseen duties; return how the machine says it went, and the time."""
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient

    specs = node_specs(
        duties=UNSEEN,
        record=out / 'bag',
        lockstep=True,
        autostart=True,
        machine_parameters={'seed': seed},
    )
    with GraphProcesses(MACHINE, folder=out / 'log') as graph:
        with progress.step(f'started {len(specs) - 1} nodes'):
            for spec in specs[:-1]:
                graph.start(spec)
            operator = OperatorClient(MACHINE, graph.check)
        with operator:
            with progress.step('selected sensors over DDS (service select_sensors)'):
                operator.select_sensors(bags)
            with progress.step('trained models over DDS (action train_thermal_model)') as bar:
                operator.train(
                    bags,
                    model='auto',
                    file=out / 'model.json',
                    progress=lambda stage, candidate, done, total: bar.update(done, total),
                )
        started = time.monotonic()
        with progress.step(f'compensated {" and ".join(UNSEEN)} live over DDS, in lock-step'):
            graph.start(specs[-1])
            graph.wait('simulated_machine', RUN_TIMEOUT)
        live_s = time.monotonic() - started
        return ended(graph), live_s

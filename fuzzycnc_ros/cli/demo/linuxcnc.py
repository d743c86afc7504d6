# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario `linuxcnc` of the demo: a closed loop through a LinuxCNC that really runs."""

import contextlib
import shutil
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.simulation import LinuxcncSimulation, exclusive
from fuzzycnc_ros.bags.recording_loss import LACKING, loss
from fuzzycnc_ros.cli.console import complain
from fuzzycnc_ros.cli.demo.steps import RUN_TIMEOUT, Outcome, Steps, ended, play
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.graph.bring_up import NodeSpec
from fuzzycnc_ros.ros.presence import GraphError

MACHINE = 'mill'
DUTY = 'T2'
RATE = 100.0
"""Seconds of machine time that pass in one of LinuxCNC's."""
SLEW = 1e-6
"""Fastest change of an offset [m/s], machine time."""
COUNT = 1e-8
"""Offset of one count of the HAL file [m]."""
BRIDGE = {
    'axes': ['Y', 'Z'],
    'slew_max': SLEW,
    # a command reaches the bridge before the clock does, which goes in steps of about a second
    'lead_max': 60.0,
    'report_period': 10.0,
}
START_TIMEOUT = 30.0
"""Wall time [s] until the bridge allows offsets."""


def linuxcnc_demo(console: Console, out: Path, seed: int, rate: float = RATE) -> None:
    """Run the scenario into an empty folder and show what came of it.

    Parameters
    ----------
    console : Console
        Where it is shown.
    out : Path
        The folder.
    seed : int
        Seed of all measuring noise.
    rate : float
        Seconds of machine time that pass in one of LinuxCNC's.

    Raises
    ------
    GraphError
        If LinuxCNC cannot be had, a node fails, or the part program stopped.
    """
    result = play(partial(_linuxcnc_duty, rate=rate), console, out, seed)
    lacking = loss(out / 'bag')
    if lacking:
        complain(lacking)
        raise typer.Exit(LACKING)
    if not result['program_ran']:
        raise GraphError('the part program did not run to the end of the duty; see the report')


def _linuxcnc_duty(out: Path, seed: int, progress: Steps, rate: float) -> Outcome:
    from fuzzycnc_ros.components.thermal.compensator import CompensatorConfig
    from fuzzycnc_ros.core.thermal.fit import train_model
    from fuzzycnc_ros.studies.linuxcnc_duty import ClosedLoopLog
    from fuzzycnc_ros.studies.shift.shift_log import compensation_runs
    from fuzzycnc_ros.studies.shift.shift_report import shift_report
    from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration
    from fuzzycnc_ros.studies.thermal.report_page import report_page
    from fuzzycnc_ros.studies.thermal.summary import summary_document, summary_table

    with _linuxcnc(rate) as controller:
        with progress.step('calibrated on the simulated mill and trained models'):
            calibration = record_calibration(seed=seed)
            model = train_model(calibration.runs)
            text = model.to_json()
            (out / 'model.json').write_text(text, encoding='utf-8')
        with progress.step('started LinuxCNC, switched it on, homed it'):
            controller.start()
            controller.ready()
        outcome, ran = _run_live(out, controller, seed, rate, progress)
        version = str(controller.version())
    log = ClosedLoopLog.from_bag(out / 'bag')
    runs = compensation_runs(log, model, (DUTY,), offset_max=CompensatorConfig().offset_max)
    report = shift_report(
        runs,
        model,
        text,
        title='Thermal compensation through LinuxCNC',
        summary=(
            'A duty that no model had seen. LinuxCNC cut circles and turned the spindle; that '
            'heated a simulated mill, whose residual error was measured, with the offsets that '
            'LinuxCNC read back.'
        ),
        facts={
            'Controller': f'LinuxCNC {version}, headless, external offsets',
            'Machine': f'simulated mill, duty {DUTY}, noise seed {seed}, {rate:g} times real time',
        },
    )
    ticks, late = int(outcome.get('ticks', 0)), int(outcome.get('late', 0))
    result = {
        'runs': summary_document(runs),
        'linuxcnc': version,
        'rate': rate,
        'ticks': ticks,
        'late_ticks': late,
        'program_ran': ran,
        'wall_s': 0.0,
        'sensors': list(model.inputs),
        'model': dict(zip(model.channel, model.default, strict=True)),
        'seed': seed,
    }
    return Outcome(
        result,
        lambda: report_page(report),
        (summary_table(runs),),
        (
            f'LinuxCNC {version} cut circles at {rate:g} times real time for the machine; '
            f'{ticks} ticks, {late} of them late',
        ),
    )


@contextlib.contextmanager
def _linuxcnc(rate: float) -> Iterator[LinuxcncSimulation]:
    """Give a LinuxCNC that is not started yet; end it, and remove its files.

    Its folder is a temporary one, since as root LinuxCNC becomes a user who may not read others.
    """
    try:
        with exclusive():
            folder = Path(tempfile.mkdtemp(prefix='fuzzycnc-linuxcnc-'))
            # HAL limits offsets by the wall's clock, the bridge by that of the machine.
            controller = LinuxcncSimulation(folder, COUNTS_PER_SECOND=2.0 * rate * SLEW / COUNT)
            try:
                yield controller
            finally:
                controller.end()
                shutil.rmtree(folder, ignore_errors=True)
    except LinuxcncError as error:
        raise GraphError(str(error)) from error


def _run_live(
    out: Path, controller: LinuxcncSimulation, seed: int, rate: float, progress: Steps
) -> tuple[dict[str, Any], bool]:
    """Run the graph for a duty; return what the body says, and whether LinuxCNC cut to the end."""
    from fuzzycnc_ros.cli.live.operator_client import OperatorClient
    from fuzzycnc_ros.components.machine.simulated_machine_config import MACHINE_DUTIES
    from fuzzycnc_ros.runtime.records import Temperatures
    from fuzzycnc_ros.studies.linuxcnc_duty import duty_program

    program = controller.write_program('duty', duty_program(MACHINE_DUTIES[DUTY], rate))
    common = {'use_sim_time': True}
    active = {**common, 'autostart': True}
    specs = [
        NodeSpec('linuxcnc_bridge', {**active, **BRIDGE}),
        NodeSpec('temperature_acquisition', common),
        NodeSpec('thermal_predictor', {**common, 'model': str(out / 'model.json')}),
        NodeSpec('compensator', active),
        NodeSpec('recorder', {**common, 'output': str(out / 'bag')}),
    ]
    names = [spec.name for spec in specs]
    body = {'duty': DUTY, 'rate': rate, 'seed': seed, 'nodes': names}
    with GraphProcesses(MACHINE, folder=out / 'log') as graph:
        with progress.step(f'started {len(specs)} nodes'):
            for spec in specs:
                graph.start(spec)
            operator = OperatorClient(MACHINE, graph.check)
        with operator, progress.step(f'compensated {DUTY} while LinuxCNC cut circles') as bar:
            # Only when machine time passes does the bridge repeat what it has told.
            graph.start(NodeSpec('simulated_body', body))
            _await_bridge(operator)
            operator.newest(Temperatures, 'sensor_readings')
            operator.set_reference('operator')
            controller.run(program)
            length = MACHINE_DUTIES[DUTY].duration / rate
            begun = time.monotonic()
            while time.monotonic() - begun < length - 2.0:
                operator.spin_once(0.5)
                graph.check()
                bar.update(round(time.monotonic() - begun), round(length))
            ran = bool(controller.state()['running'])
            graph.wait('simulated_body', RUN_TIMEOUT)
        return ended(graph, 'simulated_body'), ran


def _await_bridge(operator: Any) -> None:
    """Wait until the bridge has found LinuxCNC and takes offsets.

    Raises
    ------
    GraphError
        If it does not in time.
    """
    from fuzzycnc_ros.runtime.records import MachineState

    until = time.monotonic() + START_TIMEOUT
    while not operator.newest(MachineState, 'machine_state').offsets_allowed:
        if time.monotonic() > until:
            raise GraphError(f'linuxcnc_bridge does not allow offsets within {START_TIMEOUT:g} s')

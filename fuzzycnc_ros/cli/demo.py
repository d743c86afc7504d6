# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc demo`: calibrate, then compensate unseen duties live over DDS, and show it."""

import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from fuzzycnc_ros.cli.console import show
from fuzzycnc_ros.cli.graph_processes import GraphError, GraphProcesses
from fuzzycnc_ros.cli.up import BANNER, node_specs

MACHINE = 'mill'
CALIBRATION = ('D0', 'D0b', 'T1')
UNSEEN = ('T2', 'T3')
RUN_TIMEOUT = 300.0


@dataclass
class DemoResult:
    """What the demo found, as it is written to `summary.json`."""

    runs: dict[str, Any]
    latency_ms: dict[str, float]
    wall_s: float
    hash: str
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float
    sensors: list[str]
    model: dict[str, str]
    seed: int


def demo(
    out: Annotated[
        Path, typer.Option(help='Folder for the bag, the report and the summary; it is renewed.')
    ] = Path('build/demo'),
    seed: Annotated[int, typer.Option(help='Seed of all measuring noise.')] = 0,
) -> None:
    """Watch a simulated mill warm up for two shifts while its thermal error is compensated.

    Calibration runs are recorded first.  Then every node comes up as a process of its own; over
    DDS they select sensors, train models, and compensate two duties that no model has seen, in
    lock-step with the simulated machine.  At the end there are a table, a bag that is replayed
    and compared, a report with plots, and the figures as JSON.
    """
    console = Console()
    console.print(BANNER, style='yellow')
    started = time.monotonic()
    _renew(out)
    with _progress(console) as progress:
        result, table = _run(out, seed, progress, started)
    (out / 'summary.json').write_text(json.dumps(vars(result), indent=2) + '\n', encoding='utf-8')
    show(table)
    _print_facts(console, out, result)
    if result.degraded or not result.replay_identical:
        raise GraphError('the run was degraded or its replay differs; see the notes in the report')


def _renew(out: Path) -> None:
    """Empty the demo's folder, but nothing that is not a demo's."""
    known = {'summary.json', 'report.html', 'model.json', 'bag', 'calibration', 'log', 'latency'}
    if out.exists():
        strange = sorted(item.name for item in out.iterdir() if item.name not in known)
        if strange:
            raise GraphError(f'--out {out}: expected an empty folder but found {strange[0]}')
        shutil.rmtree(out)
    out.mkdir(parents=True)


@contextmanager
def _progress(console: Console) -> Iterator['_Steps']:
    columns = (SpinnerColumn(), TextColumn('{task.description}'), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        yield _Steps(console, progress)


class _Steps:
    """One line for each step: a bar while it runs, its time when it is done."""

    def __init__(self, console: Console, progress: Progress) -> None:
        self._console, self._progress = console, progress

    @contextmanager
    def step(self, text: str) -> Iterator['_Bar']:
        started = time.monotonic()
        task = self._progress.add_task(text, total=None)
        yield _Bar(self._progress, task)
        self._progress.remove_task(task)
        self._console.print(f'  {time.monotonic() - started:5.1f} s  {text}')


@dataclass
class _Bar:
    progress: Progress
    task: Any

    def update(self, done: int, total: int) -> None:
        self.progress.update(self.task, completed=done, total=total)


def _run(out: Path, seed: int, progress: _Steps, started: float) -> tuple[DemoResult, Any]:
    from fuzzycnc_ros.bags.replay import replay
    from fuzzycnc_ros.cli.latency import measure_latency
    from fuzzycnc_ros.components.compensator import CompensatorConfig
    from fuzzycnc_ros.core.thermal import load_model
    from fuzzycnc_ros.report import summary_document, summary_table
    from fuzzycnc_ros.scenario import ShiftLog, compensation_runs, record_calibration

    # A graph of its own: whatever else runs on this host must not mix with the demo.
    os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)
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
    with progress.step('measured latency between two processes'):
        latency = measure_latency(model_file, out / 'latency')
    with progress.step('wrote the report'):
        log = ShiftLog.from_bag(out / 'bag')
        runs = compensation_runs(log, model, UNSEEN, offset_max=CompensatorConfig().offset_max)
        result = DemoResult(
            runs=summary_document(runs),
            latency_ms={
                'median': 1e3 * float(np.median(latency)),
                'p99': 1e3 * float(np.quantile(latency, 0.99)),
            },
            wall_s=0.0,
            hash=replayed.hash,
            replay_identical=replayed.identical,
            degraded=bool(outcome.get('degraded', True)),
            ticks=int(outcome.get('ticks', 0)),
            ticks_per_second=round(outcome.get('ticks', 0) / live_s, 1),
            sensors=list(model.inputs),
            model=dict(zip(model.channel, model.default, strict=True)),
            seed=seed,
        )
        _write_report(out, runs, model, calibration.runs, latency, result, replayed.notes)
    result.wall_s = round(time.monotonic() - started, 2)
    return result, summary_table(runs)


def _run_live(
    out: Path, bags: list[Path], seed: int, progress: _Steps
) -> tuple[dict[str, Any], float]:
    """Run the graph over the unseen duties; return how the machine says it went, and the time."""
    from fuzzycnc_ros.cli.operator import Operator

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
            operator = Operator(MACHINE, graph.check)
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
        outcome = graph.outcome('simulated_machine')
        graph.stop()
        graph.check()
    return outcome, live_s


def _write_report(
    out: Path,
    runs: Any,
    model: Any,
    calibration: Any,
    latency: list[float],
    result: DemoResult,
    notes: list[str],
) -> None:
    from fuzzycnc_ros.report import Latency, render_html
    from fuzzycnc_ros.scenario import shift_report

    data = shift_report(
        runs,
        model,
        (out / 'model.json').read_text(encoding='utf-8'),
        title='Thermal compensation of two shifts',
        summary=(
            'Two duties that no model had seen, compensated live over DDS. The residual is what '
            'is left of the measured displacement after the prediction.'
        ),
        notes=notes,
        calibration=calibration,
        latency=Latency(np.array(latency)),
        facts={
            'Machine': f'simulated mill, duties {", ".join(UNSEEN)}, noise seed {result.seed}',
            'Ticks': f'{result.ticks}, {result.ticks_per_second:.0f} per second over DDS',
            'Replay': 'identical' if result.replay_identical else 'differs',
            'Canonical hash': result.hash,
        },
    )
    (out / 'report.html').write_text(render_html(data), encoding='utf-8')


def _print_facts(console: Console, out: Path, result: DemoResult) -> None:
    latency = result.latency_ms
    console.print(
        f'temperatures to compensation over DDS: median {latency["median"]:.2f} ms, '
        f'p99 {latency["p99"]:.2f} ms'
    )
    replayed = 'identical' if result.replay_identical else 'DIFFERS'
    console.print(f'replay of the bag: {replayed}, hash {result.hash[:16]}')
    console.print(
        f'{result.ticks} ticks at {result.ticks_per_second:.0f} per second; '
        f'{result.wall_s:.0f} s in all'
    )
    for name, what in (
        ('report.html', 'the report; open it in a browser'),
        ('bag', 'everything that was on the topics'),
        ('summary.json', 'the figures'),
    ):
        console.print(f'{out / name}: {what}', soft_wrap=True)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up`: the whole graph of one machine, as processes or composed in one."""

import json
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from rich.console import Console

from fuzzycnc_ros.cli.graph_processes import (
    GraphError,
    GraphProcesses,
    NodeSpec,
    parameter_file,
    ros_arguments,
)

BANNER = (
    'fuzzycnc is not a safety function (ISO 13849): emergency stop, limit switches and drive '
    'limits stay in hardware.'
)
POLL = 0.2


def node_specs(
    *,
    duties: tuple[str, ...] = (),
    model: Path | None = None,
    record: Path | None = None,
    lockstep: bool = False,
    autostart: bool = False,
    state_directory: Path | None = None,
    feedrate: bool = False,
    machine_parameters: dict[str, Any] | None = None,
) -> list[NodeSpec]:
    """Return the nodes of a thermal compensation graph, the simulated machine last.

    Parameters
    ----------
    duties : tuple of str
        Duties of the simulated machine; empty leaves it out, for a real machine.
    model : Path, optional
        Model file of the predictor.
    record : Path, optional
        Bag to record; none if left out.
    lockstep : bool
        Whether the simulated machine gives turns instead of following the clock.
    autostart : bool
        Whether the managed nodes become active by themselves.
    state_directory : Path, optional
        Where nodes keep what must survive a restart.
    feedrate : bool
        Whether the feedrate scheduler takes part.
    machine_parameters : dict, optional
        Further parameters of the simulated machine.
    """
    common: dict[str, Any] = {'lockstep': lockstep}
    if duties and not lockstep:
        common['use_sim_time'] = True
    kept = dict(common)
    if state_directory is not None:
        kept['state_directory'] = str(state_directory)
    predictor = dict(kept, **({'model': str(model)} if model is not None else {}))
    specs = [
        NodeSpec('temperature_acquisition', kept),
        NodeSpec('sensor_selector', kept),
        NodeSpec('thermal_predictor', predictor),
        NodeSpec('compensator', dict(common, autostart=autostart)),
    ]
    if feedrate:
        specs.append(NodeSpec('feedrate_scheduler', dict(common, autostart=autostart)))
    served = [spec.name for spec in specs]
    if record is not None:
        specs.append(NodeSpec('recorder', dict(common, output=str(record))))
    if duties:
        machine = {
            'duties': list(duties),
            'lockstep': lockstep,
            'lockstep_nodes': served,
            'lockstep_recorder': record is not None,
            **(machine_parameters or {}),
        }
        specs.append(NodeSpec('simulated_machine', machine))
    return specs


def up(
    machine: Annotated[
        str, typer.Option(help='Name of the machine: the namespace of its nodes.')
    ] = 'mill',
    simulate: Annotated[
        str,
        typer.Option(
            help='Duties of the simulated machine, comma-separated (D0, D0b, T1, T2, T3); '
            'leave it out for a real machine.'
        ),
    ] = '',
    model: Annotated[
        Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(help='Model file of the predictor, made by `fuzzycnc train`.'),
    ] = None,
    record: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help='Record everything into this new bag.'),
    ] = None,
    params: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help='Folder with parameter files <node>.yaml.'),
    ] = None,
    rate: Annotated[
        float, typer.Option(help='Speed of the simulated machine; 1 is real time.')
    ] = 1.0,
    lockstep: Annotated[
        bool,
        typer.Option(help='Run the simulated machine as fast as all nodes answer, repeatably.'),
    ] = False,
    compose: Annotated[
        bool, typer.Option(help='Put all nodes into one process instead of one each.')
    ] = False,
    autostart: Annotated[
        bool,
        typer.Option(help='Activate the managed nodes; without it a lifecycle manager or you do.'),
    ] = False,
    feedrate: Annotated[
        bool, typer.Option(help='Start the feedrate scheduler too, which runs tool paths.')
    ] = False,
    state_directory: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help='Where nodes keep what must survive a restart.'),
    ] = None,
    json_file: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option('--json', help='Write how the run ended to this file.'),
    ] = None,
) -> None:
    """Bring up the graph of one machine; Ctrl-C takes all of it down.

    With a simulated machine, a whole shift at 600 times real time, recorded:

        fuzzycnc up --simulate T2 --rate 600 --model mill.json --autostart --record shift

    For a real machine, whose temperatures and state other nodes publish:

        fuzzycnc up --machine mill_1 --model mill_1.json --params /etc/fuzzycnc
    """
    console = Console(stderr=True)
    console.print(BANNER, style='yellow')
    if lockstep and not simulate:
        raise GraphError('--lockstep needs a simulated machine; add --simulate T2')
    duties = tuple(item.strip() for item in simulate.split(',') if item.strip())
    specs = node_specs(
        duties=duties,
        model=model,
        record=record,
        lockstep=lockstep,
        autostart=autostart,
        state_directory=state_directory,
        feedrate=feedrate,
        machine_parameters={'rate': rate},
    )
    files = _parameter_files(params)
    started = time.monotonic()
    if compose:
        outcome = _run_composed(machine, specs, files)
    else:
        outcome = _run_processes(console, machine, specs, files)
    outcome['wall_s'] = round(time.monotonic() - started, 3)
    if json_file is not None:
        json_file.write_text(json.dumps(outcome, indent=2) + '\n', encoding='utf-8')
    if outcome['exit_code']:
        raise typer.Exit(int(outcome['exit_code']))


def _parameter_files(folder: Path | None) -> list[Path]:
    if folder is None:
        return []
    files = sorted(folder.glob('*.yaml'))
    if not files:
        raise GraphError(f'--params {folder}: expected files <node>.yaml but found none')
    return files


def _run_composed(machine: str, specs: list[NodeSpec], files: list[Path]) -> dict[str, Any]:
    from fuzzycnc_ros.nodes.composed import run_composed
    from fuzzycnc_ros.nodes.environment import limit_to_this_host

    limit_to_this_host()
    namespace = f'/{machine.strip("/")}'
    with tempfile.TemporaryDirectory(prefix='fuzzycnc-') as folder:
        own = parameter_file(Path(folder), namespace, specs)
        names = [spec.name for spec in specs]
        code = run_composed(names, ros_arguments(namespace, [*files, own]))
    return {'nodes': names, 'exit_code': code}


def _run_processes(
    console: Console, machine: str, specs: list[NodeSpec], files: list[Path]
) -> dict[str, Any]:
    with GraphProcesses(machine, params=files) as graph:
        for spec in specs:
            graph.start(spec)
        console.print(
            f'{len(specs)} nodes of {machine} are up: {", ".join(spec.name for spec in specs)}; '
            'Ctrl-C ends them'
        )
        ended: dict[str, int] = {}
        try:
            while 'simulated_machine' not in ended:
                time.sleep(POLL)
                graph.check()
                ended = graph.poll()
                if ended and 'simulated_machine' not in ended:
                    raise GraphError(f'{", ".join(ended)} ended by itself; the graph is down')
        except KeyboardInterrupt:
            console.print('ending all nodes')
        graph.stop()
        outcome = graph.outcome('simulated_machine')
        return {'nodes': [spec.name for spec in specs], 'exit_code': 0, **outcome}

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up`: the whole graph of one machine, as processes or composed in one."""

import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated, Optional

import typer

from fuzzycnc_ros.cli.bags.keeping import (
    Budget,
    FreeMin,
    Ship,
    SplitDuration,
    SplitSize,
    keeping_parameters,
)
from fuzzycnc_ros.cli.completion import node_names, some_of
from fuzzycnc_ros.cli.console import check_folder, check_ros, words, write_json
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.cli.live.page_process import Page, page_process
from fuzzycnc_ros.cli.live.supervision_run import check_free, supervise
from fuzzycnc_ros.cli.options import DUTIES
from fuzzycnc_ros.cli.terminal import Terminal
from fuzzycnc_ros.graph.bring_up import (
    BANNER,
    PAGE,
    THERMAL,
    bag_of,
    clock_remapping,
    known_nodes,
    machine_name,
    node_specs,
    with_files,
)
from fuzzycnc_ros.ros.leftovers import TemporaryFolder
from fuzzycnc_ros.ros.parameter_files import parameter_files, sections, unread
from fuzzycnc_ros.ros.presence import MACHINE, GraphError, Presence
from fuzzycnc_ros.ros.processes import open_to_network
from fuzzycnc_ros.ros.service_manager import ServiceManager


def up(
    machine: Annotated[
        str,
        typer.Option(
            help='Name of the machine: the namespace of its nodes. Several, comma-separated, get '
            'the same nodes each.'
        ),
    ] = 'mill',
    simulate: Annotated[
        str,
        typer.Option(
            metavar='DUTY,...',
            show_default=False,
            help=f'Duties of the simulated machine, comma-separated: {", ".join(DUTIES)}. Each '
            'begins a day later with a cold machine, at once after the one before. Leave it out '
            'for a real machine.',
            autocompletion=some_of(DUTIES),
        ),
    ] = '',
    model: Annotated[
        Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(help='Model file of the predictor, made by `fuzzycnc train`.'),
    ] = None,
    force_model: Annotated[
        bool,
        typer.Option(
            '--force-model',
            help='Use the model even if it was worse than no compensation on held-out runs; '
            'without this such a model is refused.',
        ),
    ] = False,
    learn: Annotated[
        bool,
        typer.Option(
            '--learn',
            help='Learn from probes: what the model leaves, or all of it without a model. An '
            'axis is followed once it is known well enough, at first in part, until a probe '
            'confirms it.',
        ),
    ] = False,
    record: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help='Record everything into this new bag; with several machines one each, named '
            '<bag>_<machine>.'
        ),
    ] = None,
    split_size: SplitSize = None,
    split_duration: SplitDuration = None,
    budget: Budget = None,
    free_min: FreeMin = None,
    ship: Ship = None,
    params: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help='Folder with parameter files <node>.yaml; entries that no node reads are named.'
        ),
    ] = None,
    machine_file: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            metavar='FILE.yaml',
            show_default=False,
            help='Machine file whose values the nodes get; --params overrules them.',
        ),
    ] = None,
    nodes: Annotated[
        str,
        typer.Option(
            metavar='NODE,...',
            show_default=False,
            help='Nodes to run, comma-separated, in place of those of thermal compensation.',
            autocompletion=some_of(node_names),
        ),
    ] = '',
    rate: Annotated[
        float, typer.Option(help='Speed of the simulated machine; 1 is real time.')
    ] = 1.0,
    lockstep: Annotated[
        bool,
        typer.Option(help='Run the simulated machine as fast as all nodes answer, repeatably.'),
    ] = False,
    compose: Annotated[
        bool, typer.Option(help='Put all nodes of a machine into one process.')
    ] = False,
    autostart: Annotated[
        bool,
        typer.Option(
            help='Activate the managed nodes; without it do that yourself, by `fuzzycnc operate '
            'activate` or a lifecycle manager.'
        ),
    ] = False,
    feedrate: Annotated[
        bool, typer.Option(help='Start the feedrate scheduler too, which runs tool paths.')
    ] = False,
    state_directory: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            help='Folder for what must survive a restart. Without it that survives restarts of '
            'nodes, but not the end of this command.'
        ),
    ] = None,
    page: Page = None,
    network: Annotated[
        bool, typer.Option(help='Let other hosts of the network find the graph.')
    ] = False,
    takeover: Annotated[
        bool,
        typer.Option('--takeover', help='Start even if nodes of these names are running.'),
    ] = False,
    json_file: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option('--json', help='Write how the run ended to this file.'),
    ] = None,
) -> None:
    """Bring up and supervise the graph of one machine or several; Ctrl-C takes all of it down.

    A node that dies is started again, after a longer wait each time. After five times within two
    minutes it is given up, and the exit code is 1. Its state is kept, so that compensation
    continues without a step. With --autostart a managed node that was active becomes active again.

    With a simulated machine, a whole shift at 600 times real time, recorded:

        fuzzycnc up --simulate T2 --rate 600 --model mill.json --autostart --record shift

    For a real machine whose temperatures and state are published by other nodes:

        fuzzycnc up --machine mill_1 --model mill_1.json --params /etc/fuzzycnc

    A machine without a model, which learns from its probes (`fuzzycnc operate probe`):

        fuzzycnc up --machine mill_1 --learn --params /etc/fuzzycnc --autostart

    The same with a page for the browser of this computer, at the port given or 8642:

        fuzzycnc up --machine mill_1 --model mill_1.json --page

    Two machines, all nodes of each in one process:

        fuzzycnc up --machine mill_1,mill_2 --compose --model mill.json
    """
    check_folder(json_file)
    console = Terminal(stderr=True)
    duties = words([simulate])
    chosen = words([nodes]) or THERMAL
    if lockstep and not duties and MACHINE not in chosen:
        raise GraphError('--lockstep needs a simulated machine; add --simulate T2')
    keeping = keeping_parameters(split_size, split_duration, budget, free_min, ship)
    if keeping and record is None:
        raise GraphError(
            'expected --record, too: --split-size, --split-duration, --budget, --free-min and '
            '--ship say how its bag is kept'
        )
    machines = tuple(dict.fromkeys(machine_name(name) for name in words([machine])))
    if not machines:
        raise GraphError('--machine: expected a name but found none')
    check_ros('up')
    if network:
        open_to_network()
    # Here, so that `fuzzycnc --help` works where ROS is not installed.
    from fuzzycnc_ros.cli.live.parameter_check import check_parameters
    from fuzzycnc_ros.cli.live.supervision_monitor import Monitor

    # After ROS was imported: that may begin this process anew, with its environment.
    manager = ServiceManager()
    own_files = parameter_files(params, '--params ')
    read = sections(own_files)
    started = time.monotonic()
    with ExitStack() as stack:
        files = own_files
        if machine_file is not None:
            folder = stack.enter_context(TemporaryFolder())
            files = [_of_machine(machine_file, folder), *own_files]
        # It listens while the parameters are checked.
        monitor = stack.enter_context(closing(Monitor(machines)))
        graphs = []
        plans = []
        bags = []
        overruled: list[str] = []
        running = [] if page is None else [f'/{PAGE}']
        for name in machines:
            own_clock = clock_remapping(machines)
            graph = stack.enter_context(GraphProcesses(name, params=files, remap=own_clock))
            graphs.append(graph)
            bag = bag_of(name, machines, record)
            bags += [str(bag)] if bag is not None else []
            specs = node_specs(
                nodes=chosen,
                duties=duties,
                model=model,
                force_model=force_model,
                learn=learn,
                record=bag,
                lockstep=lockstep,
                autostart=autostart,
                state_directory=state_directory or graph.folder / 'state',
                feedrate=feedrate,
                machine_parameters={'rate': rate} if duties else None,
                recorder_parameters=keeping,
            )
            unasked = {
                *(['state_directory'] if state_directory is None else []),
                *(['rate'] if rate == 1.0 else []),
            }
            for place, spec in enumerate(specs):
                specs[place], more = with_files(spec, name, read, unasked)
                overruled += more
            plans.append([tuple(specs)] if compose else [(spec,) for spec in specs])
            running += [f'/{name}/{spec.name}' for spec in specs]
        said = [] if params is None else unread(params, read, running, known_nodes())
        check_parameters(graphs, plans)
        if not takeover:
            presence = stack.enter_context(Presence())
            check_free(monitor, presence, dict(zip(machines, plans, strict=True)))
        console.print(BANNER, style='yellow', soft_wrap=True)
        for text in [*said, *dict.fromkeys(overruled)]:
            console.print(f'--params {text}', style='yellow', soft_wrap=True, markup=False)
        with page_process(console, page, record, params=own_files) as beside:
            outcome = supervise(console, monitor, graphs, plans, manager, beside)
    outcome['wall_s'] = round(time.monotonic() - started, 3)
    console.print(
        f'ended after {outcome["wall_s"]:.0f} s'
        + (f'; recorded {", ".join(bags)}' if bags else ''),
        soft_wrap=True,
    )
    write_json(json_file, outcome)
    if outcome['exit_code']:
        raise typer.Exit(int(outcome['exit_code']))


def _of_machine(file: str, folder: Path) -> Path:
    """Write the parameters that a machine file decides; return where."""
    from fuzzycnc_ros.machine_file.parameters import parameter_text
    from fuzzycnc_ros.machine_file.reader import read_machine_file

    path = folder / 'machine.yaml'
    path.write_text(parameter_text(read_machine_file(file)), encoding='utf-8')
    return path

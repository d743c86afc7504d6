# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc demo`: the product at work on a simulated machine, live over DDS."""

from enum import Enum
from functools import partial
from pathlib import Path
from typing import Annotated, Optional

import typer

from fuzzycnc_ros.cli.demo.axis import axis
from fuzzycnc_ros.cli.demo.contour import contour
from fuzzycnc_ros.cli.demo.learn import learn
from fuzzycnc_ros.cli.demo.linuxcnc import linuxcnc_demo
from fuzzycnc_ros.cli.demo.pattern import pattern
from fuzzycnc_ros.cli.demo.shift import whole_shift
from fuzzycnc_ros.cli.demo.steps import Play, play, renewed
from fuzzycnc_ros.cli.demo.thermal import thermal
from fuzzycnc_ros.cli.live.page_process import Page
from fuzzycnc_ros.cli.programs.program_files import program_lines
from fuzzycnc_ros.cli.terminal import Terminal
from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.graph.bring_up import BANNER
from fuzzycnc_ros.ros.presence import GraphError


class Scenario(str, Enum):
    """Scenarios of the demo."""

    thermal = 'thermal'
    learn = 'learn'
    axis = 'axis'
    contour = 'contour'
    pattern = 'pattern'
    shift = 'shift'
    linuxcnc = 'linuxcnc'


def demo(
    out: Annotated[
        Path, typer.Option(help='Folder for the bag, the report and the summary; it is renewed.')
    ] = Path('build/demo'),
    scenario: Annotated[
        Scenario, typer.Option(help='What to show; the text above describes each.')
    ] = Scenario.thermal,
    seed: Annotated[int, typer.Option(help='Seed of all measuring noise.')] = 0,
    program: Annotated[
        Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            metavar='FILE',
            show_default=False,
            help='Part program to cut in the scenario shift, in mm unless it says G20; without it '
            'a plate that comes with the package.',
        ),
    ] = None,
    page: Page = None,
) -> None:
    """Watch a simulated mill warm up for two shifts while its thermal error is compensated.

    Calibration runs are recorded first.  Then every node comes up as a process of its own; over
    DDS they select sensors, train models, and compensate two duties that no model has seen, in
    lock-step with the simulated machine.  At the end there are a table, a bag that is replayed
    and compared, a report with plots, and the figures as JSON:

        fuzzycnc demo

    Or watch a mill without any model learn its error from a probe an hour, over three days.  Each
    begins cold; what was learnt is carried on, and compensates:

        fuzzycnc demo --scenario learn --out build/learn

    Or watch a mill without linear scales, whose largest error lies along its axes: ball screws
    warm up by their own motion, and offset and slope of each axis are compensated:

        fuzzycnc demo --scenario axis --out build/axis

    Or watch its axes follow a curve at a contour error of 0.05 mm: the feed is scheduled, sent
    as a trajectory, and followed every millisecond:

        fuzzycnc demo --scenario contour --out build/contour

    Or watch it stitch a parallelogram on a sheet of foam, without compensation and with that of a
    trained T-S fuzzy neural network:

        fuzzycnc demo --scenario pattern --out build/pattern

    Or watch a shift of eight hours with everything on: the mill warms up and cools down, cuts
    curves and a part program on servo axes in between, and a second machine stitches foam:

        fuzzycnc demo --scenario shift --out build/shift

    Or watch a real controller take the offsets: a LinuxCNC without a screen cuts circles and turns
    the spindle, which heats the simulated mill; needs LinuxCNC on this computer:

        fuzzycnc demo --scenario linuxcnc --out build/linuxcnc

    With --page the live page of the machines is served meanwhile, and stays until Ctrl-C.
    """
    if program is not None and scenario is not Scenario.shift:
        raise GraphError('--program: expected --scenario shift, which alone cuts a program')
    text = _checked_program(program) if program is not None else ''
    console = Terminal()
    console.print(BANNER, style='yellow')
    with renewed(out):
        if scenario is Scenario.linuxcnc:
            if page is not None:
                raise GraphError('--page: expected a scenario with a graph of its own')
            linuxcnc_demo(console, out, seed)
            return
        run: dict[Scenario, Play] = {
            Scenario.thermal: thermal,
            Scenario.learn: learn,
            Scenario.axis: axis,
            Scenario.contour: contour,
            Scenario.pattern: pattern,
            Scenario.shift: partial(whole_shift, program=text),
        }
        play(run[scenario], console, out, seed, page)


def _checked_program(path: Path) -> str:
    """Return the text of a part program that the shift can cut.

    Raises
    ------
    ValueError
        If there is none or it cannot be cut; the message says why.
    """
    from fuzzycnc_ros.studies.shift.whole_shift import check_program

    with program_lines(path) as file:
        data = file.read_bytes()
    try:
        text = decoded(data, errors='backslashreplace')
        check_program(text)
    except ValueError as error:
        raise ValueError(f'--program {path}: {error}') from error
    return text

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc advise` on real part programs and a real LinuxCNC, against a grid of own feeds.

Of each program the first seconds of motion run on LinuxCNC without a screen: as advised, and with
their own feeds under every acceleration and path mode of a grid, whose front is read at
the largest error of what is advised.  Feed shares along the path compete with the other remedies,
so that the component `fuzzycnc_feed` must be installed (`fuzzycnc linuxcnc install --feed`).
HAL's `sampler` records what is commanded; contour errors are those of axes that follow with the
lags of the simulated machine.  Run with `python benchmarks/linuxcnc_advice.py --programs FOLDER
[--json FILE]`, as a user who may start LinuxCNC; others may do so while advice is looked for.
Runs that FILE has are not made again.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.recorder import PERIOD, Recorder, recording
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.motion.program_request import program_settings
from fuzzycnc_ros.core.feedrate.gcode.blocks import Program
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import (
    PathMode,
    path_modes,
    program_moves,
    simulate,
)
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.programs.adaptive_feed import ADAPTIVE_MODE
from fuzzycnc_ros.studies.programs.advice import Adviser, advised_program
from fuzzycnc_ros.studies.programs.path_mode_words import program_with_mode
from fuzzycnc_ros.studies.programs.program_judge import ProgramPath, ProgramResult

LIMITS = ControllerLimits(velocity=(0.4,) * 3, acceleration=(2.0,) * 3, path_velocity=0.5)
MACHINE = ContouringConfig()
OWN_MODE = PathMode(1e-5, 1e-5)
"""What a program runs with that says no path mode of its own."""
ACCELERATIONS = (4.0, 2.0, 1.4, 1.0, 0.7, 0.5)
"""Of the grid, in shares of tolerance / C [-]."""
MODES = (0.5, 0.05)
"""P and Q of the grid, in shares of the tolerance [-]."""
TIMEOUT = 300.0
HEAD = 'G21 G90 G94 G17 G40\n'
LEFT_OUT = re.compile(r'[mM]\s*0*(?:[0126]|30)\b(?![\d.])|[tTsShH]\s*\d+|[gG]43\b|^\s*%.*$')
"""Words that ask for a person, a tool or a spindle, or end the program."""


def beginning(path: Path, seconds: float) -> Program:
    """Return the first lines of a program, as many as move for so long with their own feeds."""
    text = path.read_text(encoding='utf-8', errors='replace')
    lines = [LEFT_OUT.sub('', line) for line in text.splitlines()]
    low, high = 0, len(lines) + 1
    while high - low > 1:
        middle = (low + high) // 2
        if duration(lines[:middle]) < seconds:
            low = middle
        else:
            high = middle
    return read_program(text_of(lines[:low]))


def text_of(lines: list[str]) -> str:
    """Return lines as a program."""
    return HEAD + '\n'.join(line for line in lines if line.strip()) + '\nM2\n'


def duration(lines: list[str]) -> float:
    """Return the time that lines of a program take [s]; 0 where nothing moves."""
    blocks = read_program(text_of(lines)).blocks
    if not any(block.segment is not None and block.segment.length > 0.0 for block in blocks):
        return 0.0
    return sum(one.duration for one in simulate(program_moves(blocks, OWN_MODE), LIMITS))


class Stand:
    """A LinuxCNC, and what its runs have shown; and what was advised."""

    def __init__(self, memory: Path | None) -> None:
        self._memory = memory
        self.recorder: Recorder | None = None
        known = memory is not None and memory.exists()
        self._found = json.loads(memory.read_text()) if memory and known else {}

    def advice(self, name: str, find: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return what is advised, if need be as it is found now."""
        if f'{name}, advice' not in self._found:
            self._found[f'{name}, advice'] = find()
            self._keep()
        return dict(self._found[f'{name}, advice'])

    def _keep(self) -> None:
        if self._memory is not None:
            self._memory.write_text(json.dumps(self._found, indent=1))

    def run(
        self, name: str, text: str, path: ProgramPath, acceleration: float, table: str = ''
    ) -> ProgramResult:
        """Run a program, if that has not been done."""
        if name not in self._found:
            recorder = self.recorder
            assert recorder is not None
            recorder.limit(LIMITS.velocity, LIMITS.acceleration)
            recorder.origin()
            recorder.limit(LIMITS.velocity, (acceleration,) * 3)
            if table:
                recorder.follow(table)
            samples = recorder.run(text, TIMEOUT)
            judged = path.judge(path.recorded(samples, PERIOD), MACHINE)
            self._found[name] = asdict(judged)
            print(f'{name}: {judged.duration:.2f} s, {1e6 * judged.error:.1f} um',
                  file=sys.stderr, flush=True)  # fmt: skip
            self._keep()
        return ProgramResult(**self._found[name])


@dataclass(frozen=True)
class Case:
    """The beginning of a program, and what is advised for it."""

    file: str
    name: str
    program: Program
    true: ProgramPath
    advice: dict[str, Any]


def prepared(stand: Stand, path: Path, seconds: float, tolerance: float) -> Case:
    """Return the beginning of a program with what is advised."""
    program = beginning(path, seconds)
    if all(mode == PathMode() for _, mode in path_modes(program.blocks)):
        program = read_program(program_with_mode(program.text, OWN_MODE))
    name = f'{path.name}, {seconds:g} s, {1e6 * tolerance:g} um'
    true = ProgramPath(program_moves(program.blocks))
    chosen = stand.advice(name, lambda: advised(program, tolerance))
    return Case(path.name, name, program, true, chosen)


def compare(stand: Stand, case: Case, tolerance: float) -> list[tuple[str, ...]]:
    """Return the rows of a program: as it is, the grid at the advised one's error, as advised."""
    program, true, name, chosen = case.program, case.true, case.name, case.advice
    own = stand.run(f'{name}, as it is', program.text, true, LIMITS.acceleration[0])
    rise = chosen['acceleration']
    best = stand.run(f'{name}, advised', chosen['program'], true, rise, chosen['table'])
    grid = []
    for share in MODES:
        mode = PathMode(share * tolerance, share * tolerance)
        for factor in ACCELERATIONS:
            limit = min(factor * tolerance / MACHINE.contour_constant, LIMITS.acceleration[0])
            text = program_with_mode(program.text, mode)
            what = f'{mode.word}, {1e3 * limit:.0f} mm/s²'
            grid.append(stand.run(f'{name}, {what}', text, true, limit))
    simulated = ProgramResult(**chosen['judged'])
    what = f'advised: {chosen["name"]}, {1e3 * rise:.0f} mm/s², {chosen["mode"]}'
    rival = front_at([(one.error, one.duration) for one in grid], best.error)
    gain = f'{100.0 * (1.0 - best.duration / rival):+.0f} %' if rival < inf else 'no rival'
    return [
        row(case.file, 'as it is', own, None),
        ('', 'grid at the error of the advised one', f'{rival:.2f}', f'{1e6 * best.error:.1f}',
         *[''] * 4),
        (*row('', what, best, simulated)[:-1], gain),
    ]  # fmt: skip


def front_at(runs: Sequence[tuple[float, float]], error: float) -> float:
    """Return the least time that runs of (error, time) have at an error, interpolated.

    Infinite where none leaves so little.
    """
    front: list[tuple[float, float]] = []
    for one in sorted(runs):
        if not front or one[1] < front[-1][1]:
            front.append(one)
    if error < front[0][0]:
        return inf
    return float(np.interp(error, *zip(*front, strict=True)))


def advised(program: Program, tolerance: float) -> dict[str, Any]:
    """Return what is advised for a program."""
    settings = program_settings(FeedrateSchedulerConfig(tolerance=tolerance, blend=1e-5))
    adviser = Adviser(program, tolerance, LIMITS, MACHINE, settings)
    chosen = adviser.advise('split', adaptive=True).chosen
    mode = chosen.mode.word if chosen.mode else "program's path mode"
    return {
        'name': chosen.name,
        'acceleration': chosen.acceleration[0],
        'mode': mode if chosen.table is None else f'{ADAPTIVE_MODE.word}, M52 P1',
        'program': advised_program(program, chosen),
        'table': '' if chosen.table is None else chosen.table.text(),
        'judged': asdict(chosen.judged),
    }


def row(
    name: str, what: str, judged: ProgramResult, simulated: ProgramResult | None
) -> tuple[str, ...]:
    """Return the figures of a run, with those of the simulated controller."""
    beside = ('', '')
    if simulated is not None:
        beside = f'{simulated.duration:.2f}', f'{1e6 * simulated.error:.1f}'
    return (
        name, what, f'{judged.duration:.2f}', f'{1e6 * judged.error:.1f}',
        f'{1e6 * judged.rms:.1f}', *beside, '',
    )  # fmt: skip


def main() -> int:
    """Run all programs and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--programs', type=Path, required=True, help='folder of part programs')
    parser.add_argument('--json', type=Path, help='runs that were made, and where new ones go')
    parser.add_argument('--seconds', type=float, default=10.0, help='motion of each program')
    parser.add_argument('--tolerance', type=float, default=20.0, help='contour error [um]')
    arguments = parser.parse_args()
    rows: list[tuple[str, ...]] = []
    stand, tolerance = Stand(arguments.json), 1e-6 * arguments.tolerance
    for path in sorted(arguments.programs.iterdir()):
        try:
            case = prepared(stand, path, arguments.seconds, tolerance)
            with recording() as stand.recorder:
                rows += compare(stand, case, tolerance)
        except (ValueError, LinuxcncError) as error:
            print(f'{path.name}: left out: {error}', file=sys.stderr, flush=True)
    columns = (
        Column('program', numeric=False), Column('setting', numeric=False), Column('time s'),
        Column('largest error um'), Column('rms um'), Column('simulated s'),
        Column('simulated um'), Column('less time than the grid'),
    )  # fmt: skip
    print(Table(f'Tolerance {arguments.tolerance:g} um', columns, tuple(rows)).to_text())
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

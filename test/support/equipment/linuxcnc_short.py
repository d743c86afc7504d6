# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Random short programs on LinuxCNC and on its model, and how far both differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from programs.short_programs import BATCH, HEAD, KINDS, ShortProgram, short_program

from fuzzycnc_ros.adapters.linuxcnc.recorder import PERIOD, Recorder
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import program_moves
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.programs.program_judge import ProgramPath

VELOCITY, PATH_VELOCITY = (0.4,) * 3, 0.5
QUICK = (2.0,) * 3
"""Acceleration on the way to the origin [m/s^2]."""
REST = 0.12
"""Rest that tells two programs apart [s]."""
TIMEOUT = 600.0
TRIES = 3
SURE = 2e-7
"""What a distance from a path of chords is not sure by [m]."""
LOW, HIGH = 0.8, 1.25
"""Driven over simulated, time and error, that counts as agreement."""
_STILL = 1e-10
MACHINE = ContouringConfig()


@dataclass(frozen=True)
class Compared:
    """A short program on LinuxCNC and on its model.

    Parameters
    ----------
    number : int
        Of the program.
    kind : str
        One of `KINDS`.
    time, error : tuple of float, length 2
        Driven and simulated [s, m]; the largest contour error.
    """

    number: int
    kind: str
    time: tuple[float, float]
    error: tuple[float, float]

    @property
    def time_ratio(self) -> float:
        """Driven over simulated."""
        return self.time[0] / self.time[1]

    @property
    def error_ratio(self) -> float:
        """Driven over simulated."""
        return (self.error[0] + SURE) / (self.error[1] + SURE)

    @property
    def agrees(self) -> bool:
        """Whether time and error agree."""
        return all(LOW <= ratio <= HIGH for ratio in (self.time_ratio, self.error_ratio))


def drive(
    recorder: Recorder, seed: int, numbers: Iterable[int], kinds: Sequence[str] = KINDS
) -> Iterator[tuple[int, Array]]:
    """Run programs on LinuxCNC; yield their numbers and what was commanded [m].

    Those of a batch, which have one acceleration, run as one program with rests between them.
    """
    for _, batch in groupby(numbers, lambda number: number // BATCH):
        chosen = list(batch)
        programs = [short_program(seed, number, kinds) for number in chosen]
        home, aside = (f'G64\nG0 X0 Y0 Z{height}\nG4 P0.2\n' for height in (0, 10))
        text = ''.join(f'{aside}{home}{one.text}G4 P0.2\n' for one in programs)
        for _ in range(TRIES):
            recorder.limit(VELOCITY, QUICK)
            recorder.origin()
            recorder.limit(VELOCITY, programs[0].acceleration)
            pieces = _between_rests(recorder.run(f'{HEAD}{text}M2\n', TIMEOUT))
            if len(pieces) == 3 * len(chosen):  # else one rested within: a queue ran short
                break
        yield from zip(chosen, pieces[2::3], strict=True)


def _between_rests(samples: Array) -> list[Array]:
    """Return the motions between rests, each from its last sample at rest to the first one."""
    moved = np.flatnonzero(np.abs(np.diff(samples, axis=0)).max(axis=1) > _STILL)
    last = np.flatnonzero(np.diff(moved) > REST / PERIOD)
    ends = zip(np.append(0, last + 1), np.append(last, len(moved) - 1), strict=True)
    return [samples[moved[begin] : moved[end] + 2] for begin, end in ends]


def driven(program: ShortProgram, cut: Array) -> tuple[float, float]:
    """Return time and largest contour error of what LinuxCNC commanded [s, m]."""
    path = ProgramPath(_moves(program))
    judged = path.judge(path.recorded(cut, PERIOD), MACHINE)
    return judged.duration, judged.error


def simulated(program: ShortProgram) -> tuple[float, float]:
    """Return time and largest contour error of a program on the model [s, m]."""
    limits = ControllerLimits(
        velocity=VELOCITY, acceleration=program.acceleration, path_velocity=PATH_VELOCITY
    )
    moves = _moves(program)
    judged = ProgramPath(moves).run(moves, limits, MACHINE)
    return judged.duration, judged.error


def _moves(program: ShortProgram):
    return program_moves(read_program(f'{HEAD}G92 X0 Y0 Z0\n{program.text}').blocks)


def figures(known: Mapping[str, Sequence[float]]) -> dict[int, tuple[float, float]]:
    """Return driven times and errors by number as a file of them has them."""
    return {int(number): (time, error) for number, (time, error) in known.items()}


def compared(
    seed: int, found: Mapping[int, tuple[float, float]], kinds: Sequence[str] = KINDS
) -> list[Compared]:
    """Compare driven times and errors with the model's.

    Parameters
    ----------
    seed : int
        Of the programs.
    found : mapping of int to tuple of float
        By number of the program [s, m].
    kinds : sequence of str
        Kinds of programs, by turns.
    """
    rows = []
    for number, (time, error) in found.items():
        program = short_program(seed, number, kinds)
        own = simulated(program)
        rows.append(Compared(number, program.kind, (time, own[0]), (error, own[1])))
    return rows


def agreement_table(rows: Sequence[Compared]) -> Table:
    """Return how far LinuxCNC and model differ, by kind of program."""
    columns = (
        Column('programs', numeric=False), Column('number'), Column('agree'),
        Column('time, driven / simulated'), Column('error, driven / simulated'),
        Column('largest difference um'),
    )  # fmt: skip
    cells = []
    for kind in (*dict.fromkeys(row.kind for row in rows), 'all'):
        own = [row for row in rows if kind in (row.kind, 'all')]
        times, errors = (
            [getattr(row, f'{name}_ratio') for row in own] for name in ('time', 'error')
        )
        apart = max(abs(row.error[0] - row.error[1]) for row in own)
        cells.append(
            (
                kind, f'{len(own)}', f'{sum(row.agrees for row in own)}',
                f'{min(times):.3f} to {max(times):.3f}',
                f'{min(errors):.3f} to {max(errors):.3f}', f'{1e6 * apart:.1f}',
            )
        )  # fmt: skip
    return Table('Random short programs, LinuxCNC and its model', columns, tuple(cells))

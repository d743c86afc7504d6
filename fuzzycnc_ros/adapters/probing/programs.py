# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Programs of a probing cycle for the controls that run it, from the texts in `programs/`.

Every program works in machine coordinates and sets no work offset, tool length or tool table.  It
tells pairs of a code and a number: `BEGIN` and the signature of its plan, the number of a touch
and its coordinate in mm, minus that number where the probe missed, `END` at the end.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from string import Template

from fuzzycnc_ros.core.probing.plan import PROBED_AXES, Place, ProbePlan, Touch

BEGIN, END = 999_999, 1_000_000
"""Codes of begin and end; smaller ones are touches, and 0 is what an output has at first."""
CODE_OUTPUT, VALUE_OUTPUT = 0, 1
"""Analogue outputs of LinuxCNC that pass code and number to HAL."""

NAME_MAX = 60
"""Most that is kept of a name in a comment: LinuxCNC takes lines of 255 characters."""

FOLDER = Path(__file__).with_name('programs')


@dataclass(frozen=True)
class Dialect:
    """Dialect of a control's programs.

    Attributes
    ----------
    files : tuple of str
        Names of the files, that of the cycle first.
    call : callable
        Takes numbers as words: touches before, axis, start and end; returns the lines that call.
    comment : str
        Comment, with `{}` for its text.
    """

    files: tuple[str, ...]
    call: Callable[..., str]
    comment: str


DIALECTS: Mapping[str, Dialect] = {
    'linuxcnc': Dialect(
        ('fuzzycnc_probe.ngc', 'fuzzycnc_touch.ngc'),
        lambda *words: f'o<fuzzycnc_touch> call {" ".join(f"[{word}]" for word in words)}',
        '({})',
    ),
    'fanuc': Dialect(
        ('O9900.nc', 'O9901.nc'),
        lambda before, axis, x, y, z, end: f'G65 P9901 A{before}. B{axis}. X{x} Y{y} Z{z} D{end}',
        '({})',
    ),
    'siemens': Dialect(
        ('FUZZYCNC_PROBE.SPF', 'FUZZYCNC_TOUCH.SPF'),
        lambda *words: f'FUZZYCNC_TOUCH(_MISSED, {", ".join(words)})',
        '; {}',
    ),
}


class _Text(Template):
    delimiter = '@'


def write_programs(
    plan: ProbePlan, dialect: str, code_output: int = CODE_OUTPUT, value_output: int = VALUE_OUTPUT
) -> dict[str, str]:
    """Return the files of a program by name.

    Parameters
    ----------
    plan : ProbePlan
        The cycle.
    dialect : str
        One of `DIALECTS`.
    code_output, value_output : int
        Analogue outputs of LinuxCNC.
    """
    writer = DIALECTS[dialect]
    values = {
        'count': plan.count,
        'signature': plan.signature,
        'begin': BEGIN,
        'end': END,
        'tool': plan.tool,
        'repeats': plan.repeats,
        'travel': _mm(plan.travel_height),
        'back_off': _mm(plan.back_off),
        'approach_feed': _feed(plan.approach_feed),
        'feed': _feed(plan.feed),
        'code_output': code_output,
        'value_output': value_output,
        'calls': '\n'.join(
            f'{writer.comment.format(_plain(place))}\n{_called(writer, *item)}'
            for item in plan.touches
            for place in item[1:2]
        ),
    }
    for axis, (low, high) in plan.box.items():
        values |= {f'{axis.lower()}_low': _mm(low), f'{axis.lower()}_high': _mm(high)}
    return {
        name: _Text((FOLDER / name).read_text(encoding='ascii')).substitute(values)
        for name in writer.files
    }


def _called(writer: Dialect, before: int, place: Place, touch: Touch) -> str:
    axis = PROBED_AXES.index(place.axis)
    return writer.call(str(before), str(axis), *map(_mm, (*touch.start, touch.end)))


def _plain(place: Place) -> str:
    """Return what a place is called, without what ends or begins a comment."""
    name = place.name[:NAME_MAX]
    letters = (c if c.isascii() and (c.isalnum() or c in '-_') else ' ' for c in name)
    return f'{place.axis} OF {"".join(letters)}'.upper()


def _mm(value: float) -> str:
    return f'{1e3 * value:.4f}'


def _feed(value: float) -> str:
    return f'{6e4 * value:.1f}'

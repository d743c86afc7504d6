# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc report thermal`: a thermal test as a report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    say,
    show,
    write_json,
    write_report,
    write_whole,
)
from fuzzycnc_ros.cli.options import OptionalPath, OptionalText, given
from fuzzycnc_ros.cli.quantities import number_in, quantity, signed_quantity
from fuzzycnc_ros.core.units import LENGTHS, TIMES

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.thermal_test.phases import Phase
    from fuzzycnc_ros.studies.thermal_test.set_up import TestSetUp

HELP = """Reports on recordings, as pages and as PDF.

    fuzzycnc report thermal spindle_test --out report.html --pdf report.pdf

Each is one file that holds everything it needs, to be mailed or archived.
"""

Repeated = Optional[list[str]]  # noqa: UP045 - typer 0.9 does not read the newer form


def _several(text: str, metavar: str) -> Any:
    """Return an option that may be repeated."""
    return typer.Option(show_default=False, metavar=metavar, help=text)


def thermal(
    bag: Annotated[Path, typer.Argument(metavar='BAG', help='Recording of the test.')],
    out: Annotated[OptionalPath, given('Write a page.', metavar='FILE.html')] = None,
    pdf: Annotated[OptionalPath, given('Write a PDF.', metavar='FILE.pdf')] = None,
    file: Annotated[
        OptionalPath,
        given(
            'What no bag knows: instrument, probes, history; see docs/how-to/thermal-test.md.',
            metavar='FILE.yaml',
        ),
    ] = None,
    phase: Annotated[
        Repeated,
        _several(
            'A phase, in s from the first displacement unless a time has a unit; without an end '
            'it lasts as long as the recording. Repeat it. Marks of the bag do not count then.',
            'NAME=START:END',
        ),
    ] = None,
    kind: Annotated[
        Repeated,
        _several(
            'What a phase is, where its name does not say so: environment, spindle, axis, '
            'cooling or other.',
            'NAME=KIND',
        ),
    ] = None,
    probe: Annotated[
        Repeated,
        _several('Which channel is which probe, such as X1=ch1. Repeat it.', 'PROBE=CHANNEL'),
    ] = None,
    distance: Annotated[
        Repeated,
        _several(
            'How much farther in +Z probe 1 of X or Y is than probe 2, such as X=100mm: negative '
            'if it is nearer to -Z. Tilts need it.',
            'AXIS=LENGTH',
        ),
    ] = None,
    instrument: Annotated[
        OptionalText, given('Make, type and number of the instrument.', metavar='TEXT')
    ] = None,
    uncertainty: Annotated[
        OptionalText,
        given('Its expanded uncertainty, k = 2, such as 0.6um.', metavar='LENGTH'),
    ] = None,
    repeatability: Annotated[
        OptionalText,
        given('Standard deviation of the probes at rest, such as 0.05um.', metavar='LENGTH'),
    ] = None,
    resolution: Annotated[
        OptionalText,
        given('Smallest step that the probes show, such as 0.01um.', metavar='LENGTH'),
    ] = None,
    ambient: Annotated[
        OptionalText, given('Sensor that reads the temperature of the air.', metavar='SENSOR')
    ] = None,
    history: Annotated[
        OptionalText, given('History of the machine before the test.', metavar='TEXT')
    ] = None,
    operator: Annotated[OptionalText, given('Who did the test.', metavar='TEXT')] = None,
    machine: Annotated[
        OptionalText,
        given('Namespace of the machine, where the bag holds several.', metavar='NAME'),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Report a thermal test in the style of ISO 230-3 and ISO 10791-10.

    For each phase and probe: the range in the first hour and in the whole phase, and the time to
    90 % of the change; tilts, combined drift, and an uncertainty budget. Where the bag holds the
    applied offsets, all of it stands there with and without compensation. Phases are those that
    `fuzzycnc operate mark` wrote, else those of the spindle speed. What is not known is shown
    as not stated. The report is no statement of conformity.

        fuzzycnc report thermal spindle_test --out report.html --pdf report.pdf
        fuzzycnc report thermal spindle_test --file nest.yaml --pdf report.pdf
        fuzzycnc report thermal spindle_test --phase "spindle 6000=1h:5h" --phase cooling=5h:
        fuzzycnc report thermal spindle_test --distance X=100mm --uncertainty 0.6um
    """
    from fuzzycnc_ros.studies.thermal_test.phases import find_phases
    from fuzzycnc_ros.studies.thermal_test.recording import read_test
    from fuzzycnc_ros.studies.thermal_test.report import (
        axes_table,
        budget_remarks,
        budget_table,
        figures_document,
        how_remark,
        judge_test,
        phase_table,
        phases_table,
    )

    check_folder(out, pdf, json_file)
    stated = {
        'instrument': instrument,
        'uncertainty': _length('--uncertainty', uncertainty, '0.6um'),
        'repeatability': _length('--repeatability', repeatability, '0.05um'),
        'resolution': _length('--resolution', resolution, '0.01um'),
        'ambient': ambient,
        'history': history,
        'operator': operator,
    }
    set_up = _set_up(file, stated, _pairs('--probe', probe, 'X1=ch1'), _distances(distance))
    phases = [_phase(text) for text in phase or []]
    kinds = _kinds(kind)
    recording = read_test(bag, machine)
    test = judge_test(recording, set_up, find_phases(recording, phases, kinds))
    show(phases_table(test))
    for number in range(1, len(test.phases) + 1):
        say('')
        show(phase_table(test, number))
    say('')
    say(how_remark(test))
    say('')
    along = axes_table(test)
    if along is not None:
        show(along)
    show(budget_table(test))
    for text in budget_remarks(test):
        say(text)
    if out is not None or pdf is not None:
        from fuzzycnc_ros.studies.thermal_test.page import thermal_test_page

        page = thermal_test_page(test)
        if out is not None:
            write_report(out, page)
        if pdf is not None:
            from fuzzycnc_ros.studies.page.pdf import render_pdf

            write_whole(pdf, render_pdf(page))
            say(f'{pdf}: the report as PDF')
    write_json(json_file, figures_document(test))


def _set_up(
    file: Path | None,
    stated: Mapping[str, Any],
    probes: Mapping[str, str],
    distances: Mapping[str, float],
) -> 'TestSetUp':
    """Return what is stated: options go before the file."""
    from fuzzycnc_ros.studies.thermal_test.set_up import PROBES, TestSetUp

    found = TestSetUp()
    if file is not None:
        from fuzzycnc_ros.cli.reports.thermal_test_file import read_thermal_test_file

        found = read_thermal_test_file(file)
    known = (*PROBES, 'X', 'Y')
    for name in probes:
        if name not in known:
            raise ValueError(f'--probe: expected one of {", ".join(known)} but found {name!r}')
    return replace(
        found,
        **{name: value for name, value in stated.items() if value is not None},
        probes={**found.probes, **probes},
        distance={**found.distance, **distances},
    )


def _length(option: str, text: str | None, example: str) -> float | None:
    return None if text is None else quantity(option, text, LENGTHS, example=example)


def _pairs(option: str, texts: Sequence[str] | None, example: str) -> dict[str, str]:
    """Return what options of the form NAME=VALUE say."""
    found: dict[str, str] = {}
    for text in texts or []:
        name, _, value = (part.strip() for part in text.rpartition('='))
        if not (name and value):
            raise ValueError(f'{option}: expected {example} or the like but found {text!r}')
        if name in found:
            raise ValueError(f'{option}: expected each name once but found {name} twice')
        found[name] = value
    return found


def _distances(texts: Sequence[str] | None) -> dict[str, float]:
    found = {}
    for axis, text in _pairs('--distance', texts, 'X=100mm').items():
        if axis not in ('X', 'Y'):
            raise ValueError(f'--distance: expected axis X or Y but found {axis!r}')
        found[axis] = signed_quantity('--distance', text, LENGTHS, example='X=100mm', zero=False)
    return found


def _kinds(texts: Sequence[str] | None) -> dict[str, str]:
    from fuzzycnc_ros.studies.thermal_test.phases import KINDS

    found = _pairs('--kind', texts, 'cooling=environment')
    for name, kind in found.items():
        if kind not in KINDS:
            raise ValueError(
                f'--kind {name}: expected one of {", ".join(KINDS)} but found {kind!r}'
            )
    return found


def _phase(text: str) -> 'Phase':
    """Return a phase that an option names."""
    from fuzzycnc_ros.studies.thermal_test.phases import Phase, kind_of

    name, _, span = (part.strip() for part in text.rpartition('='))
    start, colon, end = span.partition(':')
    if not (name and start and colon):
        raise ValueError(
            f'--phase: expected NAME=START:END such as "spindle 6000=1h:5h" but found {text!r}'
        )
    read = number_in(TIMES, 'a time')
    return Phase(name, kind_of(name), read(start), read(end) if end else inf)


COMMANDS: dict[str, Callable[..., Any]] = {'thermal': thermal}

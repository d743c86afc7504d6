# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc evaluate`: a model judged on recorded runs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    progress_bar,
    say,
    show,
    write_json,
    write_text,
)
from fuzzycnc_ros.cli.options import Bags, End, Report, Start

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal import Evaluation, ThermalModel, ThermalRun
    from fuzzycnc_ros.report import CompensationRun


def evaluate(
    bags: Bags,
    model: Annotated[
        Path, typer.Option(metavar='MODEL', help='Model file made by `fuzzycnc train`.')
    ],
    start: Start = None,
    end: End = None,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Compare a model's predictions with what was measured, beside plain baselines.

    All candidates of the model run from the bag's first sample, as they would on the machine;
    what is left of the measured displacement is judged between --start and --end. Rows the model
    was trained on prove nothing: leave them outside.

        fuzzycnc evaluate thursday friday --model mill.json
        fuzzycnc evaluate spindle --model spindle.json --start 86865
        fuzzycnc evaluate spindle --model spindle.json --report spindle.html
    """
    from fuzzycnc_ros.bags.runs import read_run
    from fuzzycnc_ros.cli.train import default_text, problem_lines, refused_names
    from fuzzycnc_ros.core.text_hash import text_hash as digest
    from fuzzycnc_ros.core.thermal import evaluate as judge
    from fuzzycnc_ros.core.thermal import load_model
    from fuzzycnc_ros.report.comparison import LEFT, residual_document, residual_table

    for path in (report, json_file):
        check_folder(path)
    trained = load_model(model)
    results, pages = [], []
    with progress_bar('evaluating') as tell:
        for done, bag in enumerate(bags):
            tell(f'evaluating {bag.name}', done, len(bags))
            run = read_run(bag, stop=end)
            results.append(judge(trained, run, start=start, stop=end))
            if report is not None:
                pages.append(_page(trained, run, results[-1]))
    for result in results:
        show(
            residual_table(
                f'{result.run}: {LEFT}',
                result.channel,
                result.rms,
                result.largest,
                refused_names(trained),
            )
        )
        say(
            f'{result.samples} samples, {100.0 * result.in_domain:.0f} % of them in the domain '
            'of the training'
        )
    say(f'default: {default_text(trained)}')
    for line in problem_lines(trained):
        say(line)
    text = model.read_text(encoding='utf-8')
    if report is not None:
        _write_report(report, pages, trained, text)
    write_json(
        json_file,
        {
            'model': {
                'file': str(model),
                'hash': digest(text),
                'default': dict(zip(trained.channel, trained.default, strict=True)),
            },
            'runs': {
                result.run: residual_document(result.channel, result.rms, result.largest)
                for result in results
            },
            'samples': {result.run: result.samples for result in results},
            'in_domain': {result.run: result.in_domain for result in results},
        },
    )


def _page(model: 'ThermalModel', run: 'ThermalRun', result: 'Evaluation') -> 'CompensationRun':
    """Return the judged part of a run with the predictions of all candidates, for plots."""
    from fuzzycnc_ros.core.thermal.training import at_interval
    from fuzzycnc_ros.report import CompensationRun

    even = at_interval(run, model.interval)
    inside = even.inside(float(result.time[0]), float(result.time[-1]))
    rise = model.rises(even)[inside]
    label = {
        member: number
        for number, item in enumerate(model.selection.clusters)
        for member in item.member
    }
    return CompensationRun(
        name=run.name,
        time=result.time,
        sensor=even.sensor,
        temperature=even.temperature[inside],
        cluster=tuple(label.get(name, -1) for name in even.sensor),
        chosen=model.inputs,
        channel=even.channel,
        measured=result.measured,
        predicted={
            name: values for name, values in result.predicted.items() if name != 'uncompensated'
        },
        default='default',
        standard_deviation=model.standard_deviation(rise),
        in_domain=model.in_domain(rise),
    )


def _write_report(
    path: Path, pages: list['CompensationRun'], model: 'ThermalModel', text: str
) -> None:
    from fuzzycnc_ros.report import render_html
    from fuzzycnc_ros.scenario import shift_report

    data = shift_report(pages, model, text, title='A thermal model, judged on recorded runs')
    write_text(path, render_html(data))
    say(f'{path}: the report; open it in a browser')

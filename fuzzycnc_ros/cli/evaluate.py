# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc evaluate`: a model judged on recorded runs."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
from fuzzycnc_ros.cli.many_bags import (
    Jobs,
    ManyBags,
    NamedBag,
    Sorted,
    find_bags,
    jobs_of,
    say_bad,
    with_each,
)
from fuzzycnc_ros.cli.options import End, Report, Start

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.workers import Progress
    from fuzzycnc_ros.core.thermal import Evaluation, ThermalModel, ThermalRun
    from fuzzycnc_ros.report import CompensationRun

    Judged = tuple[Evaluation, CompensationRun | None]


def evaluate(
    bags: ManyBags,
    model: Annotated[
        Path, typer.Option(metavar='MODEL', help='Model file made by `fuzzycnc train`.')
    ],
    start: Start = None,
    end: End = None,
    jobs: Jobs = None,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Compare a model's predictions with what was measured, beside plain baselines.

    All candidates of the model run from the bag's first sample, as they would on the machine;
    what is left of the measured displacement is judged between --start and --end. Rows the model
    was trained on prove nothing: leave them outside.

    Of several bags there is one table, with their median and the worst of them, and one of all
    candidates. A bag that cannot be judged is named and left out; the command then ends with 1.
    The figures do not depend on --jobs.

        fuzzycnc evaluate thursday friday --model mill.json
        fuzzycnc evaluate recordings 'archive/2026-*' --model mill.json --json figures.json
        fuzzycnc evaluate spindle --model spindle.json --start 86865
        fuzzycnc evaluate spindle --model spindle.json --report spindle.html
    """
    from fuzzycnc_ros.cli.train import default_text, problem_lines
    from fuzzycnc_ros.core.thermal import load_model

    processes = jobs_of(jobs)
    for path in (report, json_file):
        check_folder(path)
    trained = load_model(model)
    text = model.read_text(encoding='utf-8')
    work = partial(judge_bag, model_text=text, start=start, end=end, page=report is not None)
    with progress_bar('evaluating') as tell:
        found: Sorted[Judged] = with_each(work, find_bags(bags), processes, tell)
    judged = [evaluation for evaluation, _ in found.results]
    _show(judged, trained)
    say_bad(found.bad)
    say(f'default: {default_text(trained)}')
    for line in problem_lines(trained):
        say(line)
    if report is not None:
        pages = [page for _, page in found.results if page is not None]
        _write_report(report, pages, trained, text)
    write_json(json_file, _document(found, model, trained, text))
    if found.bad:
        raise typer.Exit(1)


def judge_bag(
    bag: NamedBag,
    progress: 'Progress',
    *,
    model_text: str,
    start: float | None,
    end: float | None,
    page: bool,
) -> 'Judged':
    """Judge a model on one bag; what a page needs besides is made only if there is one.

    Raises
    ------
    ValueError
        If the bag or its run cannot be used.
    """
    from fuzzycnc_ros.bags.runs import read_run
    from fuzzycnc_ros.core.thermal import evaluate as judge
    from fuzzycnc_ros.core.thermal import load_model

    progress('evaluating', bag.name, 0, 1)
    trained = load_model(model_text)
    run = read_run(bag.path, stop=end, name=bag.name)
    result = judge(trained, run, start=start, stop=end)
    return result, _page(trained, run, result) if page else None


def _show(judged: 'list[Evaluation]', model: 'ThermalModel') -> None:
    """Print one run with all candidates, or a table of all runs and one of all candidates."""
    from fuzzycnc_ros.cli.train import refused_names
    from fuzzycnc_ros.report.comparison import LEFT, residual_table
    from fuzzycnc_ros.report.many_runs import overall_table, runs_table

    refused = refused_names(model)
    if len(judged) > 1:
        show(runs_table(judged))
        say('')
        show(overall_table(judged, refused))
        return
    (result,) = judged
    title = f'{result.run}: {LEFT}'
    show(residual_table(title, result.channel, result.rms, result.largest, refused))
    say(
        f'{result.samples} samples, {100.0 * result.in_domain:.0f} % of them in the domain '
        'of the training'
    )


def _document(
    found: 'Sorted[Judged]', file: Path, model: 'ThermalModel', text: str
) -> dict[str, Any]:
    """Return all figures."""
    from fuzzycnc_ros.core.text_hash import text_hash
    from fuzzycnc_ros.report.comparison import residual_document
    from fuzzycnc_ros.report.many_runs import overall_document

    judged = [evaluation for evaluation, _ in found.results]
    return {
        'model': {
            'file': str(file),
            'hash': text_hash(text),
            'default': dict(zip(model.channel, model.default, strict=True)),
        },
        'runs': {
            result.run: residual_document(result.channel, result.rms, result.largest)
            for result in judged
        },
        'overall': overall_document(judged),
        'samples': {result.run: result.samples for result in judged},
        'in_domain': {result.run: result.in_domain for result in judged},
        'left_out': {item.bag.name: item.reason for item in found.bad},
    }


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

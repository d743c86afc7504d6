# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc evaluate`: a model judged on recorded runs."""

import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from fuzzycnc_ros.bags.finding import NamedBag, find_bags
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    progress_bar,
    remark,
    say,
    show,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.models.many_bags import (
    BatchResults,
    Jobs,
    ManyBags,
    jobs_of,
    say_bad,
    with_each,
)
from fuzzycnc_ros.cli.models.recorded_runs import gap_lines, offset_lines
from fuzzycnc_ros.cli.options import (
    End,
    OptionalPath,
    OptionalText,
    Report,
    SensorLimits,
    Start,
    given,
)
from fuzzycnc_ros.cli.quantities import DURATIONS, quantity
from fuzzycnc_ros.studies.thermal.missing_readings import Bridged

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fuzzycnc_ros.cli.workers import Progress
    from fuzzycnc_ros.core.thermal.fit import Evaluation
    from fuzzycnc_ros.core.thermal.model import ThermalModel
    from fuzzycnc_ros.core.thermal.run import ThermalRun
    from fuzzycnc_ros.studies.page.html import Remark
    from fuzzycnc_ros.studies.thermal.probed import ProbedEvaluation
    from fuzzycnc_ros.studies.thermal.report_data import CompensationRun


class BagEvaluation(NamedTuple):
    """Result of a bag, gaps in what the model reads; page and probed run if asked for."""

    evaluation: 'Evaluation'
    bridged: tuple[Bridged, ...]
    page: 'CompensationRun | None' = None
    probed: 'ProbedEvaluation | None' = None
    doubts: tuple[str, ...] = ()


def evaluate(
    bags: ManyBags,
    model: Annotated[
        OptionalPath, given('Model file made by `fuzzycnc train`.', metavar='MODEL')
    ] = None,
    sensor_limits: SensorLimits = None,
    start: Start = None,
    end: End = None,
    probe_every: Annotated[
        OptionalText,
        given(
            'Also judge what probing the machine this often would leave, such as 60min.',
            metavar='TIME',
        ),
    ] = None,
    from_nothing: Annotated[
        bool,
        typer.Option(
            '--from-nothing', help='Without a model: learn from the probes of --probe-every alone.'
        ),
    ] = False,
    carry: Annotated[
        bool,
        typer.Option('--carry', help='With --from-nothing: carry what is learnt from bag to bag.'),
    ] = False,
    probe_noise: Annotated[
        str,
        typer.Option(metavar='LENGTH', help='With --from-nothing: standard deviation of a probe.'),
    ] = '0.5um',
    jobs: Jobs = None,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Compare a model's predictions with measurements and simple baselines.

    All candidates of the model run from the bag's first sample, as they would on the machine;
    the residual of the measured displacement is judged between --start and --end. They do not
    move the reference: temperatures and displacements stay referred to the bag's first samples.
    Rows that the model was trained on prove nothing; what of them was judged is named.

    The band of a model should hold 95 % of the residuals. Where it holds so little that chance
    does not explain it, the first lines and the page say so, and the exit code is 1: it holds less
    than 90 %, and with a probability of 5 % or less so many of as many independent samples as the
    run is worth (`independent` in the figures of --json) would be outside, or so large.
    `false_band` there lists the channels.

    A channel in which the default leaves more than there was without compensation is marked and
    named. That alone leaves the exit code at 0: scripts test `worse_than_none` in the figures of
    --json, a list of channels, over all bags; `judged` has it for each.

    With --probe-every a second table shows the residual if the machine is probed that often, as
    `thermal_predictor` would use the probes, beside the last probe held without any model.

    With --from-nothing there is no model: the weights of lagged temperatures and speeds are learnt
    from the probes alone, each with the band of what is known so far. With --carry the bags are
    the runs of one machine in their order, and each begins with what those before have taught.

    Of several bags there is one table, with their median and the worst of them, and one of all
    candidates. A bag that cannot be judged is named and left out; the command then ends with 1.
    The figures do not depend on --jobs.

        fuzzycnc evaluate thursday friday --model mill.json
        fuzzycnc evaluate recordings 'archive/2026-*' --model mill.json --json figures.json
        fuzzycnc evaluate spindle --model spindle.json --start 86865
        fuzzycnc evaluate spindle --model spindle.json --probe-every 60min --report spindle.html
        fuzzycnc evaluate monday tuesday wednesday --from-nothing --carry --probe-every 60min
    """
    from fuzzycnc_ros.cli.models.train import default_text, problem_lines
    from fuzzycnc_ros.core.thermal.fit.evaluation import false_bands
    from fuzzycnc_ros.core.thermal.model import load_model
    from fuzzycnc_ros.studies.thermal.judged import (
        narrow_band_remarks,
        overall_band_remarks,
        run_band_remark,
    )

    processes = jobs_of(jobs)
    every = None
    if probe_every is not None:
        every = quantity('--probe-every', probe_every, DURATIONS, example='60min')
    check_folder(report, json_file)
    if from_nothing:
        from fuzzycnc_ros.cli.models.evaluate_learning import evaluate_from_nothing

        if model is not None or every is None:
            raise ValueError(
                '--from-nothing: expected --probe-every and no --model, since all is learnt from '
                f'probes, but found {"a model" if model is not None else "no --probe-every"}'
            )
        evaluate_from_nothing(
            bags,
            every,
            carry=carry,
            probe_noise=probe_noise,
            start=start,
            end=end,
            sensor_limits=sensor_limits or (),
            report=report,
            json_file=json_file,
        )
        return
    _check_places(bags, model)
    if carry or model is None:
        raise ValueError(
            f'{"--carry" if carry else "--model"}: expected --model with a model to judge, or '
            '--from-nothing to learn from probes alone, with --carry from bag to bag'
        )
    trained = load_model(model)
    document = model.read_text(encoding='utf-8')
    work = partial(
        judge_bag,
        model_text=document,
        sensor_limits=sensor_limits or (),
        start=start,
        end=end,
        probe_every=every,
        page=report is not None,
    )
    there = find_bags(bags)
    with progress_bar('evaluating') as tell:
        found: BatchResults[BagEvaluation] = with_each(work, there, processes, tell)
    judged = [item.evaluation for item in found.results]
    bands = [run_band_remark(item, len(judged)) for item in judged]
    probed = [item.probed for item in found.results if item.probed is not None]
    lines = [band for band in bands if band.warning] + overall_band_remarks(judged)
    for each in probed:
        lines += narrow_band_remarks(each.run, each.channel, each.covered)
    for line in lines:
        remark(line)
    _show(judged, trained)
    others = []
    for result, band in zip(judged, bands, strict=True):
        others += _remarks(result, None if band.warning else band, trained)
    for line in others:
        remark(line)
    lines += others
    for item in found.results:
        for text in gap_lines(item.evaluation.run, item.bridged, trained.interval):
            say(text)
    for text in (line for item in found.results for line in item.doubts):
        say(f'warning: {text}')
    _show_probed(probed)
    say_bad(found.bad)
    say(f'default: {default_text(trained)}')
    for text in problem_lines(trained):
        say(text)
    if report is not None:
        from fuzzycnc_ros.studies.page.recorded import recording_facts

        pages = [item.page for item in found.results if item.page is not None]
        facts = recording_facts([bag.path for bag in found.used(there)])
        _write_report(report, pages, lines, trained, document, probed, facts)
    write_json(json_file, _document(found, model, trained, document))
    if found.bad or false_bands(judged):
        raise typer.Exit(1)


def _check_places(bags: 'Sequence[Path]', model: Path | None) -> None:
    """Refuse a model among the bags."""
    models = [path for path in bags if path.suffix == '.json']
    if models:
        exchanged = [] if model is None or model.suffix == '.json' else [model]
        words = [*(path for path in bags if path not in models), *exchanged, '--model', models[0]]
        raise ValueError(
            f'{models[0]}: expected a bag but found a model file; type `fuzzycnc evaluate '
            f'{shlex.join(map(str, words))}`'
        )


def judge_bag(
    bag: NamedBag,
    progress: 'Progress',
    *,
    model_text: str,
    sensor_limits: 'Sequence[str]' = (),
    start: float | None,
    end: float | None,
    probe_every: float | None,
    page: bool,
) -> BagEvaluation:
    """Judge a model on one bag; what a page needs besides is made only if there is one.

    Raises
    ------
    ValueError
        If the bag or its run cannot be used.
    """
    from fuzzycnc_ros.bags.runs import read_run
    from fuzzycnc_ros.core.thermal.model import load_model
    from fuzzycnc_ros.studies.thermal.missing_readings import judge_recorded

    progress('evaluating', bag.name, 0, 1)
    trained = load_model(model_text)
    recorded = read_run(bag.path, stop=end, name=bag.name, sensor_limits=sensor_limits)
    result, run, bridged = judge_recorded(trained, recorded, start=start, stop=end)
    probed = None
    if probe_every is not None:
        from fuzzycnc_ros.studies.thermal.probed import evaluate_probed

        probed = evaluate_probed(trained, run, result, probe_every)
    shown = _page(trained, run, result) if page else None
    return BagEvaluation(result, bridged, shown, probed, tuple(offset_lines([recorded])))


def _show(judged: 'list[Evaluation]', model: 'ThermalModel') -> None:
    """Print one run with all candidates, or a table of all runs and one of all candidates."""
    from fuzzycnc_ros.cli.models.train import refused_names
    from fuzzycnc_ros.studies.thermal.comparison import LEFT, residual_table
    from fuzzycnc_ros.studies.thermal.many_runs import overall_table, runs_table

    refused = refused_names(model)
    if len(judged) > 1:
        show(runs_table(judged))
        say('')
        show(overall_table(judged, refused))
        return
    (result,) = judged
    title = f'{result.run}: {LEFT}'
    show(residual_table(title, result.channel, result.rms, result.largest, refused))


def _remarks(result: 'Evaluation', band: 'Remark | None', model: 'ThermalModel') -> 'list[Remark]':
    """Return what a reader of the figures has to know."""
    from fuzzycnc_ros.studies.thermal.judged import remarks_on, training_remark

    window, *others = remarks_on(result, band)
    trained_on = training_remark(result.run, result.trained_on, result.recognised, model.runs)
    return [window, trained_on, *others]


def _show_probed(probed: 'Sequence[ProbedEvaluation]') -> None:
    """Print what probing leaves, if it was asked for."""
    from fuzzycnc_ros.studies.thermal.probed import probed_lines, probed_table

    if not probed:
        return
    say('')
    show(probed_table(probed))
    for line in probed_lines(probed):
        say(line)


def _document(
    found: BatchResults[BagEvaluation], file: Path, model: 'ThermalModel', text: str
) -> dict[str, Any]:
    """Return all figures."""
    from fuzzycnc_ros.core.names import text_hash
    from fuzzycnc_ros.core.thermal.fit.evaluation import false_bands, pooled_rms
    from fuzzycnc_ros.studies.thermal.comparison import judged_document, residual_document
    from fuzzycnc_ros.studies.thermal.judged import worse_than_none
    from fuzzycnc_ros.studies.thermal.many_runs import overall_document
    from fuzzycnc_ros.studies.thermal.probed import probed_document

    judged = [item.evaluation for item in found.results]
    probed = [item.probed for item in found.results if item.probed is not None]
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
        'judged': {result.run: judged_document(result) for result in judged},
        'worse_than_none': worse_than_none(model.channel, pooled_rms(judged)),
        'false_band': false_bands(judged),
        'samples': {
            result.run: dict(zip(result.channel, result.samples, strict=True)) for result in judged
        },
        'in_domain': {result.run: result.in_domain for result in judged},
        'bridged': {item.evaluation.run: item.bridged for item in found.results},
        'probed': probed_document(probed) if probed else None,
        'warnings': [line for item in found.results for line in item.doubts],
        'left_out': {item.bag.name: item.reason for item in found.bad},
    }


def _page(model: 'ThermalModel', run: 'ThermalRun', result: 'Evaluation') -> 'CompensationRun':
    """Return the judged part of a run with the predictions of all candidates, for plots."""
    from fuzzycnc_ros.core.thermal.fit.training import at_interval
    from fuzzycnc_ros.studies.thermal.report_data import CompensationRun

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
        in_domain=model.in_domain(rise) & (not result.warm),  # as the figure in the remarks
    )


def _write_report(
    path: Path,
    pages: list['CompensationRun'],
    lines: list['Remark'],
    model: 'ThermalModel',
    text: str,
    probed: 'Sequence[ProbedEvaluation]',
    facts: dict[str, str],
) -> None:
    from fuzzycnc_ros.studies.shift.shift_report import shift_report
    from fuzzycnc_ros.studies.thermal.probed import probed_section
    from fuzzycnc_ros.studies.thermal.report_page import report_page

    data = shift_report(
        pages,
        model,
        text,
        title='A thermal model, judged on recorded runs',
        sections=[probed_section(item) for item in probed],
        judged=lines,
        facts=facts,
    )
    write_report(path, report_page(data))

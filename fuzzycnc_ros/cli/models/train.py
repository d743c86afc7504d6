# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc train`: recorded runs in, a model file out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.bags.finding import NamedBag
from fuzzycnc_ros.bags.recording_loss import hole_text
from fuzzycnc_ros.cli.completion import one_of, some_of
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    check_new,
    progress_bar,
    remark,
    say,
    show,
    write_json,
    write_text,
)
from fuzzycnc_ros.cli.models.fit_progress import FitCounter
from fuzzycnc_ros.cli.models.many_bags import SkipBad, runs_of, say_bad
from fuzzycnc_ros.cli.models.recorded_runs import (
    bridged_gaps,
    doubt_lines,
    gap_lines,
    sensors_but,
)
from fuzzycnc_ros.cli.options import (
    ALL,
    Bags,
    Clusters,
    DropSensor,
    End,
    Interval,
    Seed,
    SensorLimits,
    Sensors,
    Speed,
    Start,
    names_of,
    words,
)
from fuzzycnc_ros.core.thermal.candidate import CANDIDATES, COMPARED_ONLY, STANDARD

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.model import ThermalModel
    from fuzzycnc_ros.core.thermal.run import ThermalRun
    from fuzzycnc_ros.studies.page.table import Table


def train(
    bags: Bags,
    out: Annotated[Path, typer.Option(metavar='MODEL', help='Model file to write.')],
    model: Annotated[
        str,
        typer.Option(
            metavar='NAME',
            help=f'Model to use on every channel: {", ".join(CANDIDATES)}; auto takes the '
            'best on held-out samples.',
            autocompletion=one_of(('auto', *CANDIDATES)),
        ),
    ] = 'auto',
    models: Annotated[
        Optional[list[str]],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            metavar='NAME,...',
            show_default=False,
            help=f'Models to fit, judge and choose from, or {ALL}; {", ".join(STANDARD)} by '
            'default.',
            autocompletion=some_of((ALL, *CANDIDATES)),
        ),
    ] = None,
    interval: Interval = None,
    sensors: Sensors = 'auto',
    clusters: Clusters = 5,
    drop_sensor: DropSensor = None,
    sensor_limits: SensorLimits = None,
    speed: Speed = True,
    start: Start = None,
    end: End = None,
    seed: Seed = 0,
    skip_bad: SkipBad = False,
    force: Annotated[bool, typer.Option('--force', help='Overwrite the model file.')] = False,
    json_file: JsonFile = None,
) -> None:
    """Train thermal models on recorded runs, and write them with their scores to one file.

    Sensors are chosen, the models of --models are fitted, and each is judged on what it was not
    fitted to: whole runs where there are several; of a single one its thermal cycles, or else
    contiguous stretches. The file keeps all of them; each channel uses the best, unless --model
    names one. Where all runs carry the spindle speed, some models read it.

    No compensation competes too: a channel that no model improves beyond chance stays
    uncompensated. A model that --model names may leave more than that; train says so, and
    thermal_predictor refuses it unless its parameter `force` is true. The exit code is 0 all the
    same: scripts test `worse_than_none` in the figures of --json, a list of channels.

    --start and --end say which samples count. They never move the reference: temperatures and
    displacements stay referred to the first samples of the bag.

    A bag holds `temperatures` and `displacement`; `fuzzycnc import-csv` makes one of a table.
    Readings that are missing for up to 20 min are bridged, as by the predictor. A bag that cannot
    be used stops the training; with --skip-bad it is named and left out, and the code is 0.

        fuzzycnc train monday tuesday wednesday --out mill.json
        fuzzycnc train shift --end 86850 --out spindle.json --sensors all
        fuzzycnc train shift --model lag_ridge --out mill.json --force
        fuzzycnc train shift --models all --no-speed --out mill.json
    """
    from fuzzycnc_ros.core.thermal.fit import train_model
    from fuzzycnc_ros.studies.thermal.judged import choice_remarks

    if not force:
        check_new(out, remedy='add --force')
    check_folder(out, json_file)
    for option, texts in (('--model', [model]), ('--models', models or [])):
        for name in words(texts):
            if name in COMPARED_ONLY:
                raise ValueError(
                    f'{option}: expected a model that runs on machines but found {name!r}, which '
                    f'is only compared: fuzzycnc compare --models {name}'
                )
    names = names_of('--models', models or list(STANDARD), CANDIDATES)
    wanted = sensors_but(drop_sensor, bags)
    phrase = FitCounter()
    with progress_bar('training') as tell:
        named = [NamedBag(bag, bag.stem) for bag in bags]
        read = runs_of(
            named,
            interval,
            tell,
            skip=skip_bad,
            start=start,
            stop=end,
            sensors=wanted,
            sensor_limits=sensor_limits or (),
        )
        runs = read.results
        trained = train_model(
            runs,
            model=model,
            interval=interval,
            sensors=sensors,
            n_clusters=clusters,
            candidates=names,
            spindle_speed=speed,
            random_state=seed,
            progress=lambda stage, name, done, total: tell(
                phrase(stage, name, done, total), done, total
            ),
        )
    text = trained.to_json()
    write_text(out, text)
    say_bad(read.bad)
    holed = {run.name: hole_words(run) for run in runs}
    for name, found in holed.items():
        if found:
            say(f'{name}: {found}, filled by straight lines; record it anew for a better model')
    bridged = {run.name: bridged_gaps(run, trained.interval) for run in runs}
    for name, gaps in bridged.items():
        for line in gap_lines(name, gaps, trained.interval):
            say(line)
    doubts = doubt_lines(runs)
    for line in doubts:
        say(f'warning: {line}')
    say(f'trained on {", ".join(trained.runs)}, a sample every {trained.interval:g} s')
    say(f'sensors: {", ".join(trained.inputs)}')
    if trained.selection.dropped:
        say(f'left out, as they never warmed up: {", ".join(trained.selection.dropped)}')
    show(candidate_table(trained))
    for line in problem_lines(trained):
        say(line)
    say(f'in use: {default_text(trained)}')
    for sentence in choice_remarks(trained):
        remark(sentence)
    say(f'spindle speed: {speed_text(trained)}')
    if trained.drives_max:
        drives = ', '.join(trained.drives_max)
        say(f'reported by the control: {drives} used; they have to come with machine_state')
    say(f'{out}: written, hash {trained.hash[:16]}')
    write_json(
        json_file,
        {
            **_document(trained, out, trained.hash),
            'holes': holed,
            'warnings': doubts,
            'bridged': bridged,
            'left_out': {item.bag.name: item.reason for item in read.bad},
        },
    )


def hole_words(run: 'ThermalRun') -> str:
    """Return how many holes the temperatures of a run have, and the longest; empty if none."""
    from fuzzycnc_ros.bags.holes import HoleCounter

    counter = HoleCounter()
    for time in run.time:
        counter.update(round(1e9 * time))
    if not counter.holes:
        return ''
    longest = max(counter.holes, key=lambda hole: hole.stop - hole.start)
    length = 1e-9 * (longest.stop - longest.start)
    return hole_text(len(counter.holes), length, 1e-9 * longest.start)


def candidate_table(model: 'ThermalModel') -> 'Table':
    """Return the candidates' residuals on what they were not fitted to."""
    from fuzzycnc_ros.studies.thermal.comparison import residual_table

    return residual_table(
        'Residual on held-out samples',
        model.channel,
        {name: item.held_out_rms for name, item in model.candidates.items()},
        {name: item.held_out_max for name, item in model.candidates.items()},
        refused_names(model),
        in_use=model.default,
    )


def refused_names(model: 'ThermalModel') -> frozenset[str]:
    """Return the candidates that are not to be trusted."""
    return frozenset(name for name, item in model.candidates.items() if item.problems)


def problem_lines(model: 'ThermalModel') -> list[str]:
    """Return what is wrong with candidates, a line each."""
    from fuzzycnc_ros.studies.thermal.comparison import refusal_line

    flagged = [
        refusal_line(name, '; '.join(item.problems), in_table=True)
        for name, item in model.candidates.items()
        if item.problems
    ]
    left_out = [
        refusal_line(name, reason, in_table=False) for name, reason in model.omitted.items()
    ]
    return flagged + left_out


def default_text(model: 'ThermalModel') -> str:
    """Return which candidate each channel uses."""
    from fuzzycnc_ros.studies.thermal.comparison import by_channel

    return by_channel(dict(zip(model.channel, model.default, strict=True)))


def speed_text(model: 'ThermalModel') -> str:
    """Return whether the spindle speed is used."""
    if model.needs_speed:
        return 'used; it has to come with machine_state or on spindle_speed'
    from fuzzycnc_ros.core.thermal.run import SPINDLE_SPEED

    known = SPINDLE_SPEED in model.drivers
    return 'known, but not used by the model in use' if known else 'not used'


def _document(model: 'ThermalModel', path: Path, digest: str) -> dict[str, Any]:
    from fuzzycnc_ros.studies.thermal.comparison import residual_document

    held_out = residual_document(
        model.channel,
        {name: item.held_out_rms for name, item in model.candidates.items()},
        {name: item.held_out_max for name, item in model.candidates.items()},
    )
    return {
        'model': str(path),
        'hash': digest,
        'runs': model.runs,
        'interval_s': model.interval,
        'sensors': model.inputs,
        'dropped': model.selection.dropped,
        'clusters': [
            {'chosen': item.chosen, 'member': item.member, 'substitute': item.substitute}
            for item in model.selection.clusters
        ],
        'default': dict(zip(model.channel, model.default, strict=True)),
        'uncompensated': model.uncompensated,
        'worse_than_none': list(model.losing),
        'candidates': {
            name: {
                'settings': item.settings,
                'problems': item.problems,
                'held_out': held_out[name],
            }
            for name, item in model.candidates.items()
        },
        'omitted': dict(model.omitted),
        'drivers': model.drivers,
        'needs_speed': model.needs_speed,
    }

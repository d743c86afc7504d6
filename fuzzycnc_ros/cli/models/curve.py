# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc curve`: how many sensors are worth having."""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.cli.console import (
    JsonFile,
    Tell,
    check_at_least,
    check_folder,
    progress_bar,
    say,
    show,
    words,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.models.many_bags import SkipBad, runs_of, say_bad
from fuzzycnc_ros.cli.models.recorded_runs import (
    bridged_gaps,
    gap_lines,
    sensors_but,
)
from fuzzycnc_ros.cli.options import (
    Bags,
    DropSensor,
    End,
    Interval,
    Report,
    Seed,
    SensorLimits,
    Start,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fuzzycnc_ros.core.thermal.fit.comparison import Split
    from fuzzycnc_ros.core.thermal.run import ThermalRun
    from fuzzycnc_ros.studies.thermal.sensor_curve import HeldOutCurve

STEPS = 1000
"""Steps of the bar."""


def curve(
    bags: Bags,
    counts: Annotated[
        list[str], typer.Option(metavar='N,...', help='Numbers of sensors to try.')
    ] = ['1,2,3,5,8,10,15'],  # noqa: B006 - typer copies it
    interval: Interval = None,
    drop_sensor: DropSensor = None,
    sensor_limits: SensorLimits = None,
    start: Start = None,
    end: End = None,
    seed: Seed = 0,
    skip_bad: SkipBad = False,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Show how the error on unseen runs falls with the number of sensors.

    For each number the sensors are clustered and the best ranked one of each cluster is fed to
    the stable grey model. Each run is held out in turn; a single bag is cut into its thermal
    cycles, or its later part is predicted from what came before. Where the curve turns flat,
    more sensors add cost and failures but no accuracy.

        fuzzycnc curve monday tuesday wednesday
        fuzzycnc curve shift --counts 1,2,4,8 --report sensors.html
    """
    from fuzzycnc_ros.core.thermal.fit.comparison import splits
    from fuzzycnc_ros.core.thermal.fit.training import at_interval, training_interval
    from fuzzycnc_ros.core.thermal.fit.training_runs import check_training_runs
    from fuzzycnc_ros.studies.thermal.sensor_curve import (
        SensorCurves,
        clusters_line,
        sensor_curve_document,
        sensor_curve_page,
        sensor_curve_table,
    )

    check_at_least('--seed', seed, 0)
    numbers = _numbers(counts)
    check_folder(report, json_file)
    there = find_bags(bags)
    with progress_bar('reading') as tell:
        found = runs_of(
            there,
            interval,
            tell,
            skip=skip_bad,
            start=start,
            stop=end,
            sensors=sensors_but(drop_sensor, bags),
            sensor_limits=sensor_limits or (),
        )
    read = found.results
    interval = training_interval(read, interval)
    runs = [at_interval(run, interval) for run in read]
    check_training_runs(runs)
    held_out = splits(runs, interval=interval)
    usable = min(_warming(split.training) for split in held_out)
    kept = tuple(count for count in numbers if count <= usable)
    if not kept:
        raise ValueError(
            f'--counts: expected a number up to {usable}, since only so many sensors warm up, '
            f'but found '
            f'{", ".join(map(str, numbers))}'
        )
    curves = SensorCurves(kept, runs[0].channel, _curves(held_out, kept, seed))
    show(sensor_curve_table(curves))
    judged = ', '.join(item.run for item in curves.held_out)
    lines = [f'judged on {judged}, each held out; stable grey model', clusters_line(curves)]
    if kept != numbers:
        lines.append(
            f'left out: {", ".join(str(n) for n in numbers if n not in kept)}, as only {usable} '
            'sensors warm up in every training'
        )
    bridged = {run.name: bridged_gaps(run, interval) for run in read}
    for name, gaps in bridged.items():
        lines += gap_lines(name, gaps, interval)
    for line in lines:
        say(line)
    say_bad(found.bad)
    if report is not None:
        from fuzzycnc_ros.studies.page.recorded import recording_facts

        facts = {
            **recording_facts([bag.path for bag in found.used(there)]),
            'Runs': ', '.join(run.name for run in runs),
            'Sampling interval': f'{interval:g} s',
            'Seed': str(seed),
        }
        write_report(report, sensor_curve_page(curves, facts, lines[1:]))
    document: dict[str, Any] = sensor_curve_document(curves)
    document['left_out'] = [count for count in numbers if count not in kept]
    document['bridged'] = bridged
    document['left_out_bags'] = {item.bag.name: item.reason for item in found.bad}
    write_json(json_file, document)


def _curves(
    held_out: 'Sequence[Split]', counts: tuple[int, ...], seed: int
) -> 'tuple[HeldOutCurve, ...]':
    """Judge every number of sensors on everything that is held out."""
    from fuzzycnc_ros.core.thermal.fit import sensor_count_curve
    from fuzzycnc_ros.core.thermal.run import ThermalDataError
    from fuzzycnc_ros.studies.thermal.sensor_curve import HeldOutCurve

    curves = []
    with progress_bar('judging') as tell:
        for number, split in enumerate(held_out):
            place = f'{split.name} ({number + 1} of {len(held_out)})'
            told = partial(_tell, tell, place, number / len(held_out), len(held_out))
            try:
                points = sensor_count_curve(
                    split.training,
                    _judged(split),
                    counts=counts,
                    random_state=seed,
                    progress=told,
                )
            except ThermalDataError as error:
                raise ThermalDataError(f'{split.name} held out: {error}') from error
            curves.append(HeldOutCurve(split.name, points))
    return tuple(curves)


def _tell(
    tell: Tell, place: str, before: float, runs: int, _: str, count: str, done: int, total: int
) -> None:
    """Show a judged number of sensors."""
    tell(f'{place}: {count} sensors', int(STEPS * (before + done / total / runs)), STEPS)


def _judged(split: 'Split') -> 'ThermalRun':
    """Return the held-out run with its displacements only where residuals count."""
    import numpy as np

    run = split.held_out
    inside = run.inside(split.start, split.stop)
    return replace(run, displacement=np.where(inside[:, np.newaxis], run.displacement, np.nan))


def _warming(runs: 'Sequence[ThermalRun]') -> int:
    """Return how many sensors warm up."""
    from fuzzycnc_ros.core.thermal.fit.selection import all_sensors

    return len(all_sensors(runs).chosen)


def _numbers(texts: list[str]) -> tuple[int, ...]:
    """Return the numbers of sensors, each once, from the smallest."""
    given = words(texts)
    if not given or not all(text.isdecimal() and int(text) > 0 for text in given):
        raise ValueError(
            f'--counts: expected numbers of sensors, such as 1,2,5, but found '
            f'{", ".join(given) or "none"}'
        )
    return tuple(sorted({int(text) for text in given}))

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc evaluate --from-nothing`: runs of a machine that is only probed now and then."""

from collections.abc import Sequence
from pathlib import Path

import typer

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.cli.console import progress_bar, remark, say, show, write_json, write_report
from fuzzycnc_ros.cli.models.many_bags import runs_of, say_bad
from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.core.units import LENGTHS


def evaluate_from_nothing(
    bags: Sequence[Path],
    every: float,
    *,
    carry: bool,
    probe_noise: str,
    start: float | None,
    end: float | None,
    sensor_limits: Sequence[str],
    report: Path | None,
    json_file: Path | None,
) -> None:
    """Print what a machine leaves that is learnt from nothing but probes, run by run.

    Arguments are those of `fuzzycnc evaluate`.
    """
    from fuzzycnc_ros.studies.page.recorded import recording_facts
    from fuzzycnc_ros.studies.thermal import learnt

    noise = quantity('--probe-noise', probe_noise, LENGTHS, example='0.5um')
    there, found = find_bags(bags), []
    with progress_bar('learning') as tell:
        read = runs_of(
            there,
            None,
            tell,
            skip=True,
            start=start,
            stop=end,
            sensor_limits=sensor_limits,
        )
        runs = learnt.learn_runs(read.results, every, carry=carry, noise=noise)
        for number, run in enumerate(read.results):
            tell(run.name, number, len(read.results))
            found.append(next(runs))
    for narrow in learnt.narrow_bands(found):
        remark(narrow)
    show(learnt.learnt_table(found))
    for line in learnt.learnt_lines(found):
        say(line)
    say_bad(read.bad)
    if report is not None:
        paths = [bag.path for bag in read.used(there)]
        write_report(report, learnt.learnt_page(found, recording_facts(paths)))
    document = learnt.learnt_document(found)
    document['left_out'] = {item.bag.name: item.reason for item in read.bad}
    write_json(json_file, document)
    if read.bad:
        raise typer.Exit(1)

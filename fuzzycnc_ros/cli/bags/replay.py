# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc replay`: recompute what the components published and compare."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from fuzzycnc_ros.cli.console import JsonFile, check_folder, progress_bar, say, show, write_json

if TYPE_CHECKING:
    from fuzzycnc_ros.replay.replay import ReplayReport, TopicComparison


COMPARED = (
    'recorded',
    'recomputed',
    'identical',
    'largest_difference',
    'first_difference',
    'not_recomputed',
    'left_out',
)
"""Figures of a topic in the file of --json."""


def replay(
    bag: Annotated[Path, typer.Argument(metavar='BAG', help='Bag of a live or simulated run.')],
    exact: Annotated[
        bool, typer.Option('--exact', help="Accept no rounding of another processor's arithmetic.")
    ] = False,
    given: Annotated[
        Optional[list[str]],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            '--given',
            metavar='TOPIC',
            help='Topic that another node wrote, so that it is taken as it is; repeat.',
        ),
    ] = None,
    hashes: Annotated[
        bool,
        typer.Option('--hash', help='Only print the hash of each topic; recompute nothing.'),
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Recompute the outputs in a bag from its inputs, and compare them byte by byte.

    Every component is set up as its recorded configuration says and gets the recorded inputs in
    the order of machine time. What it gives must be what was recorded; the printed hash is the
    same for equal runs, live or simulated. A bag from another kind of processor, or of
    other libraries, may differ in the last digits, which is said and accepted unless --exact is
    given.

    Every recorded topic that a node of this package writes is in the table. What machines and
    foreign nodes wrote is taken as it is, and listed so. Ends with 1 if anything else differs, or
    if not every recorded output could be recomputed.

    With --hash nothing is recomputed: what the bag holds on each topic is hashed in its canonical
    form, in which equal runs agree, and the outputs together.

        fuzzycnc simulate --out shift
        fuzzycnc replay shift
        fuzzycnc replay shift --exact --json replay.json
        fuzzycnc replay shift --hash
    """
    from fuzzycnc_ros.replay.origins import GIVEN_REMEDY
    from fuzzycnc_ros.replay.replay import replay as recompute
    from fuzzycnc_ros.studies.page.table import Column, case_table

    check_folder(json_file)
    if hashes:
        _show_hashes(bag, json_file)
        return
    with progress_bar('replaying') as tell:
        report = recompute(bag, given=given or (), progress=tell)
    topic, recorded = Column('Topic', numeric=False), Column('recorded')
    figures = {
        topic: lambda t: t.topic,
        recorded: lambda t: str(t.recorded),
        Column('recomputed'): lambda t: str(t.recomputed),
        Column('identical'): lambda t: str(t.identical),
        Column('first difference', numeric=False): _remark,
    }
    differing = frozenset(row for row, found in enumerate(report.topics) if not found.equivalent)
    show(case_table('Messages', zip(report.topics), figures, highlight=differing))
    if any(GIVEN_REMEDY in topic.not_recomputed for topic in report.topics):
        say('note: a topic that another node wrote is named as given by --given TOPIC')
    if report.given:
        figures = {topic: figures[topic], recorded: figures[recorded]}
        figures |= {Column('', numeric=False): lambda t: t.origin}
        show(case_table('Taken as they are', zip(report.given), figures))
    for note in report.notes:
        say(f'note: {note}')
    say(f'{_verdict(report)}, hash {report.hash}' if report.hashes else _verdict(report))
    write_json(
        json_file,
        {
            'identical': report.identical,
            'equivalent': report.equivalent,
            'arithmetic': report.arithmetic,
            'hash': report.hash,
            'topics': {
                t.topic: {
                    **{name: getattr(t, name) for name in COMPARED},
                    'hash': report.hashes.get(t.topic),
                }
                for t in report.topics
            },
            'given': {
                item.topic: {'recorded': item.recorded, 'origin': item.origin}
                for item in report.given
            },
            'notes': report.notes,
        },
    )
    if not (report.identical if exact else report.equivalent):
        raise typer.Exit(1)


def _show_hashes(bag: Path, json_file: Path | None) -> None:
    from fuzzycnc_ros.bags.canonical import combined_hash, topic_hashes
    from fuzzycnc_ros.studies.page.table import Column, Table

    found = topic_hashes(bag)
    columns = (Column('Topic', numeric=False), Column('SHA-256', numeric=False))
    show(Table('Canonical hashes', columns, tuple(sorted(found.items()))))
    whole = combined_hash(found)
    say(f'all topics together: {whole}')
    write_json(json_file, {'hash': whole, 'topics': found})


def _remark(topic: 'TopicComparison') -> str:
    if topic.not_recomputed:
        return f'not recomputed: {topic.not_recomputed}'
    if topic.left_out:
        return 'not recorded, as asked for'
    return topic.first_difference


def _verdict(report: 'ReplayReport') -> str:
    if report.identical:
        return 'identical'
    if report.equivalent:
        largest = max(topic.largest_difference for topic in report.topics if not topic.left_out)
        why = 'the bag does not say on what processor it was recorded'
        if report.arithmetic:
            why = f'recorded {report.arithmetic}'
        return f'equal up to rounding ({largest:.0e}; {why})'
    if report.differing:
        return 'DIFFERENT'
    missing = [topic.topic for topic in report.topics if topic.not_recomputed]
    if missing:
        return f'NOT ALL RECOMPUTED: {", ".join(missing)}'
    return 'NOTHING TO COMPARE: no output was recorded'

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc info`: what is in a bag, what is wrong with it, and its repair."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.bags.recording_loss import gaps, holes, lost_messages
from fuzzycnc_ros.cli.console import (
    JsonFile,
    Tell,
    check_folder,
    progress_bar,
    say,
    show,
    write_json,
)

if TYPE_CHECKING:
    from fuzzycnc_ros.bags.reader import BagReader
    from fuzzycnc_ros.bags.repair import RepairReport


OWN_TYPES = 'fuzzycnc_msgs/msg/'
"""Messages whose names need no package in the table."""


def info(
    bag: Annotated[
        Path, typer.Argument(metavar='BAG', help='Bag directory, or a single .mcap or .db3 file.')
    ],
    out: Annotated[
        Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Argument(
            metavar='[OUT]', help='With --repair: the new bag; BAG_repaired if left out.'
        ),
    ] = None,
    repair: Annotated[
        bool,
        typer.Option('--repair', help='Write everything that can be read into a new bag.'),
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Show the contents of a bag: topics, counts, types, times, attachments and problems.

    Every message is counted, not only the index that the bag keeps of itself. A bag whose
    recorder was killed is refused by everything else; --repair writes what can be read of it to
    a new bag and says what was lost. The damaged bag is not changed.

        fuzzycnc info shift
        fuzzycnc info shift --repair
        fuzzycnc info shift --repair shift_whole
    """
    from fuzzycnc_ros.bags.reader import BagReader
    from fuzzycnc_ros.bags.repair import repair as rewrite

    if out is not None and not repair:
        raise typer.BadParameter(f'expected one bag but found {out} too; add --repair')
    check_folder(json_file)
    document: dict[str, Any] = {}
    source = bag
    if repair:
        report = rewrite(bag, out)
        for line in report.lines:
            say(line)
        document['repair'] = _repair_document(report)
        source = report.path
    with BagReader(source, strict=False) as reader:
        with progress_bar('reading') as tell:
            read = _count(reader, tell)
        document |= _describe(reader, read)
    write_json(json_file, document)


def _count(reader: 'BagReader', tell: Tell) -> Counter[str]:
    """Read every message and return how many there are, by topic."""
    from fuzzycnc_ros.bags.typestore import COMPRESSED, is_compressed

    read: Counter[str] = Counter()
    compressed = 0
    for number, message in enumerate(reader.messages(raw=True)):
        read[message.topic] += 1
        compressed += is_compressed(message.message)
        if number % 1000 == 0:
            tell('reading', number, reader.message_count)
    if compressed:
        reader.problems.append(f'{reader.path}: {compressed} messages are {COMPRESSED}')
    return read


def _describe(reader: 'BagReader', read: Counter[str]) -> dict[str, Any]:
    """Print what is in a bag and return it as a document."""
    from fuzzycnc_ros.bags.metadata import is_latched
    from fuzzycnc_ros.studies.page.table import Column, Table

    duration = 1e-9 * (reader.stop - reader.start)
    say(f'{reader.path}: {read.total()} messages in {duration:.3f} s')
    say(f'log time {1e-9 * reader.start:.3f} s to {1e-9 * reader.stop:.3f} s')
    say(f'message set {reader.message_set}')
    beginning = _beginning(reader)
    if beginning:
        say(beginning)
    columns = (
        Column('Topic', numeric=False),
        Column('messages'),
        Column('promised'),
        Column('type', numeric=False),
        Column('kept', numeric=False),
    )
    rows = tuple(
        (
            topic,
            str(read[topic]),
            str(item.message_count),
            item.type.removeprefix(OWN_TYPES),
            'latched' if is_latched(item.profiles) else 'stream',
        )
        for topic, item in sorted(reader.connections.items())
    )
    if rows:
        show(Table(f'Topics; types without a package are of {OWN_TYPES}', columns, rows))
    attachments = reader.attachments()
    for name, item in attachments.items():
        say(f'attachment {name}: {len(item.data):,} bytes, {item.media_type}')
    lost, holed = lost_messages(attachments), holes(attachments)
    unwritten = gaps(attachments)
    for topic, count in lost.items():
        say(f'lost while recording: {count} messages of {topic}')
    for topic, text in holed.items():
        say(f'holes while recording: {topic} has {text}')
    for text in unwritten:
        say(f'not written while recording: {text}')
    for problem in reader.problems:
        say(f'problem: {problem}')
    return {
        'path': str(reader.path),
        'messages': read.total(),
        'start_s': 1e-9 * reader.start,
        'duration_s': duration,
        'message_set': reader.message_set,
        'topics': {
            topic: {'messages': read[topic], 'promised': item.message_count, 'type': item.type}
            for topic, item in sorted(reader.connections.items())
        },
        'attachments': {name: len(item.data) for name, item in attachments.items()},
        'lost_while_recording': lost,
        'holes_while_recording': holed,
        'not_written_while_recording': unwritten,
        'parts': len(reader.files),
        'missing_parts': reader.missing_parts,
        'problems': reader.problems,
    }


def _beginning(reader: 'BagReader') -> str:
    """Return in words what of the recording's beginning is not there; empty if it all is."""
    from fuzzycnc_ros.bags.metadata import DELETED_MESSAGES_KEY, DELETED_UNTIL_KEY

    parts = reader.missing_parts
    if not parts:
        return ''
    deleted = reader.metadata.custom if reader.metadata else {}
    if DELETED_UNTIL_KEY not in deleted:
        return f'the beginning is missing: {parts} parts of the recording come before'
    until = 1e-9 * int(deleted[DELETED_UNTIL_KEY])
    return (
        f'the beginning is missing: {parts} parts, {deleted.get(DELETED_MESSAGES_KEY)} messages '
        f'up to {until:.3f} s, were deleted to stay within the budget'
    )


def _repair_document(report: 'RepairReport') -> dict[str, Any]:
    return {
        'path': str(report.path),
        'damage': report.damage,
        'topics': {
            name: {
                'kept': topic.kept,
                'lost': topic.lost,
                'behind_s': None if topic.last is None else 1e-9 * (report.stop - topic.last),
            }
            for name, topic in report.topics.items()
        },
    }

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Origin of recordings, for the top of a page."""

from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

from fuzzycnc_ros.bags.csv_time import zone_of
from fuzzycnc_ros.bags.errors import CsvError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.core.names import first_names

_SHOWN = 3
"""Names that are listed; of more the first ones and how many there are."""

_DATED = 10**18
"""Time from which on a stamp is a date [ns]; simulated machines count from their start."""


def recording_facts(bags: Sequence[Path]) -> dict[str, str]:
    """Return when bags were recorded, on which machines, and their names.

    Parameters
    ----------
    bags : sequence of Path
        Bags, one at least.

    Returns
    -------
    dict
        `Recorded`, `Machine`, `Bag`.

    Raises
    ------
    BagError
        If a bag cannot be read.
    """
    dates, machines = [], []
    for bag in bags:
        with BagReader(bag) as reader:
            dates.append(recorded_date(reader.start, recorded_zone(reader)))
            machines += [
                topic.rpartition('/')[0].strip('/')
                for topic in reader.connections
                if topic.endswith('/temperatures')
            ]
    return {
        'Recorded': first_names(dates, _SHOWN) or 'in machine time, without a date',
        'Machine': first_names(machines, _SHOWN) or 'not named in the bag',
        'Bag': first_names([bag.name for bag in bags], _SHOWN),
    }


def recorded_zone(reader: BagReader) -> str:
    """Return the zone of the clock of a bag, as `fuzzycnc import-csv` wrote it; else nothing."""
    return reader.metadata.custom.get('time_zone', '') if reader.metadata else ''


def recorded_date(start: int, zone: str = '') -> str:
    """Return the date of a stamp [ns], nothing if it counts from the start of a simulation.

    Parameters
    ----------
    start : int
        The stamp.
    zone : str
        Zone of its clock, as `recorded_zone` returns it; UTC where it is not known.
    """
    if start < _DATED:
        return ''
    try:
        rules = zone_of(zone or 'UTC').rules
    except CsvError:
        zone, rules = 'UTC', timezone.utc
    date = datetime.fromtimestamp(start // 10**9, rules)
    return f'{date:%Y-%m-%d %H:%M} {zone or "UTC"}'

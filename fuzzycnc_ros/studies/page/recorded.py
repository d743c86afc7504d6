# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where recordings come from, for the top of a page."""

from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

from fuzzycnc_ros.bags.reader import BagReader

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
    starts, machines = [], []
    for bag in bags:
        with BagReader(bag) as reader:
            starts.append(reader.start)
            machines += [
                topic.rpartition('/')[0].strip('/')
                for topic in reader.connections
                if topic.endswith('/temperatures')
            ]
    dates = [date for date in map(recorded_date, starts) if date]
    return {
        'Recorded': _listed(dates) if dates else 'in machine time, without a date',
        'Machine': _listed(machines) or 'not named in the bag',
        'Bag': _listed([bag.name for bag in bags]),
    }


def recorded_date(start: int) -> str:
    """Return the date of a stamp [ns], nothing if it counts from the start of a simulation."""
    if start < _DATED:
        return ''
    return datetime.fromtimestamp(start // 10**9, timezone.utc).strftime('%Y-%m-%d %H:%M UTC')


def _listed(names: Sequence[str]) -> str:
    """Return names, each once, shortened where there are many."""
    each = list(dict.fromkeys(name for name in names if name))
    if len(each) <= _SHOWN:
        return ', '.join(each)
    return f'{", ".join(each[:_SHOWN])} and {len(each) - _SHOWN} more'

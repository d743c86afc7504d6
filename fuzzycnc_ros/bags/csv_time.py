# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Dates and times of day in a CSV recording."""

import re
from collections.abc import Sequence
from datetime import datetime, timezone

import numpy as np
from numpy.typing import NDArray

ISO8601 = 'iso8601'

_CLOCKS = ('%H:%M:%S', '%H:%M', '%I:%M:%S %p', '%I:%M %p')
_DATES = ('%d.%m.%Y', '%d.%m.%y', '%Y/%m/%d', '%Y.%m.%d')
_EITHER = ('%d/%m/%Y', '%m/%d/%Y', '%d/%m/%y', '%m/%d/%y', '%d-%m-%Y', '%m-%d-%Y')
KNOWN_FORMATS = (
    ISO8601,
    *(f'{date} {clock}' for date in (*_DATES, *_EITHER) for clock in _CLOCKS[:2]),
    # Who writes AM and PM writes the month first.
    *(f'{date} {clock}' for date in (*_DATES, *_EITHER[::-1]) for clock in _CLOCKS[2:]),
    *_CLOCKS,
)
"""Forms that are recognised, as `strptime` writes them."""

DAY = 86400.0
"""Length of a day [s]."""

_FRACTION = re.compile(r'(?<=:\d\d)[.,](\d+)')
_DATE_PART = re.compile(r'%[dmyYjbBDFxcUWGuw]')


_TOKEN = re.compile(r'yyyy|jjjj|yy|jj|dd|tt|hh?|mm|ss|am/pm', re.IGNORECASE)
_DIRECTIVES = {
    **dict.fromkeys(('yyyy', 'jjjj'), '%Y'),
    **dict.fromkeys(('yy', 'jj'), '%y'),
    **dict.fromkeys(('dd', 'tt'), '%d'),
    'ss': '%S',
    'am/pm': '%p',
}


def strptime_form(text: str) -> str:
    """Return a form as `strptime` writes it, from that or from what spreadsheets call it.

    Raises
    ------
    ValueError
        If it is neither.

    Examples
    --------
    >>> strptime_form('dd.mm.yyyy hh:mm:ss'), strptime_form('TT.MM.JJJJ hh:mm')
    ('%d.%m.%Y %H:%M:%S', '%d.%m.%Y %H:%M')
    """
    if text == ISO8601:
        return text
    form = text if '%' in text else _from_spreadsheet(text)
    if '%' not in form or not _is_form(form):
        raise ValueError(
            'expected a form such as %d.%m.%Y %H:%M:%S, dd.mm.yyyy hh:mm:ss or iso8601 but '
            f'found {text!r}'
        )
    return form


def _is_form(form: str) -> bool:
    try:
        datetime.strptime('', form)
    except ValueError as error:
        return re.search('bad directive|stray', str(error)) is None
    return True


def _from_spreadsheet(text: str) -> str:
    hour = '%I' if re.search('am/pm', text, re.IGNORECASE) else '%H'
    names = [token.lower() for token in _TOKEN.findall(text)]
    places = iter(range(len(names)))

    def directive(_: re.Match[str]) -> str:
        place = next(places)
        name = names[place]
        if name == 'mm':  # minutes behind an hour or before a second, months else
            near = (names[place - 1 : place], names[place + 1 : place + 2])
            return '%M' if near[0] in (['h'], ['hh']) or near[1] == ['ss'] else '%m'
        return hour if name in ('h', 'hh') else _DIRECTIVES[name]

    return _TOKEN.sub(directive, text)


def has_date(form: str) -> bool:
    """Return whether a form says the day."""
    return form == ISO8601 or _DATE_PART.search(form) is not None


def read_time(text: str, form: str) -> float:
    """Return the seconds of a date since 1970, or of a time of day since midnight.

    A zone that the text does not name is UTC.  A fraction of a second may stand behind a point
    or a comma.

    Raises
    ------
    ValueError
        If the text has another form.
    """
    text = text.strip()
    if form == ISO8601:
        # Python 3.10 does not know the Z of ISO 8601.
        date = datetime.fromisoformat(f'{text[:-1]}+00:00' if text.endswith('Z') else text)
        return _seconds(date)
    fraction = 0.0
    if '%f' not in form:
        found = _FRACTION.search(text)
        if found:
            fraction = float(f'0.{found[1]}')
            text = text[: found.start()] + text[found.end() :]
    date = datetime.strptime(text, form)
    if not has_date(form):
        date = date.replace(year=1970, month=1, day=1)
    return _seconds(date) + fraction


def known_forms(cells: Sequence[str]) -> list[str]:
    """Return the known forms that all of some texts have; none if there is no text."""
    return [form for form in KNOWN_FORMATS if cells and all(_has(cell, form) for cell in cells)]


def is_day(text: str) -> bool:
    """Return whether a text is a date in a known form, without a time of day."""
    return any(_has(text, form) for form in (*_DATES, *_EITHER))


def first_misfit(cells: Sequence[str], form: str) -> int | None:
    """Return the number of the first text that has another form."""
    return next((row for row, cell in enumerate(cells) if not _has(cell, form)), None)


def past_midnight(seconds: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[int]]:
    """Return times of day with a day more after each midnight, and the rows that follow one.

    Midnight lies where the clock goes back by more than half a day; by less, it was set.
    """
    rows = np.flatnonzero(np.diff(seconds) < -0.5 * DAY) + 1
    days = np.zeros(len(seconds))
    days[rows] = 1.0
    return seconds + DAY * np.cumsum(days), rows.tolist()


def _has(text: str, form: str) -> bool:
    try:
        read_time(text, form)
    except ValueError:
        return False
    return True


def _seconds(date: datetime) -> float:
    zoned = date if date.tzinfo is not None else date.replace(tzinfo=timezone.utc)
    return zoned.timestamp()

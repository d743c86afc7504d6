# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Dates and times of day in a CSV recording: their forms, and the zone of those that name none."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone, tzinfo
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.errors import CsvError

DAY = 86400.0
"""Length of a day [s]."""

ISO8601 = 'iso8601'

STEP_MAX = 3.0
"""Longest step over the median one that is no gap [-]."""

_TEXT = re.compile(
    r"""(?:(?P<date>
        (?P<year>\d{4})(?P<by>[-/._:\ ])\d{1,2}(?P=by)\d{1,2}
        |\d{1,2}(?P<between>[-/._\ ])\d{1,2}(?P=between)(?P<last>\d{4}|\d{2})
        |\d{1,2}(?P<beside>[-/._\ ]?)(?P<month>[A-Za-z]{3,9})(?P=beside)(?P<end>\d{4}|\d{2})
        |\d{8}
    )(?:(?P<join>[\ T_,;@.:-]{1,3})|$|(?=\d{6}$)))?
    (?P<clock>
        \d{1,2}(?P<sign>[:._-])\d{2}(?:(?P=sign)(?P<second>\d{2})(?:[.,]\d+)?)?
        |(?P<digits>\d{6}|\d{4})(?:[.,]\d+)?
    )?
    (?P<half>(?P<space>\s*)[AaPp]\.?[Mm]\.?)?
    (?P<zone>(?P<gap>\s*)(?P<offset>Z|UTC|GMT|[+-]\d{2}:?\d{2}))?""",
    re.VERBOSE,
)
"""A date and a time of day, or one of them, as loggers and spreadsheets write them."""

_ISO = re.compile(
    r'\d{4}-\d\d-\d\d(?:[T ]\d\d(?::\d\d(?::\d\d(?:[.,]\d+)?)?)?(?:Z|[+-]\d\d(?::?\d\d)?)?)?'
)
"""Recognised part of ISO 8601; Python reads more, differently from version to version."""

_FRACTION = re.compile(
    r'(?<=\d)[.,](\d+)(?=\s*(?:[AP]\.?M\.?)?\s*(?:Z|UTC|GMT|[+-]\d\d:?\d\d)?$)'
    r'|(?<=:\d\d)[.,](\d+)',
    re.IGNORECASE,
)
_HALF = re.compile(r'([AP])\.?(M)\b\.?', re.IGNORECASE)
_UTC = ('Z', 'UTC', 'GMT')
_DATE_PART = re.compile(r'%[dmyYjbBDFxcUWGuw]')

_TOKEN = re.compile(r'yyyy|jjjj|yy|jj|dd|tt|hh?|mm|ss|am/pm', re.IGNORECASE)
_DIRECTIVES = {
    **dict.fromkeys(('yyyy', 'jjjj'), '%Y'),
    **dict.fromkeys(('yy', 'jj'), '%y'),
    **dict.fromkeys(('dd', 'tt'), '%d'),
    'ss': '%S',
    'am/pm': '%p',
}

_OFFSET = re.compile(r'(?:UTC|GMT)?([+-])(\d{1,2}):?(\d{2})?', re.IGNORECASE)
_FIXED = (
    'a logger that does not follow summer time has a fixed offset: name it with --time-zone, such '
    'as UTC or +01:00'
)
_LOCALTIME = Path('/etc/localtime')


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


def read_date(text: str, form: str) -> datetime:
    """Return a date, or a time of day on the first day of 1970.

    A fraction of a second may stand behind a point or a comma.  The date has a zone if the text
    names one.

    Raises
    ------
    ValueError
        If the text has another form.

    Examples
    --------
    >>> read_date('2021/06/13-05:42:16,5', '%Y/%m/%d-%H:%M:%S').isoformat()
    '2021-06-13T05:42:16.500000'
    """
    text = _HALF.sub(r'\1\2', text.strip())
    try:
        date = _parsed(text, form)
    except ValueError:
        found = _FRACTION.search(text)
        if not found or not ('%S' in form or (form == ISO8601 and ':' in text)):
            raise
        date = _parsed(text[: found.start()] + text[found.end() :], form)
        date += timedelta(seconds=float(f'0.{found[1] or found[2]}'))
    return date if has_date(form) else date.replace(year=1970, month=1, day=1)


def _parsed(text: str, form: str) -> datetime:
    if form == ISO8601:
        # Python 3.10 does not know the Z of ISO 8601.
        return datetime.fromisoformat(f'{text[:-1]}+00:00' if text.endswith('Z') else text)
    date = datetime.strptime(text, form)
    return date.replace(tzinfo=timezone.utc) if form.endswith(_UTC) else date


def has_form(text: str, form: str) -> bool:
    """Return whether a text has a form."""
    try:
        read_date(text, form)
    except ValueError:
        return False
    return True


def known_forms(cells: Sequence[str]) -> list[str]:
    """Return the known forms that all of some texts have; none if there is no text.

    Examples
    --------
    >>> known_forms(['13/06/2021 05:42', '01/07/2021 05:42'])
    ['%d/%m/%Y %H:%M']
    """
    if not cells:
        return []
    return [
        form for form in _forms_of(cells[0].strip()) if all(has_form(cell, form) for cell in cells)
    ]


def is_day(text: str) -> bool:
    """Return whether a text is a date in a known form, without a time of day."""
    found = _TEXT.fullmatch(text.strip())
    dates = _date_forms(found) if found and found['date'] and not found['clock'] else []
    return any(has_form(text, form) for form in dates)


def _forms_of(text: str) -> list[str]:
    """Return the forms that a text may have, the likelier first."""
    if _ISO.fullmatch(text) and has_form(text, ISO8601):
        return [ISO8601]
    found = _TEXT.fullmatch(text)
    if found is None or not found['clock']:
        return []
    if not found['date'] and (found['sign'] != ':'):
        return []
    clock = _clock_form(found)
    dates = _date_forms(found) if found['date'] else ['']
    return [f'{date}{found["join"] or ""}{clock}' for date in dates]


def _clock_form(found: re.Match[str]) -> str:
    hour = '%I' if found['half'] else '%H'
    if found['digits']:
        form = f'{hour}%M%S' if len(found['digits']) == 6 else f'{hour}%M'
    else:
        form = f'{hour}{found["sign"]}%M' + (f'{found["sign"]}%S' if found['second'] else '')
    if found['half']:
        form += f'{found["space"]}%p'
    if found['zone']:
        form += found['gap'] + (found['offset'] if found['offset'] in _UTC else '%z')
    return form


def _date_forms(found: re.Match[str]) -> list[str]:
    """Return the forms of a date: its order may be that of several countries."""
    if found['year']:
        return [found['by'].join(('%Y', '%m', '%d'))]
    if found['month']:
        year = '%Y' if len(found['end']) == 4 else '%y'
        return [found['beside'].join(('%d', month, year)) for month in ('%b', '%B')]
    if not found['last']:
        return ['%Y%m%d']
    year = '%Y' if len(found['last']) == 4 else '%y'
    orders = [('%d', '%m', year)]
    if found['between'] != '.':  # nobody writes the month first before a point
        orders.append(('%m', '%d', year))
        if found['half']:
            orders.reverse()  # who writes AM and PM writes the month first
        if year == '%y':
            orders.append((year, '%m', '%d'))
    return [found['between'].join(order) for order in orders]


@dataclass(frozen=True)
class Zone:
    """The zone of dates that name none.

    Parameters
    ----------
    name : str
        Its name: of the IANA, or an offset such as UTC+01:00.
    rules : tzinfo or None
        Its offsets; None for those of this computer where they have no name.
    chosen : bool
        Whether somebody named it; else it is that of this computer.
    """

    name: str
    rules: tzinfo | None
    chosen: bool


class ClockChangeError(ValueError):
    """A date that a zone does not have, or has twice; `row` is the place among the dates."""

    def __init__(self, row: int, text: str) -> None:
        super().__init__(text)
        self.row = row


def zone_of(name: str | None) -> Zone:
    """Return a zone by its name, or that of this computer.

    Raises
    ------
    CsvError
        If there is no such zone.

    Examples
    --------
    >>> zone_of('+01:00').name, zone_of('Europe/Berlin').name
    ('UTC+01:00', 'Europe/Berlin')
    """
    if name is None:
        return _computer_zone()
    found = _OFFSET.fullmatch(name.strip())
    if found:
        offset = timedelta(hours=int(found[2]), minutes=int(found[3] or 0))
        if offset < timedelta(hours=15):
            fixed = timezone(offset if found[1] == '+' else -offset)
            return Zone(str(fixed), fixed, chosen=True)
    rules = _rules(name)
    if rules is None:
        raise CsvError(
            'time_zone: expected a name of the IANA such as Europe/Berlin or UTC, or an offset '
            f'such as +01:00 without summer time, but found {name!r}'
        )
    return Zone(name, rules, chosen=True)


def _rules(name: str) -> ZoneInfo | None:
    try:
        return ZoneInfo(name)
    except (ValueError, OSError, KeyError):  # ZoneInfoNotFoundError is a KeyError
        return None


def _computer_zone() -> Zone:
    told = os.environ.get('TZ', '').lstrip(':')
    if not told and _LOCALTIME.exists():
        told = str(_LOCALTIME.resolve()).rpartition('zoneinfo/')[2]
    rules = _rules(told) if told else None
    if rules is not None:
        return Zone(told, rules, chosen=False)
    now = datetime.now().astimezone()
    return Zone(told if os.environ.get('TZ') else str(now.tzname()), None, chosen=False)


def seconds_of(dates: Sequence[datetime], zone: Zone) -> NDArray[np.float64]:
    """Return the seconds since 1970 of increasing dates, those without a zone being of `zone`.

    Where the clocks of the zone go back, an hour comes twice.  Its first pass counts until the
    dates themselves go back, and its second one behind that.  Dates that do not go back and leave
    the hour, but begin in it or come to it after a gap, belong to the second pass.

    Raises
    ------
    ClockChangeError
        If the zone does not have a date, or the dates pass through the hour once only, as
        they do where a logger does not follow summer time.
    """
    naive = [date.tzinfo is None for date in dates]
    zoned = [
        date.replace(tzinfo=zone.rules) if bare else date
        for date, bare in zip(dates, naive, strict=True)
    ]
    early = np.array([date.timestamp() for date in zoned])
    late = np.array([date.replace(fold=1).timestamp() for date in zoned])
    skipped = np.flatnonzero((late < early) & naive)  # a fold before a gap is behind it
    if len(skipped):
        row = int(skipped[0])
        raise ClockChangeError(
            row,
            f'expected a time of {zone.name} but its clocks leave out {dates[row]}, when summer '
            f'time begins; {_FIXED}',
        )
    twice = np.concatenate([[False], (late > early) & naive, [False]])
    edges = np.flatnonzero(twice[1:] != twice[:-1])
    for first, end in edges.reshape(-1, 2).tolist():
        local = [date.replace(tzinfo=None) for date in dates[first:end]]
        back = next((row for row in range(1, len(local)) if local[row] <= local[row - 1]), None)
        if back is not None:
            early[first + back : end] = late[first + back : end]
        elif first == 0 and end < len(dates):
            early[:end] = late[:end]
        elif end < len(dates):
            usual = STEP_MAX * float(np.median(np.diff(early)))
            entered, left = (
                early[first] - early[first - 1] > usual,
                late[end] - late[end - 1] > usual,
            )
            if entered == left:
                raise ClockChangeError(
                    end,
                    f'expected times that go back by an hour, as clocks of {zone.name} do, but '
                    f'found {dates[end - 1]} and then {dates[end]}; {_FIXED}',
                )
            if entered:
                early[first:end] = late[first:end]
    return early


def past_midnight(seconds: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[int]]:
    """Return times of day with a day more after each midnight, and the rows that follow one.

    Midnight lies where the clock goes back by more than half a day; by less, it was set.
    """
    rows = np.flatnonzero(np.diff(seconds) < -0.5 * DAY) + 1
    days = np.zeros(len(seconds))
    days[rows] = 1.0
    return seconds + DAY * np.cumsum(days), rows.tolist()

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""CSV recordings as other programs write them: what is recognised, and which option is named."""

import re
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from fuzzycnc_ros.bags.csv_import import import_csv
from fuzzycnc_ros.bags.csv_mapping import CsvMapping
from fuzzycnc_ros.bags.csv_table import read_sensor_table
from fuzzycnc_ros.bags.csv_time import known_forms, read_date, strptime_form, zone_of
from fuzzycnc_ros.bags.errors import BagError, CsvError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.studies.page.recorded import recording_facts

COUNT = 120
SECONDS = 60.0 * np.arange(COUNT)
FRONT = 21.0 + 12.0 * (1.0 - np.exp(-SECONDS / 1800.0))
REAR = 20.5 + 0.5 * (FRONT - 21.0)
MOVED = 2.5 * (FRONT - 21.0)
BEGIN = datetime(2026, 3, 12, 21, 30)


def table(times=None, head='t;a;b;ch', separator=';', change=lambda rows: None):
    """Return a recording as text; `change` edits its rows of texts, the header being row 0."""
    times = times or [f'{second:g}' for second in SECONDS]
    rows = [head.split(';')] if head else []
    for time, *values in zip(times, FRONT, REAR, MOVED, strict=True):
        rows.append([time, *(f'{value:.3f}' for value in values)])
    change(rows)
    return '\r\n'.join(separator.join(row) for row in rows) + '\r\n'


def clock(form, begin=BEGIN, step=60.0):
    """Return the times of the rows in some form."""
    return [(begin + timedelta(seconds=step * row)).strftime(form) for row in range(COUNT)]


def german(head='Zeit;Vorn [°C];Hinten [°C];Z [µm]'):
    times = [
        (BEGIN + timedelta(seconds=second)).strftime('%d.%m.%Y %H:%M:%S') for second in SECONDS
    ]
    return table(times, head).replace('.', ',').replace(',03,2026', '.03.2026')


GERMAN = {
    'time': 'Zeit',
    'temperatures': ['Vorn*', 'Hinten*'],
    'displacements': ['Z [µm]=Z:um'],
    'decimal': ',',
}


OWN_ZONE = (
    "times of 't' that name no zone read as UTC, the zone of this computer; --time-zone names "
    'another'
)


@pytest.fixture(autouse=True)
def in_utc(monkeypatch):
    """Let this computer be in a zone that is known."""
    monkeypatch.setenv('TZ', 'UTC')


@pytest.fixture
def importing(tmp_path):
    """Import a text, written in some encoding."""

    def run(text, written='utf-8', **options):
        file = tmp_path / 'recording.csv'
        file.write_bytes(text if isinstance(text, bytes) else text.encode(written))
        plain = {'time': 't', 'temperatures': ['a', 'b'], 'displacements': ['ch=Z:um']}
        return import_csv(file, tmp_path / 'bag', CsvMapping(**{**plain, **options}))

    return run


@pytest.fixture
def complaint(importing, tmp_path):
    """Return the one line in which a text is refused."""

    def run(text, written='utf-8', **options):
        with pytest.raises(CsvError) as caught:
            importing(text, written, **options)
        assert '\n' not in str(caught.value)
        assert not (tmp_path / 'bag').exists()
        return str(caught.value)

    return run


# Encodings


@pytest.mark.parametrize('encoding', ['cp1252', 'latin-1', 'utf-16', 'utf-16-le'])
def test_other_encodings_are_named_and_read(importing, complaint, tmp_path, encoding):
    text = complaint(german(), encoding, **GERMAN)
    named = 'utf-16' if encoding.startswith('utf-16') else 'cp1252'
    assert f'import with --encoding {named}' in text
    report = importing(german(), encoding, **GERMAN, encoding=encoding)
    assert report.sensors == ('Vorn [°C]', 'Hinten [°C]')
    np.testing.assert_allclose(read_run(tmp_path / 'bag').temperature[:, 0], FRONT, atol=1e-3)


def test_a_byte_order_mark_is_no_part_of_the_first_name(importing):
    assert importing(german(), 'utf-8-sig', **GERMAN).samples == COUNT


def test_a_wrong_byte_is_placed(complaint):
    text = complaint(german(), 'cp1252', **GERMAN)
    assert "line 1: expected text in utf-8 but byte 11 is 0xb0, in cp1252 '°'" in text
    text = complaint(b't;a;b;ch\r\n\x81', encoding='cp1252')
    assert '0x81' in text
    assert '--encoding latin-1, or else utf-16' in text


@pytest.mark.parametrize('count', [1, 2, 5000])
def test_zero_bytes_of_a_torn_write_are_placed(complaint, count):
    text = table().encode()
    place = text.index(b'\n', 400) + 3
    line = text.count(b'\n', 0, place) + 1
    found = complaint(text[:place] + bytes(count) + text[place:])
    number = 'a zero byte as' if count == 1 else f'{count} zero bytes, the first one as'
    assert f'line {line}: expected text but found {number} byte {place}' in found
    assert f'as byte {place}, as a torn write leaves them; delete what is damaged' in found
    assert complaint(text + bytes(count)).endswith('delete what is damaged')


def test_text_that_is_utf8_is_not_read_as_another_encoding(importing, complaint):
    text = complaint(german(), **GERMAN, encoding='cp1252')
    assert text.endswith('expected text in cp1252 but it is UTF-8; import without --encoding')
    assert importing(table(), encoding='cp1252').samples == COUNT  # the same in both


def test_a_workbook_is_no_csv_file(complaint):
    for data in (b'PK\x03\x04rest', b'\xd0\xcf\x11\xe0rest'):
        assert 'found a workbook; save its sheet as CSV' in complaint(data)


@pytest.mark.parametrize('name', ['foo', 'base64', ''])
def test_an_encoding_must_be_known(name):
    with pytest.raises(CsvError, match=r'encoding: expected a text encoding such as utf-8'):
        CsvMapping(encoding=name)


# Times


FORMS = (
    '%d.%m.%Y %H:%M:%S',
    '%d.%m.%y %H:%M',
    '%Y-%m-%d %H:%M:%S',
    '%Y-%m-%dT%H:%M:%S',
    '%Y/%m/%d %H:%M:%S',
    '%d/%m/%Y %H:%M:%S',
    '%m/%d/%Y %I:%M:%S %p',
    '%m-%d-%Y %H:%M',
)


@pytest.mark.parametrize('form', FORMS)
def test_usual_dates_are_recognised_and_said(importing, tmp_path, form):
    report = importing(table(clock(form, datetime(2026, 3, 25, 21, 30))))
    iso = form.startswith('%Y-')
    assert report.remarks == (f"times of 't' read as {'iso8601' if iso else form}", OWN_ZONE)
    assert report.interval == 60.0
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.start == 1774474200 * 10**9


def test_a_time_of_day_goes_past_midnight(importing, tmp_path):
    report = importing(table(clock('%H:%M:%S', step=180.0)))
    assert report.remarks == (
        "times of 't' read as %H:%M:%S",
        'the clock passes midnight before line 52: a day was added',
    )
    assert read_run(tmp_path / 'bag').time[-1] == 3 * SECONDS[-1]


def test_a_clock_that_goes_back_by_less_than_half_a_day_was_set(complaint):
    times = clock('%H:%M:%S')
    times[60:] = times[:60]
    text = complaint(table(times))
    assert "line 62, column 't': expected a time after 22:29:00 but found 21:30:00" in text
    assert text.endswith('import runs one by one with --rows 0:59 and --rows 60:119')


def test_rows_of_a_refusal_count_as_rows_of_the_option_do(complaint):
    times = [f'{second:g}' for second in [*SECONDS[:60], *SECONDS[:60]]]
    text = complaint(table(times), rows=(20, 110))
    assert text.endswith('with --rows 20:59 and --rows 60:110')


def test_fractions_of_a_second_stand_behind_point_or_comma(importing, tmp_path):
    for sign in '.,':
        times = clock('%d.%m.%Y %H:%M:%S', step=0.25)
        times = [f'{time}{sign}{25 * (row % 4):02d}' for row, time in enumerate(times)]
        importing(table(times))
        found = read_run(tmp_path / 'bag').time
        np.testing.assert_allclose(found, 0.25 * np.arange(COUNT), atol=1e-6)
        (tmp_path / 'bag').rename(tmp_path / f'bag{sign}')


def test_a_date_that_can_be_read_in_two_ways_is_asked_for(importing, complaint):
    begin = datetime(2026, 3, 4, 23, 30)
    times = [
        (begin + timedelta(seconds=second)).strftime('%d/%m/%Y %H:%M:%S') for second in SECONDS
    ]
    text = complaint(table(times))
    assert "--time-format '%d/%m/%Y %H:%M:%S' or '%m/%d/%Y %H:%M:%S'" in text
    report = importing(table(times), time_format='%d/%m/%Y %H:%M:%S')
    assert (report.remarks, report.interval) == ((OWN_ZONE,), 60.0)


def test_the_other_way_is_said_where_it_makes_no_difference(importing):
    times = clock('%d/%m/%Y %H:%M', datetime(2026, 3, 4, 8, 30))
    remark, _ = importing(table(times)).remarks
    assert 'read as %d/%m/%Y %H:%M, which could be %m/%d/%Y %H:%M: see --time-format' in remark


@pytest.mark.parametrize(
    ('form', 'expected'),
    [
        ('%d.%m.%Y %H:%M:%S', '%d.%m.%Y %H:%M:%S'),
        ('dd.mm.yyyy hh:mm:ss', '%d.%m.%Y %H:%M:%S'),
        ('TT.MM.JJ hh:mm', '%d.%m.%y %H:%M'),
        ('mm/dd/yyyy h:mm AM/PM', '%m/%d/%Y %I:%M %p'),
        ('mm:ss', '%M:%S'),
        ('iso8601', 'iso8601'),
    ],
)
def test_forms_of_spreadsheets_are_understood(form, expected):
    assert strptime_form(form) == CsvMapping(time_format=form).time_format == expected


@pytest.mark.parametrize('form', ['', 'german', '%q', '%d.%m.%', 'seconds'])
def test_other_forms_are_not(form):
    with pytest.raises(CsvError, match=r'time_format: expected a form such as %d\.%m\.%Y'):
        CsvMapping(time_format=form)


DATES = [
    *(sign.join(('%Y', '%m', '%d')) for sign in '-/._'),
    *(sign.join(order) for sign in '-/' for order in (('%d', '%m', '%Y'), ('%m', '%d', '%y'))),
    *('%d.%m.%Y', '%d.%m.%y', '%d %m %Y', '%y-%m-%d', '%d-%b-%Y', '%d %B %Y', '%Y%m%d'),
]
CLOCKS = [
    *('%H:%M:%S', '%H:%M', '%H.%M.%S', '%H-%M-%S', '%H%M%S', '%I:%M:%S %p', '%I:%M:%S%p'),
    *('%I:%M %p', '%H:%M:%SZ', '%H:%M:%S UTC', '%H:%M:%S%z'),
]


@pytest.mark.parametrize('join', [' ', '-', 'T', '_', ', ', '  ', ';'])
def test_dates_and_times_of_usual_forms_are_recognised(join):
    date = datetime(2026, 11, 29, 13, 59, 58, tzinfo=timezone.utc)
    for form in (f'{day}{join}{clock}' for day in DATES for clock in CLOCKS):
        text = date.strftime(form)
        read = [read_date(text, known).replace(second=58) for known in known_forms([text])]
        assert date.replace(tzinfo=None) in [item.replace(tzinfo=None) for item in read], text


@pytest.mark.parametrize(
    ('first', 'second'),
    [
        ('2021/06/13-05:42:16', '2021/06/13-05:43:16'),
        ('2021.06.13_05.42.16,25', '2021.06.13_05.43.16,25'),
        ('13.06.21 05:42:16.250', '13.06.21 05:43:16.250'),
        ('13/Jun/2021:05:42:16 +0200', '13/Jun/2021:05:43:16 +0200'),
        ('6/13/2021 5:42:16 a.m.', '6/13/2021 5:43:16 a.m.'),
        ('06/13/21 05:42 PM', '06/13/21 05:43 PM'),
        ('20210613054216', '20210613054316'),
        ('20210613_054216', '20210613_054316'),
        ('2021:06:13 05:42:16', '2021:06:13 05:43:16'),
    ],
)
def test_one_way_to_read_a_date_is_taken(first, second):
    form = known_forms([first])[0] if not first.isdigit() else '%Y%m%d%H%M%S'
    begin, end = read_date(first, form), read_date(second, form)
    assert (begin.year, begin.month, begin.day, begin.minute) == (2021, 6, 13, 42)
    assert (end - begin).total_seconds() == 60.0


@pytest.mark.parametrize('text', ['05.42', '2021', '13.13.2021 05:42', 'x', '12-13', '1:2:3:4'])
def test_what_is_no_date_has_no_form(text):
    assert known_forms([text]) == []


def test_digits_that_are_dates_are_no_seconds(importing, tmp_path):
    report = importing(table(clock('%Y%m%d%H%M%S')))
    assert report.interval == 60.0
    assert report.remarks[0].endswith(' read as %Y%m%d%H%M%S')
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.start == 1773351000 * 10**9


@pytest.mark.parametrize(
    ('form', 'ways'),
    [
        ('%d-%m-%y %H:%M', ["'%d-%m-%y %H:%M'", "'%m-%d-%y %H:%M'", "'%y-%m-%d %H:%M'"]),
        ('%m/%d/%Y, %I:%M %p', ["'%m/%d/%Y, %I:%M %p'", "'%d/%m/%Y, %I:%M %p'"]),
    ],
)
def test_dates_of_several_readings_are_refused_by_name(complaint, form, ways):
    text = complaint(table(clock(form, datetime(2011, 3, 11, 23, 30))))
    assert text.endswith(f'say how: --time-format {" or ".join(ways)}')


# Zones


def started(folder):
    with BagReader(folder / 'bag') as reader:
        return reader.start / 1e9, reader.metadata.custom.get('time_zone')


@pytest.mark.parametrize(
    ('zone', 'name', 'hours'),
    [
        ('Europe/Berlin', 'Europe/Berlin', 1),
        ('UTC', 'UTC', 0),
        ('-05:00', 'UTC-05:00', -5),
        ('Asia/Kolkata', 'Asia/Kolkata', 5.5),
    ],
)
def test_a_local_time_is_of_the_zone_that_is_named(importing, tmp_path, zone, name, hours):
    report = importing(table(clock('%Y-%m-%d %H:%M:%S')), time_zone=zone)
    assert report.remarks[1] == f"times of 't' that name no zone read as {name}"
    assert started(tmp_path) == (1773351000 - 3600 * hours, name)
    facts = recording_facts([tmp_path / 'bag'])
    assert facts['Recorded'] == f'2026-03-12 21:30 {name}'


def test_a_local_time_is_of_the_zone_of_this_computer(importing, tmp_path, monkeypatch):
    monkeypatch.setenv('TZ', 'America/New_York')
    report = importing(table(clock('%Y-%m-%d %H:%M:%S')))
    assert 'as America/New_York, the zone of this computer; --time-zone' in report.remarks[1]
    assert started(tmp_path) == (1773351000 + 4 * 3600, 'America/New_York')


def test_rules_without_a_name_count_too(monkeypatch):
    monkeypatch.setenv('TZ', 'CET-1CEST,M3.5.0,M10.5.0/3')
    zone = zone_of(None)
    assert (zone.name, zone.rules) == ('CET-1CEST,M3.5.0,M10.5.0/3', None)


@pytest.mark.parametrize('form', ['%Y-%m-%dT%H:%M:%S+00:00', '%d.%m.%Y %H:%M:%SZ'])
def test_a_time_that_names_its_zone_keeps_it(importing, tmp_path, form):
    report = importing(table(clock(form)), time_zone='Asia/Kolkata')
    assert len(report.remarks) == 1
    assert started(tmp_path) == (1773351000, None)


def test_numbers_have_no_zone(importing, tmp_path):
    assert importing(table(), time_zone='Asia/Kolkata').remarks == ()
    assert started(tmp_path) == (1.0, None)


def test_a_zone_that_nobody_knows_is_refused():
    for name in ('Berlin', '', '/etc/passwd', '../UTC', '+25:00'):
        with pytest.raises(CsvError, match=r'time_zone: expected a name of the IANA such as'):
            CsvMapping(time_zone=name)


BERLIN = {'time_zone': 'Europe/Berlin'}


def test_the_hour_that_comes_twice_is_passed_twice(importing, tmp_path):
    begin = datetime(2026, 10, 25, 1, 30)
    local = [begin + timedelta(minutes=row) for row in range(COUNT)]
    local = [date if row < 90 else date - timedelta(hours=1) for row, date in enumerate(local)]
    importing(table([date.strftime('%d.%m.%Y %H:%M') for date in local]), **BERLIN)
    np.testing.assert_array_equal(read_run(tmp_path / 'bag').time, SECONDS)
    assert started(tmp_path)[0] == datetime(2026, 10, 24, 23, 30, tzinfo=timezone.utc).timestamp()


@pytest.mark.parametrize(
    ('begin', 'hour'),
    [('25.10.2026 02:30', 1), ('25.10.2026 01:05', 23), ('29.03.2026 03:00', 1)],
)
def test_a_run_at_a_change_of_clocks_stays_even(importing, tmp_path, begin, hour):
    step = 30.0 if hour == 23 else 60.0  # ends within the hour, or begins in it
    begin = datetime.strptime(begin, '%d.%m.%Y %H:%M')
    importing(table(clock('%d.%m.%Y %H:%M:%S', begin, step)), **BERLIN)
    np.testing.assert_array_equal(read_run(tmp_path / 'bag').time, step / 60.0 * SECONDS)
    assert datetime.fromtimestamp(started(tmp_path)[0], timezone.utc).hour == hour


def test_an_hour_that_is_left_out_passes(importing, tmp_path):
    local = [datetime(2026, 3, 29, 1, 30) + timedelta(minutes=row) for row in range(COUNT)]
    local = [date if row < 30 else date + timedelta(hours=1) for row, date in enumerate(local)]
    importing(table([date.strftime('%d.%m.%Y %H:%M') for date in local]), **BERLIN)
    np.testing.assert_array_equal(read_run(tmp_path / 'bag').time, SECONDS)


@pytest.mark.parametrize(
    ('begin', 'line', 'found'),
    [
        (datetime(2026, 10, 25, 1, 30), 92, 'expected times that go back by an hour'),
        (datetime(2026, 3, 29, 1, 30), 32, 'clocks leave out 2026-03-29 02:00:00'),
    ],
)
def test_a_logger_without_summer_time_is_asked_for_its_offset(
    importing, complaint, begin, line, found
):
    text = complaint(table(clock('%d.%m.%Y %H:%M', begin)), **BERLIN)
    assert f"line {line}, column 't': expected" in text
    assert found in text
    assert text.endswith('name it with --time-zone, such as UTC or +01:00')
    assert importing(table(clock('%d.%m.%Y %H:%M', begin)), time_zone='+01:00').interval == 60.0


@pytest.mark.parametrize(
    ('row', 'cell', 'naming'),
    [
        (7, 'gestern', "line 8, column 't': expected a time as %d.%m.%Y %H:%M:%S but found"),
        (1, 'gestern', "line 2, column 't': expected a time but found 'gestern'; name its form"),
        (7, '', "line 8, column 't': expected a time but found none"),
        (1, '12.03.2026', "found '12.03.2026'; it is a date without a time of day"),
    ],
)
def test_a_time_that_is_none(complaint, row, cell, naming):
    times = [
        (BEGIN + timedelta(seconds=second)).strftime('%d.%m.%Y %H:%M:%S') for second in SECONDS
    ]

    def change(rows):
        rows[row][0] = cell

    assert naming in complaint(table(times, change=change))


def test_date_and_time_in_columns_of_their_own_are_joined(importing, complaint):
    split = german('Tag;Zeit;Vorn [°C];Hinten [°C];Z [µm]').replace('2026 ', '2026;')
    assert complaint(split, **GERMAN | {'time': 'Tag'}).endswith('or both as --time DATE+TIME')
    assert "'Tag+Ort' but the file has" in complaint(split, **GERMAN | {'time': 'Tag+Ort'})
    report = importing(split, **GERMAN | {'time': 'Tag+Zeit'})
    assert (report.start, report.samples) == (BEGIN.timestamp(), COUNT)


def test_times_that_stand_still(complaint):
    def twice(rows):
        rows[50][0] = rows[49][0]

    assert 'line 51, ' in (text := complaint(table(change=twice)))
    assert text.endswith('expected a time after 2880 but found 2880; delete one of the two rows')
    assert complaint(table(clock('%H:%M', step=6.0))).endswith(
        '108 rows have the time of the row before: log finer times'
    )


# Numbers and columns


def cell(row, column, text):
    def change(rows):
        rows[row][column] = text

    return change


@pytest.mark.parametrize(
    ('text', 'options', 'naming'),
    [
        (table(change=cell(5, 1, '21,5')), {}, 'with decimal commas import with --decimal ,'),
        (table(change=cell(5, 1, '1.234,5')), {}, 'with decimal commas import with --decimal ,'),
        (table(change=cell(5, 1, '21.5 °C')), {}, 'remove the unit from the cells'),
        (table(change=cell(5, 1, '08:15:00')), {}, 'name the time column with --time'),
        (
            table(change=lambda rows: rows.insert(1, ['s', '°C', '°C', 'µm'])),
            {'rows': (0, 120)},
            "line 2, column 't': expected a time but found 's'; leave out a line of units below "
            'the header with --rows 1:120',
        ),
        (
            table(change=lambda rows: rows.insert(1, ['', '°C', '°C', 'µm'])),
            {'rows': (0, 120)},
            'expected a time but found none; leave out a line of units below the header with',
        ),
        (german(), {**GERMAN, 'decimal': '.'}, "found '21,000'; with decimal commas"),
        (table(change=cell(18, 0, '1.020')), {}, 'remove the signs between thousands'),
        (
            table(change=cell(18, 0, '1.020')).replace('.', ',').replace('1,020', '1.020'),
            {'decimal': ','},
            "line 19, column 't': .* '1.020'; .* remove the points between thousands",
        ),
        (table(separator='|'), {}, r"found one, 't\|a\|b\|ch'; .* with --delimiter '\|'"),
        (
            table(separator=',').replace('.', ','),
            {},
            'line 2: expected 4 columns as in the header but found 7; .* export with ; between',
        ),
        (
            table(head=''),
            {},
            'line 1: expected the names of the columns but found 0, 21.000, 20.500, 0.000; .*'
            '--no-header, which calls the columns c1 to c4',
        ),
        (table(), {'header': False}, 'found t, a, b, ch; .*leave out --no-header'),
        (table(), {'time': 'zeit'}, 'name it with --time$'),
        (table(), {'displacements': ['dz=Z:um']}, 'name it with --displacement$'),
        (table(), {'spindle_speed': 'rpm'}, 'name it with --speed$'),
        (table(), {'temperatures': ['T*']}, 'name one with --temperature$'),
        (table(), {'temperatures': []}, 'name them with --temperature$'),
    ],
)  # fmt: skip
def test_a_refusal_names_what_helps(complaint, text, options, naming):
    assert re.search(naming, complaint(text, **options))


def test_columns_without_a_header_are_numbered(importing, tmp_path):
    report = importing(
        table(head=''),
        header=False, time='c1', temperatures=['c[23]'], displacements=['c4=Z:um'],
    )  # fmt: skip
    assert (report.samples, report.sensors, report.channels) == (COUNT, ('c2', 'c3'), ('c4',))
    np.testing.assert_allclose(read_run(tmp_path / 'bag').temperature[0], [21.0, 20.5])


@pytest.mark.parametrize('head', ['sep=;\r\n', '"sep=;"\r\n', '\r\nSEP=;\r\n'])
def test_what_excel_writes_above_the_header_names_the_separator(importing, head):
    assert importing(head + german(), **GERMAN).samples == COUNT


def test_what_a_spreadsheet_adds_to_a_table_is_passed_over(importing, tmp_path):
    def change(rows):
        for number, row in enumerate(rows[1:]):
            row[1:] = [cell.replace('.', ',') for cell in row[1:]]
            row[3] = '8.024' if number == 3 else f'8.{8 * number:03},0'
        rows.insert(1, ['', '[°C]', '[°C]', '[µm]'])
        rows[:] = [[*row, '', ''] for row in rows]

    text = 'Logger 7;;;;;\r\nNo 4711;rev B;;;;\r\n\r\n' + table(change=change)
    importing(text, 'utf-8-sig', decimal=',', displacements=['ch=Z:nm'])
    run = read_run(tmp_path / 'bag')
    np.testing.assert_allclose(run.temperature[:, 0], FRONT, atol=1e-3)
    np.testing.assert_allclose(
        run.displacement[:, 0], 1e-9 * (8000 + 8 * np.arange(COUNT)), atol=1e-12
    )


@pytest.mark.parametrize(
    ('notes', 'head'),
    [
        ('### printer; K3\r\n# coeff=23.4\r\n\r\n# end\r\n', 't;a;b;ch'),
        ('# made by; a logger; of 4; channels\r\n', 't;a;b;ch'),
        ('# saved by NumPy\r\n', '# t;a;b;ch'),
        ('#t;a;b;ch\r\n', ''),
        ('', '#;t;a;b;ch'),
    ],
)
def test_notes_above_the_table_are_passed_over(importing, tmp_path, notes, head):
    text = table(head=head)
    if head.startswith('#;'):
        text = re.sub(r'^(?=\d)', '1;', text, flags=re.MULTILINE)
    importing(notes + text)
    np.testing.assert_allclose(read_run(tmp_path / 'bag').temperature[:, 0], FRONT, atol=1e-3)


@pytest.mark.parametrize('missing', ['', 'n/a'])
def test_a_reading_that_is_missing_leaves_the_names_in_a_note(importing, missing):
    text = table(head='').replace('20.500', missing, 1)
    assert importing('# t;a;b;ch\r\n' + text).channels == ('ch',)


def test_a_file_of_notes_alone_holds_no_rows(complaint):
    assert 'found one' in complaint('# t;a\n# 1;2\n# 3\n')


def test_commas_are_decimal_signs_where_other_signs_separate(importing, tmp_path):
    plain = table([f'{second:.1f}' for second in SECONDS], head='').replace('.', ',')
    assert plain.count(',') > plain.count(';')
    importing(
        plain,
        header=False, time='c1', temperatures=['c2', 'c3'], displacements=['c4=Z:um'], decimal=',',
    )  # fmt: skip
    np.testing.assert_allclose(read_run(tmp_path / 'bag').temperature[:, 0], FRONT, atol=1e-3)


def test_quoted_numbers_may_have_the_comma_that_separates(importing, tmp_path):
    lines = table().replace('.', ',').splitlines()
    text = '\n'.join(','.join(f'"{part}"' for part in line.split(';')) for line in lines)
    importing(text, decimal=',')
    np.testing.assert_allclose(read_run(tmp_path / 'bag').temperature[:, 0], FRONT, atol=1e-3)


def test_names_may_be_broken_over_lines_and_empty_ones_repeat(importing):
    text = table(head='t;"a\nfront";b;ch').replace('\r\n', ';;\r\n').replace('ch;;', 'ch;;')
    assert importing(text, temperatures=['a front', 'b']).sensors == ('a front', 'b')


# What looks like a mistake


def scaled(column, scale, offset=0.0, digits=3):
    def change(rows):
        for row in rows[1:]:
            row[column] = f'{float(row[column]) * scale + offset:.{digits}f}'

    return change


def both(*changes):
    def change(rows):
        for one in changes:
            one(rows)

    return change


FAHRENHEIT = both(scaled(1, 1.8, 32.0), scaled(2, 1.8, 32.0))


@pytest.mark.parametrize(
    ('text', 'options', 'remedy'),
    [
        (table(change=FAHRENHEIT), {}, {'temperature_unit': 'degF'}),
        (table(), {'temperature_unit': 'degF'}, {'temperature_unit': 'degC'}),
        (table(change=scaled(0, 1 / 60)), {}, {'time_unit': 'min'}),
        (table(change=scaled(0, 1000.0)), {}, {'time_unit': 'ms'}),
        (table(change=scaled(0, 1 / 3600, digits=9)), {}, {'time_unit': 'h'}),
        (table(), {'time_unit': 'ms'}, {'time_unit': 's'}),
        (table(head='t;a (°F);b;ch', change=FAHRENHEIT), {'temperatures': ['a*', 'b']},
         {'temperature_unit': 'degF'}),
        (table(head='t_ms;a;b;ch', change=scaled(0, 1000.0)), {'time': 't_ms'},
         {'time_unit': 'ms'}),
        (table(head='t;a;b;ch [mm]', change=scaled(3, 1.0)), {'displacements': ['ch [mm]=Z:um']},
         None),
    ],
)  # fmt: skip
def test_a_unit_that_is_not_plausible_is_doubted_and_the_option_ends_it(
    importing, tmp_path, text, options, remedy
):
    (doubt,) = importing(text, **options).doubts
    if remedy is None:
        assert doubt.endswith("import with --displacement 'ch [mm]=AXIS:mm'")
        return
    ((option, value),) = remedy.items()
    assert doubt.endswith(f'import with --{option.replace("_", "-")} {value}')
    (tmp_path / 'bag').rename(tmp_path / 'first')
    assert importing(text, **{**options, **remedy}).doubts == ()


def test_temperatures_beyond_every_shop_name_the_option(complaint):
    text = complaint(table(change=both(scaled(1, 1.0, 273.15), scaled(2, 1.0, 273.15))))
    assert text.endswith('in K they would fit: --temperature-unit K')


def test_single_values_are_named_with_line_and_column(importing):
    text = table(change=both(cell(50, 1, '83'), cell(80, 3, '-90'), cell(90, 2, '')))
    doubts = importing(text).doubts
    assert len(doubts) == 2
    assert "line 51, column 'a': 83 degC stands alone between 30." in doubts[0]
    assert "line 81, column 'ch': -90 µm stands alone between 2" in doubts[1]
    assert all(doubt.endswith('empty the cell') for doubt in doubts)


@pytest.mark.parametrize('said', ['-1', '1', '100', '-17.8'])
def test_one_value_held_far_off_is_named_once(importing, said):
    """What some device says without a reading, though a machine may have it."""
    text = table(change=both(*(cell(row, 1, said) for row in range(50, 58))))
    (doubt,) = importing(text).doubts
    assert f"line 51, column 'a': {said} degC in 8 rows stands alone between 30." in doubt
    assert doubt.endswith('empty the cells')


def test_many_single_values_are_counted(importing):
    text = table(change=both(*(cell(row, 1, '83') for row in range(10, 60, 10))))
    assert importing(text).doubts[-1].endswith('2 more values in degC stand alone like these')


@pytest.mark.parametrize(
    ('value', 'rows', 'meaning'),
    [
        ('85.000', (1,), 'what a DS18B20 says at power-on, before it has measured'),
        ('0.000', (1, 2, 3, 4), 'what inputs say without a sensor'),
        ('-127', (30,), 'what drivers of the DS18B20 say of a sensor that does not answer'),
    ],
)
def test_a_value_that_is_no_reading_is_missing_and_said(importing, tmp_path, value, rows, meaning):
    def change(cells):
        for row in rows:
            cells[row][1] = value

    report = importing(table(change=change))
    assert (report.missing, report.doubts) == (len(rows), ())
    (remark,) = report.remarks
    assert remark.endswith(f"column 'a': {float(value):g} is {meaning}; taken as missing")
    read = np.isfinite(read_run(tmp_path / 'bag').temperature)
    assert np.flatnonzero(~read[:, 0]).tolist() == [row - 1 for row in rows]
    assert read[:, 1].all()


def test_a_sensor_that_reads_nothing_else_is_doubted_where_nothing_else_tells(importing):
    def change(cells):
        for row in cells[1:]:
            row[1] = '0'

    (doubt,) = importing(table(change=change), temperatures=['a']).doubts
    assert "column 'a': 0 throughout is what inputs say without a sensor; see whether" in doubt


def test_dates_tell_their_own_unit(importing):
    assert importing(table(clock('%H:%M:%S', step=1.0))).doubts == ()


def test_a_real_recording_raises_no_doubt(data, tmp_path):
    mapping = CsvMapping(
        time='t', temperatures=['t*'], displacements=[f'ch{k}=X:um' for k in range(1, 6)]
    )
    file = data / 'spindle-thermal' / 'spindle_thermal.csv'
    report = import_csv(file, tmp_path / 'spindle', mapping)
    assert report.remarks == report.doubts == ()


@pytest.mark.parametrize(
    ('units', 'doubts'),
    [
        (['', '°C', '°C', 'µm'], []),
        (['[min]', '(°C)', 'K', 'mm'], ['named min', 'named K', 'named mm']),
        (['Zeit', 'Mittel', 'Mittel', 'Spitze'], []),
    ],
)
def test_a_line_of_units_below_the_names_is_no_row(tmp_path, units, doubts):
    file = tmp_path / 'log.csv'
    file.write_text(table(change=lambda rows: rows.insert(1, units)), encoding='utf-8')
    mapping = CsvMapping(time='t', temperatures=['a', 'b'], displacements=['ch=Z:um'])
    report = import_csv(file, tmp_path / 'bag', mapping)
    assert report.samples == COUNT
    said = ', '.join(unit for unit in units if unit)
    assert report.remarks[0] == f'line 2 read as units of the columns: {said}'
    assert len(report.doubts) == len(doubts)
    assert [sum(text in doubt for doubt in report.doubts) for text in doubts] == [1] * len(doubts)
    np.testing.assert_allclose(read_run(tmp_path / 'bag').temperature[:, 0], FRONT, atol=1e-3)


def test_days_of_a_spreadsheet(tmp_path):
    file = tmp_path / 'log.csv'
    file.write_text(table([f'{46353.25 + second / 86400.0:.8f}' for second in SECONDS]))
    mapping = {'time': 't', 'temperatures': ['a', 'b'], 'displacements': ['ch=Z:um']}
    doubts = import_csv(file, tmp_path / 'seconds', CsvMapping(**mapping)).doubts
    assert any('import with --time-unit d' in d for d in doubts)
    report = import_csv(file, tmp_path / 'days', CsvMapping(**mapping, time_unit='d'))
    assert report.interval == pytest.approx(60.0, abs=1e-3)
    assert report.doubts == ()


def test_a_sensor_with_a_rate_of_its_own_says_nothing_of_the_pace(tmp_path):
    """A heated bed and the probe that sees it warm in a minute, the frame does not."""
    time = np.arange(0, 3600, 10)
    bed = 22 + np.clip((time - 300) * 0.6, 0, 63)
    frame = 22 + 3 * (1 - np.exp(-time / 900))
    rows = zip(time, frame, bed, 0.3 * (bed - 22), strict=True)
    file = tmp_path / 'bed.csv'
    file.write_text('t,a,bed,ch\n' + ''.join('{},{:.2f},{:.2f},{:.2f}\n'.format(*r) for r in rows))
    mapping = {'time': 't', 'temperatures': ['a', 'bed'], 'displacements': ['ch=Z:um']}
    assert any(
        '2 of 3 sensors' in doubt
        for doubt in import_csv(file, tmp_path / 'usual', CsvMapping(**mapping)).doubts
    )
    own = CsvMapping(**mapping, sensor_limits=['b*:rate_max:0.7'])
    assert import_csv(file, tmp_path / 'own', own).doubts == ()


@pytest.mark.parametrize(
    ('first', 'step', 'likely'),
    [
        (46000.0, 1.0 / 1440.0, 'days of a spreadsheet'),
        (1795820676e3, 60e3, 'ms or us since 1970'),
        (1795820676e6, 60e6, 'ms or us since 1970'),
        (-600.0, 60.0, ''),
        (1795820676.0, 60.0, ''),
    ],
)
def test_times_of_a_table_that_is_played_are_seconds(tmp_path, first, step, likely):
    rows = [f'{first + step * row!r},{20.0 + 0.1 * row}' for row in range(20)]
    (tmp_path / 'day.csv').write_text('\n'.join(['t,T1', *rows]))
    if likely:
        with pytest.raises(BagError, match=f"column 't': expected seconds .* look like {likely}"):
            read_sensor_table(tmp_path / 'day.csv', 't')
    else:
        assert read_sensor_table(tmp_path / 'day.csv', 't')[1][0] == first

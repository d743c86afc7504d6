# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Importing CSV recordings: refusals first, then what arrives in the bag."""

import dataclasses

import numpy as np
import pytest

from fuzzycnc_ros.bags.csv_import import import_csv, read_csv
from fuzzycnc_ros.bags.csv_mapping import CsvMapping, parse_channel
from fuzzycnc_ros.bags.errors import BagExistsError, CsvError, RunError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import read_run

SPINDLE = CsvMapping(
    time='t',
    temperatures=['t*'],
    displacements=['ch1=X:um', 'ch2=X:um', 'ch3=Y:um', 'ch4=Y:um', 'ch5=Z:um'],
    spindle_speed='rpm',
    machine='mill',
)
MAPPING = CsvMapping(time='t', temperatures=['a', 'b'], displacements=['ch=Z:um'], machine='mill')


def rows(count=20):
    """Return a small recording as rows of text: time, two temperatures, one displacement."""
    return [['t', 'a', 'b', 'ch']] + [
        [f'{k * 15}', f'{20 + k * 0.2:.3f}', f'{21 + k * 0.1:.3f}', f'{k * 0.5:.3f}']
        for k in range(count)
    ]


@pytest.fixture
def importing(tmp_path):
    """Write rows into a file and import them."""

    def run(cells, mapping=MAPPING, delimiter=',', encoding='utf-8'):
        file = tmp_path / 'recording.csv'
        text = cells if isinstance(cells, str) else '\n'.join(delimiter.join(r) for r in cells)
        file.write_bytes(text.encode(encoding))
        report = import_csv(file, tmp_path / 'bag', mapping)
        if report.channels:
            assert_same_run(read_csv(file, mapping), report.path)
        return report

    return run


def assert_same_run(recording, bag):
    """Hold the run of a CSV file to the one that a bag of it gives, or to its refusal."""
    try:
        expected = read_run(bag)
    except RunError:
        with pytest.raises(RunError):
            recording.run()
        return
    found = recording.run()
    for field in dataclasses.fields(found):
        if field.name != 'name':
            np.testing.assert_equal(getattr(found, field.name), getattr(expected, field.name))


def test_a_run_needs_displacements(tmp_path):
    file = tmp_path / 'recording.csv'
    file.write_text('\n'.join(','.join(row[:3]) for row in rows()))
    mapping = CsvMapping(time='t', temperatures=['a', 'b'])
    with pytest.raises(CsvError, match=r'column of displacements but none is mapped'):
        read_csv(file, mapping).run()


def edited(place, text, count=20):
    cells = rows(count)
    cells[place[0]][place[1]] = text
    return cells


@pytest.mark.parametrize(
    ('cells', 'complaint'),
    [
        ('', r'the file is empty'),
        ('\n\n  \n', r'the file is empty'),
        ('t,a,b,ch\n', r'at least 8 rows but found 0'),
        (rows(7), r'at least 8 rows but found 7'),
        (edited((0, 1), 'x'), r"temperature column 'a' but the file has t, x, b, ch"),
        (edited((0, 0), 'zeit'), r"the column 't' but the file has zeit, a, b, ch"),
        (edited((0, 3), 'y'), r"the column 'ch' but the file has t, a, b, y"),
        (edited((0, 2), 'a'), r"line 1: expected each column once but found 'a'"),
        (edited((5, 1), 'warm'), r"line 6, column 'a': expected a number but found 'warm'"),
        (edited((5, 3), '1;5'), r"line 6, column 'ch': expected a number but found '1;5'"),
        (edited((5, 1), 'inf'), r"line 6, column 'a': expected a finite number"),
        (edited((5, 0), ''), r"line 6, column 't': expected a time but found none"),
        (edited((5, 0), '45'), r"line 6, column 't': expected a time after 45 but found 45"),
        (edited((5, 0), '20'), r"line 6, column 't': expected a time after 45 but found 20"),
        (edited((20, 0), '300'), r'line 21, .*a step of 30 s; import with --resample 15'),
        (edited((3, 0), '35'), r'line 4, .*even steps of 15 s but found a step of 20'),
        (edited((5, 1), '390'), r"line 6, column 'a': expected -20 to 120 degC but found 390"),
        (edited((5, 3), '700'), r"line 6, column 'ch': .*up to 500 µm but found 700 µm; in nm"),
        ([*rows(), ['1', '2']], r'line 22: expected 4 columns as in the header but found 2'),
        ('t,a,b,ch\n"1' + '0' * 200_000 + '"', r'line 2: expected CSV but found field larger'),
    ],
)
def test_bad_file_is_one_clear_line(importing, tmp_path, cells, complaint):
    with pytest.raises(CsvError, match=complaint) as caught:
        importing(cells)
    assert '\n' not in str(caught.value)
    assert 'recording.csv' in str(caught.value)
    assert not (tmp_path / 'bag').exists()


def test_file_that_cannot_be_read(importing, tmp_path):
    with pytest.raises(CsvError, match=r'none.csv: expected a file but nothing is there'):
        import_csv(tmp_path / 'none.csv', tmp_path / 'bag', MAPPING)
    with pytest.raises(CsvError, match=r"line 2: .* byte 12 is 0xb0, .*'°'; .*--encoding cp1252"):
        importing('t,a,b,ch\n1,2\xb0,3', encoding='latin-1')


@pytest.mark.parametrize(
    ('options', 'complaint'),
    [
        ({'time_unit': 'days'}, r'time_unit: expected s, ms, min, h, d, iso8601 but found'),
        ({'temperature_unit': 'F'}, r'temperature_unit: expected degC, K, degF'),
        ({'spindle_speed_unit': 'Hz'}, r'spindle_speed_unit: expected rpm'),
        ({'displacements': ['ch1']}, r'COLUMN=AXIS:UNIT such as ch1=X:um'),
        ({'displacements': ['ch1=Q:um']}, r"an axis of X, .* but found 'Q'"),
        ({'displacements': ['ch1=X:inch']}, r"unit of column 'ch1': expected um, mm, m"),
        ({'decimal': '·'}, r'decimal: expected'),
        ({'delimiter': ',,'}, r'delimiter: expected one character'),
        ({'rows': (5, 2)}, r'rows: expected 0 <= first <= last'),
        ({'resample': 0.0}, r'resample: expected an interval above 0'),
        ({'epoch': -1.0}, r'epoch: expected 0 to'),
        ({'machine': 'a b'}, r'machine: expected letters'),
        ({'drives': {'load': 'x'}}, r"drives: expected axis_speed/X, .* but found 'load'"),
    ],
)
def test_bad_mapping_is_refused(options, complaint):
    with pytest.raises(CsvError, match=complaint):
        CsvMapping(**options)


@pytest.mark.parametrize(
    ('options', 'complaint'),
    [
        ({'temperatures': []}, r'at least one temperature column but none is mapped'),
        ({'temperatures': ['x*']}, r"temperature column 'x\*' but the file has"),
        ({'temperatures': ['re:[']}, r'expected a regular expression after re:'),
        ({'rename': {'a': 'same', 'b': 'same'}}, r"name once but found 'same' more than once"),
        ({'rows': (3, 500)}, r'expected rows 3 to 500 but the file has rows 0 to 19'),
        ({'rows': (3, 7)}, r'at least 8 rows but found 5'),
        ({'spindle_speed': 'rpm'}, r"the column 'rpm' but the file has"),
        ({'resample': 100.0}, r'--resample 100 leaves'),
        (
            {'decimal': ','},
            r"found '20.000'; where the decimal sign is a comma, remove the points",
        ),
    ],
)
def test_mapping_that_does_not_fit_the_file(importing, options, complaint):
    mapping = CsvMapping(
        **{'time': 't', 'temperatures': ['a', 'b'], 'displacements': ['ch=Z:um'], **options}
    )
    with pytest.raises(CsvError, match=complaint):
        importing(rows(), mapping)


def test_existing_bag_is_not_touched(importing, tmp_path):
    importing(rows())
    before = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    with pytest.raises(BagExistsError, match=r'choose another name'):
        importing(rows(30))
    assert (tmp_path / 'bag' / 'bag_0.mcap').read_bytes() == before


# Units that were mixed up


def warming(unit_scale):
    """Return a machine that warms by 6 K and drifts by 45 um, written in some unit."""
    return [['t', 'a', 'b', 'ch']] + [
        [f'{k * 15}', f'{20 + k * 0.1:.3f}', '21', f'{k * 0.75e-6 / unit_scale:.12g}']
        for k in range(61)
    ]


@pytest.mark.parametrize(
    ('file_unit', 'mapped', 'complaint'),
    [
        (1e-6, 'mm', r'found \d+ µm; in um the largest would be 45 µm'),
        (1e-6, 'm', r'in um the largest would be 45 µm'),
        (1e-3, 'um', r'they are not in um: check the unit \(in mm the largest would be 45 µm\)'),
        (1e-9, 'um', r'in nm the largest would be 45 µm'),
    ],
)
def test_length_unit_mixed_up(importing, file_unit, mapped, complaint):
    mapping = CsvMapping(time='t', temperatures=['a', 'b'], displacements=[f'ch=Z:{mapped}'])
    with pytest.raises(CsvError, match=complaint):
        importing(warming(file_unit), mapping)


@pytest.mark.parametrize(('scale', 'offset', 'fits'), [(1.0, 273.15, 'K'), (9 / 5, 32.0, 'degF')])
def test_temperature_unit_mixed_up(importing, scale, offset, fits):
    cells = rows()
    for row in cells[1:]:
        row[1:3] = [f'{(float(text) + 50) * scale + offset:.4f}' for text in row[1:3]]
    with pytest.raises(CsvError, match=f'in {fits} they would fit'):
        importing(cells)


def test_probe_with_an_offset_is_zeroed_on_request(importing, tmp_path):
    cells = rows()
    for row in cells[1:]:
        row[3] = f'{float(row[3]) + 2000.0:.3f}'
    with pytest.raises(CsvError, match=r'where the probe has an offset, import with --zero'):
        importing(cells)
    importing(
        cells,
        CsvMapping(time='t', temperatures=['a'], displacements=['ch=Z:um'], zero=True),
    )
    run = read_run(tmp_path / 'bag')
    # Zero is the mean over the reference: three minutes at 15 s are 12 rows.
    np.testing.assert_allclose(run.displacement[:, 0], (np.arange(20) - 5.5) * 0.5e-6, atol=1e-15)


# What arrives


def test_columns_arrive_in_si_units(importing, tmp_path):
    cells = [['min', 'speed', 'front [K]', 'rear', 'probe 1', 'note']]
    cells += [
        [f'{k / 60}', '600', f'{300 + k}', f'{301 + k}', f'{k / 1000}', f'n{k}'] for k in range(10)
    ]
    mapping = CsvMapping(
        time='min',
        time_unit='min',
        temperatures=['re:front.*|rear'],
        temperature_unit='K',
        displacements=['probe 1=-X:mm'],
        spindle_speed='speed',
        rename={'front [K]': 'front', 'probe 1': 'nose'},
        machine='lathe_2',
        epoch=100.0,
    )
    report = importing(cells, mapping, delimiter=';')
    assert (report.samples, report.start) == (10, 100.0)
    assert (report.sensors, report.channels) == (('front', 'rear'), ('nose',))
    assert report.interval == pytest.approx(1.0)
    with BagReader(tmp_path / 'bag') as reader:
        assert set(reader.connections) == {
            '/lathe_2/temperatures',
            '/lathe_2/displacement',
            '/lathe_2/machine_state',
            '/lathe_2/thermal_reference',
        }
        found = {topic: list(reader.messages([topic])) for topic in reader.connections}
    sample = found['/lathe_2/temperatures'][3]
    assert sample.log_time == 103 * 10**9
    assert (sample.message.header.stamp.sec, sample.message.header.frame_id) == (
        103,
        'lathe_2/machine',
    )
    np.testing.assert_allclose(sample.message.temperature, [29.85, 30.85])
    moved = found['/lathe_2/displacement'][3].message
    assert (moved.header.frame_id, moved.axis) == ('lathe_2/workpiece', ['X'])
    np.testing.assert_allclose(moved.displacement, [-3e-6])
    assert np.isnan(moved.standard_deviation).all()
    assert found['/lathe_2/machine_state'][0].message.spindle_speed == pytest.approx(20 * np.pi)
    assert found['/lathe_2/machine_state'][0].message.cold_since.sec == 100


def test_reference_is_the_mean_of_the_first_three_minutes(importing, tmp_path):
    importing(rows())
    with BagReader(tmp_path / 'bag') as reader:
        (latched,) = reader.messages(['/mill/thermal_reference'])
        assert reader.connections['/mill/thermal_reference'].profiles[0]['durability'] == (
            'transient_local'
        )
    message = latched.message
    assert (message.set_by, message.samples, message.sensor) == ('recording', 12, ['a', 'b'])
    np.testing.assert_allclose(message.temperature, [20 + 5.5 * 0.2, 21 + 5.5 * 0.1])
    assert latched.log_time == (1 + 11 * 15) * 10**9
    run = read_run(tmp_path / 'bag')
    # `ThermalRun` at one-minute samples means the same reference.
    longer = rows(40)
    importing_again = tmp_path / 'again.csv'
    importing_again.write_text('\n'.join(','.join(row) for row in longer))
    import_csv(importing_again, tmp_path / 'longer', MAPPING)
    minute = read_run(tmp_path / 'longer').resample(60.0)
    np.testing.assert_allclose(minute.reference(), message.temperature, rtol=1e-12)
    assert run.time[0] == 0.0


def test_slow_recording_takes_three_rows_as_reference(importing, tmp_path):
    cells = rows()
    for k, row in enumerate(cells[1:]):
        row[0] = f'{k * 600}'
    importing(cells)
    with BagReader(tmp_path / 'bag') as reader:
        (latched,) = reader.messages(['/mill/thermal_reference'])
    assert latched.message.samples == 3


def test_missing_readings_are_marked(importing, tmp_path):
    cells = rows()
    cells[4][1], cells[5][2], cells[6][3] = '', 'NaN', 'n/a'
    report = importing(cells)
    assert report.missing == 2
    with BagReader(tmp_path / 'bag') as reader:
        status = [list(m.message.status) for m in reader.messages(['/mill/temperatures'])]
    assert status[3] == [1, 0]
    assert status[4] == [0, 1]
    run = read_run(tmp_path / 'bag')
    assert np.isnan(run.displacement[5, 0])
    assert np.isnan(run.temperature).sum() == 2


def test_decimal_comma(importing, tmp_path):
    cells = [[cell.replace('.', ',') for cell in row] for row in rows()]
    mapping = CsvMapping(
        time='t', temperatures=['a', 'b'], displacements=['ch=Z:um'], decimal=',', machine='mill'
    )
    importing(cells, mapping, delimiter=';')
    np.testing.assert_allclose(read_run(tmp_path / 'bag').temperature[3], [20.6, 21.3])


def test_dates(importing, tmp_path):
    cells = rows()
    for k, row in enumerate(cells[1:]):
        row[0] = f'2024-05-01T08:{k:02d}:00.250Z'
    mapping = CsvMapping(
        time='t', time_unit='iso8601', temperatures=['a'], displacements=['ch=Z:um']
    )
    report = importing(cells, mapping)
    assert report.interval == 60.0
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.start == 1714550400 * 10**9 + 250_000_000
        assert reader.stop - reader.start == 19 * 60 * 10**9
    cells[3][0] = '1. Mai'
    with pytest.raises(CsvError, match=r'line 4.*a date such as'):
        importing(cells, mapping)


def test_uneven_times_are_resampled_on_request(importing, tmp_path):
    cells = [['t', 'a', 'b', 'ch']]
    times = [k * 15 + (3 if k % 3 == 1 else 0) for k in range(60)]
    cells += [[f'{t}', f'{20 + t * 0.01}', '21', f'{t * 0.1}'] for t in times]
    options = {'time': 't', 'temperatures': ['a', 'b'], 'displacements': ['ch=Z:um']}
    with pytest.raises(CsvError, match=r'even steps'):
        importing(cells, CsvMapping(**options))
    report = importing(cells, CsvMapping(**options, resample=60.0))
    assert report.interval == pytest.approx(60.0)
    run = read_run(tmp_path / 'bag')
    # Samples are the mean of the readings up to their stamp: 0, 15, 30 and 45 s give 45 s.
    stamp = 45.0 + 60.0 * np.arange(len(run.time))
    np.testing.assert_allclose(run.temperature[:, 0], 20 + (stamp - 22.5) * 0.01, rtol=1e-9)
    np.testing.assert_allclose(run.displacement[:, 0], (stamp - 22.5) * 0.1e-6, rtol=1e-9)


def test_resampling_invents_nothing_in_gaps(importing, tmp_path):
    cells = rows(60)
    del cells[21:41]
    mapping = CsvMapping(
        time='t', temperatures=['a', 'b'], displacements=['ch=Z:um'], resample=15.0
    )
    report = importing(cells, mapping)
    assert report.samples == 60
    assert report.missing == 2 * 20
    run = read_run(tmp_path / 'bag')
    assert np.flatnonzero(np.isnan(run.temperature[:, 0])).tolist() == list(range(20, 40))
    np.testing.assert_allclose(run.temperature[40:, 0], 20 + np.arange(40, 60) * 0.2, rtol=1e-9)


def bursts(count=60):
    """Return three readings 4 s apart, then none for 53 s, again and again."""
    times = [61 * burst + second for burst in range(count) for second in (0, 4, 8)]
    return [
        ['t', 'a', 'b', 'ch'],
        *([f'{t}', f'{20 + t / 1e3}', '21', f'{t / 1e2}'] for t in times),
    ]


def test_readings_in_bursts_become_samples_a_minute(importing, tmp_path):
    options = {'time': 't', 'temperatures': ['a', 'b'], 'displacements': ['ch=Z:um']}
    with pytest.raises(CsvError, match=r'found a step of 53 s; import with --resample 61$'):
        importing(bursts(), CsvMapping(**options))
    report = importing(bursts(), CsvMapping(**options, resample=60.0))
    assert (report.samples, report.missing, report.doubts) == (60, 0, ())
    run = read_run(tmp_path / 'bag')
    np.testing.assert_allclose(
        run.temperature[:, 0], 20 + (60 * np.arange(60) + 28) / 1e3, atol=3e-3
    )
    np.testing.assert_allclose(run.displacement[:, 0] * 1e8, 60 * np.arange(60) + 28, atol=3)


def test_an_interval_that_keeps_bursts_and_loses_minutes_is_doubted(importing):
    mapping = CsvMapping(time='t', temperatures=['a', 'b'], displacements=['ch=Z:um'], resample=4)
    (doubt,) = importing(bursts(), mapping).doubts
    assert '723 of 902 samples are without a reading' in doubt
    assert doubt.endswith('as readings come every 61 s; import with --resample 61')


def test_time_that_no_recording_lasts(importing):
    cells = rows()
    for k, row in enumerate(cells[1:]):
        row[0] = f'{k}e9'
    with pytest.raises(CsvError, match=r"between 1970 and 2038 but .* check the unit of 't'"):
        importing(cells)


def test_gap_that_would_fill_the_memory_is_refused(importing):
    mapping = CsvMapping(time='t', temperatures=['a'], resample=15.0)
    with pytest.raises(CsvError, match=r'would make .* import the parts one by one with --rows'):
        importing(edited((20, 0), '2e9'), mapping)


def test_channel_texts():
    assert parse_channel('probe=1=-Z:mm').column == 'probe=1'
    assert parse_channel('a=+X:um').scale == pytest.approx(1e-6)
    assert parse_channel('a=-X:nm').scale == pytest.approx(-1e-9)


# The real recording


def test_spindle_recording_arrives_whole(data, tmp_path):
    file = data / 'spindle-thermal' / 'spindle_thermal.csv'
    report = import_csv(file, tmp_path / 'spindle', SPINDLE)
    assert (report.samples, report.interval, report.missing) == (7711, 15.0, 0)
    assert report.sensors == tuple(f't{k}' for k in range(1, 17))
    run = read_run(tmp_path / 'spindle')
    raw = np.genfromtxt(file, delimiter=',', names=True)
    for k, name in enumerate(run.sensor):
        np.testing.assert_array_equal(run.temperature[:, k], raw[name])
    for k, name in enumerate(run.channel):
        np.testing.assert_allclose(run.displacement[:, k], raw[name] * 1e-6, rtol=1e-15)
    assert run.axis == ('X', 'X', 'Y', 'Y', 'Z')
    with BagReader(tmp_path / 'spindle') as reader:
        speed = [m.message.spindle_speed for m in reader.messages(['/mill/machine_state'])]
        assert reader.message_count == 3 * 7711 + 1
    np.testing.assert_allclose(np.array(speed) * 30 / np.pi, raw['rpm'], rtol=1e-12)


def test_rows_of_the_spindle_recording(data, tmp_path):
    file = data / 'spindle-thermal' / 'spindle_thermal.csv'
    mapping = CsvMapping(
        time='t', temperatures=['t1', 't9'], displacements=['ch5=Z:um'], rows=(5791, 7710)
    )
    assert import_csv(file, tmp_path / 'cycle', mapping).samples == 1920
    raw = np.genfromtxt(file, delimiter=',', names=True)
    run = read_run(tmp_path / 'cycle')
    np.testing.assert_array_equal(run.temperature[:, 1], raw['t9'][5791:])
    np.testing.assert_allclose(run.time, raw['t'][5791:] - raw['t'][5791])


def along_x(time):
    """Return what an axis is off at -400, -200 and 0 mm after a time [s], in um."""
    return [-0.4 * time, -0.1 * time, 0.05 * time]


def assert_line(run, rows):
    """Hold a run to offset, slope and bend of `along_x`."""
    assert run.channel == ('X', 'X slope -400..0 mm', 'X bend -400..0 mm')
    time = run.time[rows]
    low, middle, high = 1e-6 * np.array(along_x(time))
    expected = [(low + 2 * middle + high) / 4, (high - low) / 2, middle - (low + high) / 2]
    np.testing.assert_allclose(run.displacement[rows], np.transpose(expected), atol=1e-12)


def test_one_column_for_each_position(importing):
    cells = [['t', 'a', 'far', 'mid', 'near']]
    cells += [[str(30 * k), '20.0', *map(str, along_x(30 * k))] for k in range(20)]
    mapping = CsvMapping(
        time='t',
        temperatures=['a'],
        displacements=['far=X:um@-400mm', 'mid=X:um@-0.2m', 'near=X:um@0mm'],
    )
    assert_line(read_run(importing(cells, mapping).path), slice(0, 20))


def test_a_column_that_tells_the_position(importing):
    cells = [['t', 'a', 'err', 'pos']]
    for k in range(30):
        place = k % 3
        cells.append(
            [str(30 * k), '20.0', str(along_x(30 * k)[place]), str((-400, -200, 0)[place])]
        )
    mapping = CsvMapping(time='t', temperatures=['a'], displacements=['err=X:um@pos:mm'])
    bag = importing(cells, mapping).path
    assert_line(read_run(bag), slice(2, 28))
    places = read_run(bag, places=True)
    assert places.channel == ('X@-400mm', 'X@-200mm', 'X@0mm')
    assert np.isfinite(places.displacement).sum(axis=0).tolist() == [10, 10, 10]


@pytest.mark.parametrize('text', ['ch=X:um@-400', 'ch=X:um@-400inch', 'ch=X:um@4.0.0mm'])
def test_a_position_needs_a_number_and_a_unit(text):
    with pytest.raises(CsvError, match=r'displacement|position of column'):
        CsvMapping(time='t', temperatures=['a'], displacements=[text])


def test_a_column_of_positions_without_places_is_refused(importing):
    cells = [['t', 'a', 'err', 'pos']]
    cells += [[str(30 * k), '20.0', '1', str(7 * k)] for k in range(30)]
    mapping = CsvMapping(time='t', temperatures=['a'], displacements=['err=X:um@pos:mm'])
    with pytest.raises(CsvError, match=r"column 'pos': expected positions of 1 to 20 places"):
        importing(cells, mapping)


def test_what_else_a_control_told_comes_back_as_it_was(importing, tmp_path):
    head = ['t', 'a', 'ch', 'moved', 'load', 'cool']
    load = [f'{0.1 * (row % 5):.1f}' for row in range(20)]
    moved = ['' if row == 9 else f'{0.02 * (row % 4):.2f}' for row in range(20)]
    cool = [str(row // 10) for row in range(20)]
    table = [[str(15 * row), '20.5', '0', moved[row], load[row], cool[row]] for row in range(20)]
    mapping = CsvMapping(
        time='t',
        temperatures=['a'],
        displacements=['ch=X:um'],
        drives={'axis_square_speed/X': 'moved', 'spindle_load': 'load', 'coolant': 'cool'},
    )
    importing([head, *table], mapping)
    run = read_run(tmp_path / 'bag')
    assert run.spindle_speed is None
    assert sorted(run.drives) == ['axis_square_speed/X', 'coolant', 'spindle_load']
    np.testing.assert_allclose(run.drives['spindle_load'][1:], np.array(load, float)[1:])
    np.testing.assert_allclose(run.drives['coolant'][1:], np.array(cool, float)[1:])
    known = [row for row in range(1, 20) if row not in (9, 10)]
    wanted = [float(moved[row]) for row in known]
    np.testing.assert_allclose(run.drives['axis_square_speed/X'][known], wanted, atol=1e-12)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc report thermal`: what it prints and writes, from exact bags and a real recording."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from thermal_test_bags import write_test

from fuzzycnc_ros.cli.main import run
from fuzzycnc_ros.cli.reports import thermal
from fuzzycnc_ros.studies.page.drawing import plot_style
from fuzzycnc_ros.studies.page.html import Page, Section
from fuzzycnc_ros.studies.page.pdf import HEIGHT, LEFT, WIDTH, render_pdf, sheets
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.requirement import require
from fuzzycnc_ros.studies.thermal_test.page import thermal_test_page
from fuzzycnc_ros.studies.thermal_test.phases import find_phases
from fuzzycnc_ros.studies.thermal_test.recording import read_test
from fuzzycnc_ros.studies.thermal_test.report import judge_test
from fuzzycnc_ros.studies.thermal_test.set_up import TestSetUp

FILE = """machine: VMC 850, no. 17
operator: anna
history: 12 h switched off
ambient: ambient
instrument:
  name: five eddy-current probes
  uncertainty: 0.6um
  resolution: 0.01um
probes:
  X1: {channel: X1, place: 130 mm above the table}
  X2: {channel: X2}
  Y1: {channel: Y1}
  Y2: {channel: Y2}
  Z: {channel: Z}
distance:
  X: 100mm
  Y: 80mm
"""


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return write_test(tmp_path_factory.mktemp('bags') / 'nest', speed=True)


def test_the_report_is_written_as_page_pdf_and_figures(fuzzycnc, bag):
    Path('nest.yaml').write_text(FILE)
    shown = fuzzycnc(
        'report', 'thermal', bag, '--file', 'nest.yaml', '--operator', 'ben',
        '--out', 'r.html', '--pdf', 'r.pdf', '--json', 'r.json',
    )  # fmt: skip
    assert shown.code == 0, shown
    for text in ('1 environment: environment, 2.00 h', 'Expanded, k = 2', 'r.pdf: the report'):
        assert text in shown.out
    page = Path('r.html').read_text()
    for text in (
        'Thermal test in the style of ISO 230-3 and ISO 10791-10',
        'It is no statement of conformity',
        'VMC 850, no. 17',
        '12 h switched off',
        'ben',
        '130 mm above the table',
        '2026-03-02 09:14 UTC',
        'U = 0.6 µm, k = 2',
        'ambient: 20.0 °C at the start, 20.0 to 22.0 °C',
        'on in 100 % of the time, at most 27.',
        'without, measured',
        'with, computed',
        '"spans":[{"low":0.0,"high":2.0,"colour":"--another","name":"1 environment"}',
    ):
        assert text in page, text
    figures = json.loads(Path('r.json').read_text())
    spindle = figures['phases'][1]
    assert spindle['without']['B']['change'] == pytest.approx(50.0, rel=0.01)
    assert spindle['with']['Z']['whole'] == pytest.approx(2.945, rel=0.01)
    assert spindle['without']['combined']['rise_time_s'] is None
    assert figures['facts']['Operator'] == 'ben'
    assert Path('r.pdf').read_bytes().startswith(b'%PDF-')


def test_the_same_page_gives_the_same_pdf():
    column = Column('Name', numeric=False)
    table = Table('Names', (column, Column('Number')), (('a', '1'),) * 80)
    page = Page('Title', 'Summary', [Section('Part', tables=[table])], notes=['Note.'])
    first = render_pdf(page)
    assert render_pdf(page) == first
    assert first.count(b'/Type /Page ') == 2


def test_a_table_that_fits_on_a_sheet_is_not_split_and_a_longer_one_has_its_head_on_each():
    columns = (Column('Term', numeric=False), Column('X'))
    short = Table('Short', columns, tuple((f'short {n}', '1') for n in range(60)))
    long = Table('Long', columns, tuple((f'long {n}', '1') for n in range(120)))
    with plot_style():
        found = sheets(Page('Title', '', [Section('Part', tables=[short, short, long])]))
    texts = [[text.get_text() for text in sheet.texts] for sheet in found]
    assert [sum(text.startswith('short') for text in sheet) for sheet in texts[:2]] == [60, 60]
    assert sum(text.startswith('long') for sheet in texts for text in sheet) == 120
    assert all(sum(text.startswith('Term') for text in sheet) >= 1 for sheet in texts)


def test_what_nobody_told_is_not_stated(fuzzycnc, tmp_path):
    bag = write_test(tmp_path / 'bare', marks=(), temperatures=False, compensation=False)
    shown = fuzzycnc('report', 'thermal', bag, '--json', 'r.json')
    assert shown.code == 0, shown
    assert 'The bag holds no applied offsets' in shown.out
    assert 'Incomplete: Instrument, Resolution, Environment' in shown.out
    figures = json.loads(Path('r.json').read_text())
    for name in ('Operator', 'Instrument', 'History before the test', 'Ambient temperature'):
        assert figures['facts'][name] == 'not stated'
    assert figures['phases'][0]['name'] == 'whole recording'
    assert figures['phases'][0]['with'] == {}


def test_the_pdf_holds_all_words_of_the_page_within_its_margins(bag):
    recording = read_test(bag)
    set_up = TestSetUp(distance={'X': 0.1, 'Y': 0.1}, history='a\x1b[2J ' + 'long ' * 60)
    page = thermal_test_page(judge_test(recording, set_up, find_phases(recording)))
    backend = require('matplotlib.backends.backend_agg')
    texts = []
    with plot_style():
        for sheet in sheets(page):
            sheet.set_dpi(300)  # text has the widths that it has on paper
            renderer = backend.FigureCanvasAgg(sheet).get_renderer()
            sheet.draw_without_rendering()
            for item in sheet.findobj(require('matplotlib.text').Text):
                if not (item.get_text() and item.get_visible()):
                    continue
                texts.append(item.get_text())
                box = item.get_window_extent(renderer).transformed(
                    sheet.dpi_scale_trans.inverted()
                )
                assert box.x0 > LEFT - 0.1, item
                assert box.x1 < WIDTH - LEFT + 0.1, item
                assert 0.3 < box.y0 < box.y1 < HEIGHT - 0.3, item
    words = set(' '.join(texts).split())
    for section in page.sections:
        for part in (section.heading, *section.remarks, *(item.text for item in section.judged)):
            assert words >= set(part.split())
        for table in section.tables:
            for row in table.rows:
                assert words >= {word for cell in row for word in cell.split()}, table.title
    assert 'a\\x1b[2J' in words
    assert any(re.fullmatch(r'1 of \d', text) for text in texts)


@pytest.mark.parametrize(
    ('change', 'named'),
    [
        (('  X: 100mm', '  Z: 100mm'), ["distance: expected axes X and Y but found 'Z'"]),
        (('  X: 100mm', '  X: 100'), ['line 16', 'X: expected a unit, one of mm, um']),
        (('  Z: {channel: Z}', '  Q: {channel: Z}'), ["Y2, Z, X or Y but found 'Q'"]),
        (('operator:', 'operater:'), ["unknown field 'operater'; did you mean operator?"]),
        (('  X2: {channel: X2}', '  X2: {channel: ch2}'), ["probe X2: expected a channel of X1"]),
    ],
)  # fmt: skip
def test_files_that_are_wrong_are_refused(change, named, refused, bag):
    Path('nest.yaml').write_text(FILE.replace(*change))
    refused('report', 'thermal', bag, '--file', 'nest.yaml', naming=named)


@pytest.mark.parametrize(
    ('options', 'named'),
    [
        (['--phase', 'spindle'], ['--phase: expected NAME=START:END']),
        (['--phase', 'a=1h:soon'], ["expected a time in s, ms, min, h or d but found 'soon'"]),
        (['--phase', 'a=9h:'], ['phase a: expected a start between 0 and 28800 s']),
        (['--kind', 'cooling=hot'], ['--kind cooling: expected one of environment']),
        (['--kind', 'noon=axis'], ['--kind: expected a phase of cooling', "'noon'"]),
        (['--probe', 'Q=X1'], ["--probe: expected one of X1, X2, Y1, Y2, Z, X, Y but found 'Q'"]),
        (['--probe', 'X1'], ['--probe: expected X1=ch1']),
        (['--distance', 'X=3'], ['--distance: expected a unit']),
        (['--distance', 'Z=3mm'], ["--distance: expected axis X or Y but found 'Z'"]),
        (['--distance', 'X=0mm'], ['--distance: expected a number above 0']),
        (['--uncertainty', 'small'], ['--uncertainty: expected a number']),
        (['--machine', 'lathe'], ['lathe/displacement']),
        (['--out', 'no/r.html'], ['no']),
    ],
)
def test_options_that_are_wrong_are_refused(options, named, refused, bag):
    refused('report', 'thermal', bag, *options, naming=named)


def test_a_distance_has_the_sign_of_its_side():
    assert thermal._distances(['X=-100mm', 'Y = 80mm']) == {'X': -0.1, 'Y': 0.08}


@pytest.fixture(scope='module')
def spindle(data, tmp_path_factory):
    """A folder with a bag of the public spindle recording and its figures, and its table."""
    table = data / 'spindle-thermal' / 'spindle_thermal.csv'
    if not table.is_file():
        pytest.skip(f'expected the public recording {table.name} beside the others')
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp('spindle')
        patch.chdir(folder)
        commands = [
            ['import-csv', str(table), '--out', 'spindle', '--time', 't', '--temperature', 't*',
             '--displacement', 'ch1=X:um,ch2=X:um,ch3=Y:um,ch4=Y:um,ch5=Z:um', '--speed', 'rpm'],
            ['report', 'thermal', 'spindle', '--distance', 'X=100mm', '--distance', 'Y=100mm',
             '--json', 'r.json'],
        ]  # fmt: skip
        for command in commands:
            assert run(command) == 0, command
    return folder, np.genfromtxt(table, delimiter=',', names=True)


def test_a_real_recording_gives_the_figures_of_plain_numpy(spindle):
    folder, table = spindle
    figures = json.loads((folder / 'r.json').read_text())
    time = table['t'] - table['t'][0]
    begins = [0, *np.flatnonzero(np.diff(table['rpm'])) + 1]
    assert len(figures['phases']) == len(begins) == 9
    assert figures['phases'][7]['name'] == 'spindle 5000 rpm'
    probes = {
        name: table[f'ch{number}'] for number, name in enumerate(('X1', 'X2', 'Y1', 'Y2', 'Z'), 1)
    }
    probes['A'] = -(probes['Y1'] - probes['Y2']) / 0.1
    probes['B'] = (probes['X1'] - probes['X2']) / 0.1
    ends = [*begins[1:], len(time)]
    for phase, first, end in zip(figures['phases'], begins, ends, strict=True):
        assert phase['start_s'] == pytest.approx(time[first])
        for name, course in probes.items():
            inside = course[first:end]
            found = phase['without'][name]
            assert found['whole'] == pytest.approx(np.ptp(inside), abs=1e-3)
            assert found['change'] == pytest.approx(inside[-1] - inside[0], abs=1e-3)
            if end - first < 240:
                assert found['first_hour'] is None
                continue
            hour = course[first : first + 241]
            assert found['first_hour'] == pytest.approx(np.ptp(hour), abs=1e-3)
            if found['rise_time_s'] is not None:
                share = (inside - inside[0]) / (inside[-1] - inside[0])
                row = np.flatnonzero(share >= 0.9)[0]
                assert 15.0 * (row - 1) <= found['rise_time_s'] <= 15.0 * row
        moved = np.stack([probes[name][first:end] for name in ('X1', 'Y1', 'Z')])
        distance = np.linalg.norm(moved - moved[:, :1], axis=0)
        assert phase['without']['combined']['whole'] == pytest.approx(distance.max(), abs=1e-3)
    known = [
        phase['without'][name]['rise_time_s'] for phase in figures['phases'][1:] for name in probes
    ]
    assert sum(value is not None for value in known) > 40


@pytest.mark.slow
def test_a_real_recording_becomes_a_page_and_a_pdf_with_these_figures(spindle, monkeypatch):
    folder, table = spindle
    monkeypatch.chdir(folder)
    assert run(['report', 'thermal', 'spindle', '--out', 'r.html', '--pdf', 'r.pdf']) == 0
    fastest = slice(*(np.flatnonzero(table['rpm'] == 5000)[[0, -1]] + [0, 1]))
    page = Path('r.html').read_text()
    section = page[
        page.index('Phase 8: spindle 5000 rpm') : page.index('Phase 9: spindle at rest')
    ]
    for number in range(1, 6):
        assert f'>{np.ptp(table[f"ch{number}"][fastest]):.2f}</td>' in section
    for name in ('r.html', 'r.pdf'):
        assert 20e3 < Path(name).stat().st_size < 1.5e6

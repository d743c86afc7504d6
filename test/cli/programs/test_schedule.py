# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc schedule`: from a part program to one with feeds that keep a tolerance."""

import io
import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from programs.without_feeds import strip_feeds

from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.units import FEEDS, LENGTHS, SHARES

PROGRAM = b"""%\r
(part 7 \xb0C \xff)\r
N10 G21 G90 G17\r
N20 G0 X0 Y0 Z0\r
N30 G1 X30 F6000 ; along\r
N40 G2 X40 Y0 I5\r
N50 G1 X70\r
N60 CYCLE81(10.,0.,3.)\r
N70 G0 Z5\r
N80 G4 P0.5\r
M30\r
%\r
"""

MACHINE = """
/**/feedrate_scheduler:
  ros__parameters:
    method: normal_acceleration
    tolerance: 2e-5
    axis_velocity: [0.05, 0.25, 0.25]
/**/simulated_machine:
  ros__parameters:
    axis_position_gain: 50.0
"""


@pytest.fixture
def part(fuzzycnc):
    """Return a part program in the folder that the command runs in."""
    path = Path('part.ngc')
    path.write_bytes(PROGRAM)
    return path


def text(path):
    """Return a program to the last byte."""
    return Path(path).read_bytes().decode('utf-8', errors='surrogateescape')


def feeds(path):
    """Feeds of the segments that have one [mm/min]."""
    return [60e3 * one.feed for one in read_program(text(path)).segments if one.schedulable]


def test_feed_words_alone_change(fuzzycnc, part):
    outcome = fuzzycnc('schedule', part, '--tolerance', '0.01mm', '--out', 'out.ngc')
    assert outcome.code == 0, outcome.err
    assert strip_feeds(text('out.ngc')) == strip_feeds(text(part))
    line, arc, last = feeds('out.ngc')
    assert line == last == pytest.approx(6000.0)
    # the tolerance over machine constant and margin, across a radius of 5 mm
    fastest = 60e3 * (1e-5 / 2.1517e-4 * 5e-3) ** 0.5
    assert 0.8 * fastest < arc <= fastest
    changed = [
        (old, new)
        for old, new in zip(text(part).splitlines(), text('out.ngc').splitlines(), strict=True)
        if old != new
    ]
    assert [re.sub(r' F[\d.]+', '', new) for _, new in changed] == [old for old, _ in changed]
    assert [old[:3] for old, _ in changed] == ['N40', 'N50']


def test_the_table_says_what_it_takes_and_what_was_passed_through(fuzzycnc, part):
    outcome = fuzzycnc(
        'schedule', part, '--tolerance', '10um', '--out', 'out.ngc', '--json', 'figures.json'
    )
    figures = json.loads(Path('figures.json').read_text())
    times = figures['times']
    assert times['duration'] > times['programmed'] > 0.0
    assert times['dwell'] == 0.5
    assert times['chosen'] == 3
    assert figures['feed_words'] == {'added': 2, 'changed': 0}
    assert figures['settings']['tolerance'] == pytest.approx(1e-5)
    assert any('CYCLE81' in note['text'] for note in figures['notes'])
    for piece in (
        'tolerance 0.01 mm',
        'as programmed',
        f'{times["programmed"]:.1f}',
        f'{times["duration"]:.1f}',
        'feed words: 2 added, 0 changed',
        'note: line 8: CYCLE81',
        'mean feed [mm/min]',
        'out.ngc: the program with its new feeds',
    ):
        assert piece in outcome.out, piece


def test_a_machine_constant_that_is_not_the_users_is_said_in_the_first_line(fuzzycnc, part):
    said = 'machine constant 0.000215 s² of the built-in simulated mill, not of your machine'
    options = ('schedule', part, '--tolerance', '10um', '--out', 'out.ngc', '--in-place')
    assert fuzzycnc(*options).out.startswith(said)
    own = Path('own.yaml')
    own.write_text('machine: own\naxes: {X: {limits: {velocity: 200 mm/s}}}\n')
    assert fuzzycnc(*options, '--machine-file', own).out.startswith(said)
    own.write_text('machine: own\ncontour_constant: {XY: 1e-4, XZ: 1e-4, YZ: 1e-4}\n')
    assert 'not of your machine' not in fuzzycnc(*options, '--machine-file', own).out


def test_the_machine_file_gives_what_the_command_line_leaves_open(fuzzycnc, part):
    Path('machine.yaml').write_text(MACHINE)
    options = ('--machine', 'machine.yaml', '--out', 'out.ngc', '--json', 'figures.json')
    assert fuzzycnc('schedule', part, *options).code == 0
    figures = json.loads(Path('figures.json').read_text())
    assert figures['method'] == 'normal_acceleration'
    assert figures['settings']['tolerance'] == 2e-5
    line, arc, _ = feeds('out.ngc')
    assert line == pytest.approx(3000.0)  # the slow axis
    assert arc == pytest.approx(60e3 * (2e-5 / 2.1517e-4 * 5e-3) ** 0.5, rel=5e-3)
    # one feed for all knows no tolerance
    outcome = fuzzycnc('schedule', part, *options, '--method', 'constant')
    assert outcome.code == 1
    assert '! tolerance not kept' in outcome.out
    assert feeds('out.ngc') == pytest.approx([3000.0, 3000.0, 3000.0])


def test_feed_override_and_units(fuzzycnc, part):
    common = ('--tolerance', '1mm', '--out', 'out.ngc')
    assert fuzzycnc('schedule', part, *common, '--feed', '0.05m/s').code == 0
    assert feeds('out.ngc') == pytest.approx([3000.0] * 3)
    assert fuzzycnc('schedule', part, *common, '--override', '50%').code == 0
    assert feeds('out.ngc') == pytest.approx([3000.0] * 3)
    Path('inch.ngc').write_text('F100\nG1 X1\nX2\n')
    assert (
        fuzzycnc('schedule', 'inch.ngc', *common, '--units', 'inch', '--feed', '1m/min').code == 0
    )
    assert 'F39.37007' in text('out.ngc')


def test_corners_are_stopped_at_or_blended(fuzzycnc):
    Path('corner.ngc').write_text('G0 X0 Y0 Z0\nG1 X30 F6000\nY30\n')
    stops = []
    for blend, code in (('0mm', 0), ('0.05mm', 1)):
        options = ('--tolerance', '0.01mm', '--blend', blend, '--json', 'figures.json')
        outcome = fuzzycnc('schedule', 'corner.ngc', *options, '--out', 'out.ngc')
        assert outcome.code == code
        figures = json.loads(Path('figures.json').read_text())
        stops.append(figures['times']['stops'])
        assert feeds('out.ngc') == pytest.approx([6000.0, 6000.0])
        # feeds alone do nothing here, and the figures say so
        assert 'unchanged: no feed word' in outcome.out
        assert figures['driven']['programmed'] == figures['driven']['scheduled']
        assert figures['times']['error'] == figures['times']['programmed_error']
        assert figures['tolerance_kept'] is (code == 0)
    assert stops == [2, 1]
    assert 'at corners, line' in outcome.out


def test_the_figures_of_the_program_as_it_was_do_not_depend_on_the_tolerance(fuzzycnc):
    Path('wave.ngc').write_text(
        'G0 X0 Y0\nF3000\nG1 X5\nX9 Y3\nG3 X12 Y3 I1.5\nG1 X12 Y0\nX20 Y0.4\nX26 Y0\n'
    )
    found = []
    for tolerance in ('10um', '50um'):
        options = ('--tolerance', tolerance, '--blend', '0.01mm', '--json', 'figures.json')
        fuzzycnc('schedule', 'wave.ngc', *options, '--out', 'out.ngc')
        figures = json.loads(Path('figures.json').read_text())
        found.append((figures['times']['programmed_error'], figures['driven']['programmed']))
    assert found[0] == found[1]


def test_the_program_itself_only_if_somebody_says_so(fuzzycnc, refused, part):
    command = ('schedule', part, '--tolerance', '0.01mm', '--out', part)
    refused(*command, naming=['part.ngc', 'program itself', '--in-place'])
    assert part.read_bytes() == PROGRAM
    assert fuzzycnc(*command, '--in-place').code == 0
    assert strip_feeds(text(part)) == strip_feeds(PROGRAM.decode(errors='surrogateescape'))
    assert part.read_bytes() != PROGRAM
    assert [path.name for path in Path().iterdir()] == ['part.ngc']


def test_a_subroutine_is_looked_for_beside_the_program_alone(fuzzycnc, tmp_path):
    (tmp_path / 'other').mkdir()
    for folder in (tmp_path, tmp_path / 'other'):
        (folder / 'drill.ngc').write_text('o<drill> sub\nG1 X9 F300\no<drill> endsub\nM2\n')
    main = tmp_path / 'main.ngc'
    for name, found in (('drill', True), ('other/drill', False), ('missing', False)):
        main.write_text(f'G21 G90\nG1 X0 Y0 Z0 F600\nX5\no<{name}> call\nM2\n')
        text = fuzzycnc('schedule', main, '--tolerance', '20um', '--out', tmp_path / 'new.ngc').out
        assert ('subroutine in a file of its own, keeps its feeds' in text) is found
        assert (f'call of {name}, which is not here' in text) is not found


def test_standard_streams(fuzzycnc, part, monkeypatch):
    assert fuzzycnc('schedule', part, '--tolerance', '0.01mm', '--out', 'out.ngc').code == 0
    output = SimpleNamespace(buffer=io.BytesIO(), flush=lambda: None, isatty=lambda: False)
    with monkeypatch.context() as streams:
        streams.setattr('sys.stdin', SimpleNamespace(buffer=io.BytesIO(PROGRAM)))
        streams.setattr('sys.stdout', output)
        outcome = fuzzycnc('schedule', '-', '--tolerance', '0.01mm', '--out', '-')
    assert outcome.code == 0
    assert output.buffer.getvalue() == Path('out.ngc').read_bytes()
    assert 'as programmed' in outcome.err


def test_the_report_shows_path_motion_and_all_methods(fuzzycnc, part):
    Path('machine.yaml').write_text(MACHINE)
    outcome = fuzzycnc(
        'schedule', part, '--tolerance', '0.01mm', '--machine', 'machine.yaml', '--out', 'out.ngc',
        '--report', 'page.html', '--blend', '0.01mm', '--method', 'log_fuzzy',
    )  # fmt: skip
    assert outcome.code == 1, outcome.err
    assert 'tolerance not kept' in Path('page.html').read_text()
    assert 'page.html: the report' in outcome.out
    page = Path('page.html').read_text()
    assert page.count('class="chart"') == 3
    for piece in (
        'The path by feed',
        'Motion over time',
        'Where the error is',
        'feed [mm/min]',
        'as programmed',
        'one feed for all',
        'log-fuzzy (default)',
        'published fuzzy',
        'look-ahead',
        'jerk-limited',
        'know no tolerance',
        'Passed through untouched',
        'CYCLE81',
        'the whole program',
        'position loop 50 1/s',
    ):
        assert piece in page, piece


def test_of_a_long_program_the_report_drives_the_beginning_and_says_so(fuzzycnc, monkeypatch):
    monkeypatch.setattr('fuzzycnc_ros.cli.programs.schedule.STRETCH', 1.0)
    lines = [f'G1 X{x} Y{x % 2}' for x in range(1, 60)]
    Path('long.ngc').write_text('G0 X0 Y0 Z0\nF3000\n' + '\n'.join(lines) + '\n')
    options = ('--tolerance', '0.01mm', '--out', 'out.ngc', '--report', 'page.html')
    assert fuzzycnc('schedule', 'long.ngc', *options).code == 0
    found = re.findall(r'lines 1 to (\d+) of 61', Path('page.html').read_text())
    driven, compared = min(map(int, found)), max(map(int, found))
    assert 5 < driven < 15  # the controller rests at each of these corners
    assert 30 < compared < 40


def test_a_move_below_rounding_does_not_end_what_is_driven(fuzzycnc):
    Path('tiny.ngc').write_text('G0 X0 Y0 Z0\nG1 X0.000001 F600\nG0 Y1\nG1 X5\nY9\nM2\n')
    outcome = fuzzycnc('schedule', 'tiny.ngc', '--tolerance', '0.01mm', '--out', 'out.ngc')
    assert outcome.code == 0, outcome.err
    assert 'the whole program' in outcome.out
    assert 'the feeds of 2 chosen' in outcome.out  # that of the first move stays its own


@pytest.mark.parametrize(('words', 'most'), [('F60', 210), ('G93 F60', 2010)])
def test_of_blocks_that_keep_their_feed_only_the_beginning_is_driven(fuzzycnc, words, most):
    lines = [f'G1 X{x / 10} A{x} {words}' for x in range(1, 3000)]
    Path('five.ngc').write_text('G0 X0 Y0 Z0 A0\n' + '\n'.join(lines) + '\n')
    outcome = fuzzycnc('schedule', 'five.ngc', '--tolerance', '0.01mm', '--out', 'out.ngc')
    assert outcome.code == 0, outcome.err
    (driven,) = re.findall(r'lines 1 to ([\d,]+) of 3,000', outcome.out)
    assert int(driven.replace(',', '')) <= most


@pytest.mark.parametrize(
    ('written', 'units', 'value'),
    [
        ('0.01mm', LENGTHS, 1e-5),
        ('10 um', LENGTHS, 1e-5),
        ('10µm', LENGTHS, 1e-5),
        ('1e-5m', LENGTHS, 1e-5),
        ('.001inch', LENGTHS, 25.4e-6),
        ('0.001IN', LENGTHS, 25.4e-6),
        ('6000mm/min', FEEDS, 0.1),
        ('0.1m/s', FEEDS, 0.1),
        ('100mm/s', FEEDS, 0.1),
        ('6 m/min', FEEDS, 0.1),
        ('10in/min', FEEDS, 0.254 / 60.0),
        ('120%', SHARES, 1.2),
    ],
)
def test_quantities_carry_their_units(written, units, value):
    assert quantity('--option', written, units, example='1') == pytest.approx(value, rel=1e-12)


def test_a_curve_with_a_cusp_is_driven(fuzzycnc):
    """Where a curve turns back its curvature is infinite."""
    lines = ('G21 G17 G90 G0 X0 Y0', 'F600', 'G5.2 X0 Y10 P1 L3', 'X0 Y-5 P1', 'X0 Y12 P1')
    Path('cusp.ngc').write_text('\n'.join([*lines, 'X5 Y0 P1', 'G5.3', 'M2', '']))
    options = ('--tolerance', '0.05mm', '--out', 'out.ngc')
    assert fuzzycnc('schedule', 'cusp.ngc', *options).code in (0, 1)


@pytest.mark.filterwarnings('error')
def test_a_curve_that_ends_in_equal_control_points_is_rounded_without_a_warning(fuzzycnc):
    """Its bend at the end has no bound, nor has that of a first rounding beside it."""
    points = ((10, 5), (10, 5), (10, 5), (20, 0), (30, 0), (30, 0), (30, 0))
    lines = ('G21 G17 G90 G64 P0.02', 'F3000', 'G5.2 P1 L3 X0 Y0')
    curve = (f'X{x} Y{y} P1' for x, y in points)
    Path('ends.ngc').write_text('\n'.join([*lines, *curve, 'G5.3', 'M2', '']))
    done = fuzzycnc('schedule', 'ends.ngc', '--tolerance', '0.02mm', '--out', 'out.ngc')
    assert done.code in (0, 1), done.err


@pytest.mark.parametrize(
    ('option', 'said'),
    [
        ([], 'corners rounded by up to 0.01 mm, as the program says (G64 P, G61)'),
        (['--blend', '0.02mm'], 'corners rounded by up to 0.02 mm, at most'),
        ([], 'bound, without exact stops and what rounding itself leaves, up to 0.01 mm: machine'),
        (['--blend', '0mm'], 'bound, without exact stops: machine constant'),
        (['--blend', '0mm'], 'corners stopped at, at most'),
    ],
)
def test_the_rounding_of_the_program_counts_unless_an_option_says_another_one(
    fuzzycnc, option, said
):
    lines = 'G21 G64 P0.01\nG0 X0 Y0 Z0\nG1 F300 X5\nX10 Y1\nX15 Y3\nX20\n'
    Path('part.ngc').write_text(lines)
    run = fuzzycnc(
        'schedule', 'part.ngc', '--tolerance', '0.1mm', '--out', 'out.ngc', '--json', 'f.json',
        *option,
    )  # fmt: skip
    assert run.code == 0, run.out
    assert said in ' '.join(run.out.split())
    stops = json.loads(Path('f.json').read_text())['times']['stops']
    assert stops == (4 if option == ['--blend', '0mm'] else 1)


def test_motions_that_are_not_timed_are_counted_in_table_figures_and_remarks(fuzzycnc):
    Path('part.ngc').write_text('G0 X0 Y0 Z0\nG28 Z0\nG81 X1 Y1 Z-1 R1 F60\nG80\nM2\n')
    run = fuzzycnc(
        'schedule', 'part.ngc', '--tolerance', '0.1mm', '--out', 'out.ngc', '--json', 'f.json',
        '--report', 'page.html',
    )  # fmt: skip
    assert run.code == 0, run.out
    assert json.loads(Path('f.json').read_text())['times']['untimed'] == 2
    for text in (run.out, Path('page.html').read_text()):
        assert '2 motions left out of the times' in ' '.join(text.split())
        assert 'left out of both times: 2 motions, cycles or calls' in ' '.join(text.split())

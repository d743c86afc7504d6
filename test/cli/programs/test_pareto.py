# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc pareto`: figures, page, refusals."""

import json

import pytest

PROGRAM = 'G21 G17 G90\nG0 X0 Y0\nG1 X10 F600\nG3 X10 Y10 J5\nG1 X0\nG1 X-5 Y3\nM30\n'
SOME = ('--methods', 'fuzzy,log_fuzzy')


@pytest.fixture
def program(tmp_path):
    path = tmp_path / 'part.ngc'
    path.write_text(PROGRAM)
    return path


def test_figures_of_a_program(fuzzycnc, program, tmp_path):
    outcome = fuzzycnc('pareto', program, *SOME, '--json', 'out.json', '--report', 'page.html')
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    assert set(document) == {'methods', 'equal_error'}
    assert set(document['methods']) == {'fuzzy', 'log_fuzzy'}
    for points in document['methods'].values():
        assert all(set(point) == {'error_mm', 'time_s'} for point in points)
        times = [point['time_s'] for point in points]
        assert times == sorted(times, reverse=True)
    for error in ('0.01', '0.05', '0.1'):
        time = document['equal_error'][error]
        assert 0.0 < time['log_fuzzy'] < time['fuzzy']
        assert f'{time["log_fuzzy"]:.2f}' in outcome.out
    assert 'run 1 of 1, lines 3 to 6' in outcome.out
    assert 'less time than fuzzy' in outcome.out
    page = (tmp_path / 'page.html').read_text()
    assert 'class="chart"' in page
    assert 'log-fuzzy (default)' in page
    assert 'run 1 of 1, lines 3 to 6' in page


def test_errors_of_ones_own(fuzzycnc, program, tmp_path):
    arguments = ('--errors', '20um', '--errors', '0.08mm,20um', '--json', 'out.json')
    outcome = fuzzycnc('pareto', program, '--methods', 'constant', *arguments)
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    assert list(document['equal_error']) == ['0.02', '0.08']
    assert 'time [s] at 0.02 mm' in outcome.out


def test_machine_file_counts(fuzzycnc, program, tmp_path):
    slow = tmp_path / 'slow.yaml'
    slow.write_text(
        'feedrate_scheduler:\n  ros__parameters:\n    machine_constant: 1.0527e-3\n'
        'simulated_machine:\n  ros__parameters:\n    axis_position_gain: 20.0\n'
    )
    time = []
    for options in ((), ('--machine', slow)):
        outcome = fuzzycnc(
            'pareto', program, '--methods', 'log_fuzzy', '--json', 'out.json', *options
        )
        assert outcome.code == 0, outcome.err
        document = json.loads((tmp_path / 'out.json').read_text())
        time.append(document['equal_error']['0.05']['log_fuzzy'])
    assert time[1] > 1.5 * time[0]


def test_what_cannot_be_reached_is_null_and_says_why(fuzzycnc, program, tmp_path):
    program.write_text('G0 X0 Y0\nG2 X0 Y0 I60 F600\n')
    outcome = fuzzycnc(
        'pareto', program, '--methods', 'constant', '--errors', '1mm', '--json', 'out.json'
    )
    assert outcome.code == 0, outcome.err
    document = json.loads((tmp_path / 'out.json').read_text())
    assert document['equal_error'] == {'1': {'constant': None}}
    assert 'constant at 1 mm: leaves less at full feed' in outcome.out


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        (('heart',), ['heart', 'infinity, trident, butterfly', 'no such file']),
        (('butterfly', '--errors', '0.05'), ['--errors', 'expected a unit']),
        (('butterfly', '--errors', '0mm'), ['--errors', 'above 0', "'0mm'"]),
        (('butterfly', '--errors', '-1mm'), ['--errors', 'above 0']),
        (('butterfly', '--errors', 'nanmm'), ['--errors']),
        (('butterfly', '--errors', '5mm'), ['--errors', '0.001 mm to 1 mm', '5 mm']),
        (('butterfly', '--errors', ','), ['--errors', 'found none']),
        (('butterfly', '--methods', 'magic'), ['--methods', "'magic'", 'log_fuzzy']),
        (('butterfly', '--run', '1'), ['--run', 'part program', 'butterfly']),
        (('butterfly', '--json', 'no/such/out.json'), ['no/such/out.json', 'folder']),
        (('butterfly', '--machine', 'none.yaml'), ['none.yaml']),
        (('part.ngc', '--run', '0'), ['--run', '1 or more', '0']),
        (('part.ngc', '--run', '2'), ['part.ngc', '--run', 'a run that bends', '2']),
    ],
)
def test_wrong_calls_are_refused(refused, program, arguments, naming):
    refused('pareto', *arguments, naming=naming)


@pytest.mark.parametrize(
    ('name', 'content', 'naming'),
    [
        ('empty.ngc', b'', ['empty.ngc', 'line 1', 'empty']),
        ('open.ngc', b'G1 X1 F100\nG1 X2 (open\n', ['open.ngc', 'line 2']),
        ('arc.ngc', b'G0 X0\nG2 X10 R2 F100\n', ['arc.ngc', 'line 2']),
        ('binary.ngc', bytes(range(256)), ['binary.ngc', 'line 1']),
        ('straight.ngc', b'G1 X10 F600\n', ['straight.ngc', 'run that bends']),
        ('points.csv', b'x,y\n0,0\n1,zero\n2,2\n', ['points.csv', 'line 3']),
        ('binary.csv', bytes(range(256)), ['binary.csv']),
    ],
)
def test_wrong_files_are_refused(refused, tmp_path, name, content, naming):
    (tmp_path / name).write_bytes(content)
    refused('pareto', name, naming=naming)

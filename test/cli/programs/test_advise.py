# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc advise`: remedies for a program, and what it writes."""

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from programs.without_feeds import strip_feeds

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.motion.program_request import program_settings
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller import agreement
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import path_modes, program_moves, simulate
from fuzzycnc_ros.studies.programs import advice
from fuzzycnc_ros.studies.programs.program_judge import ProgramPath
from fuzzycnc_ros.studies.programs.split_program import check_same_path

PART = """(part)
G21 G90 G17 G64 P0.02
G0 X0 Y0 Z0
G1 X8 F1500
Y6
G3 X5 Y9 I-3 J0
G1 X0
X-3 Y5
Y1
X0 Y0
M2
"""


@pytest.fixture
def part(fuzzycnc):
    """A part program with corners and an arc, in the folder that the command runs in."""
    path = Path('part.ngc')
    path.write_text(PART)
    return path


@pytest.fixture(autouse=True)
def one_acceleration(monkeypatch):
    """Refine with one acceleration only, which takes a third of the time."""
    monkeypatch.setattr('fuzzycnc_ros.studies.programs.advice.REFINED', (0.5,))


def advised(fuzzycnc, part, *options, code=0):
    outcome = fuzzycnc(
        'advise', part, '--tolerance', '20um', '--json', 'a.json', '--out', 'out.ngc', *options
    )
    assert outcome.code == code, outcome.out + outcome.err
    return outcome, json.loads(Path('a.json').read_text())


def test_the_fastest_that_keeps_the_tolerance_is_recommended_and_written(fuzzycnc, part):
    outcome, found = advised(fuzzycnc, part, '--corners', 'split', '--report', 'page.html')
    remedies = found['remedies']
    names = [one['name'] for one in remedies]
    assert names[:3] == ['as it is', 'acceleration of tolerance / C', 'lower acceleration']
    assert found['aim'] == pytest.approx(
        20e-6 / max(agreement.LARGEST[one] for one in ('lines', 'arcs'))
    )
    kept = [one for one in remedies if one['simulated']['error'] <= found['aim']]
    assert found['kept']
    best = remedies[found['best']]
    assert best in kept
    assert best['simulated']['duration'] <= 1.01 * min(
        one['simulated']['duration'] for one in kept
    )
    assert 'recommended: ' in outcome.out
    # what was written does what was said, along the same path
    given, written = read_program(PART), read_program(Path('out.ngc').read_text())
    check_same_path(given, written)
    limits = ControllerLimits(
        velocity=(0.25,) * 3, acceleration=tuple(best['acceleration']), path_velocity=0.25
    )
    path = ProgramPath(program_moves(given.blocks))
    judged = path.run(program_moves(written.blocks), limits, ContouringConfig())
    assert judged.error == pytest.approx(best['simulated']['error'], rel=0.02)
    assert judged.duration == pytest.approx(best['simulated']['duration'], rel=0.01)
    page = Path('page.html').read_text()
    for name in names:
        assert name in page
    assert 'Time against largest contour error' in page


def test_without_cutting_only_words_change(fuzzycnc, part):
    _, found = advised(fuzzycnc, part)
    assert not any('cut' in one['name'] for one in found['remedies'])
    lines = [
        line
        for line in strip_feeds(Path('out.ngc').read_text()).splitlines()
        if not line.startswith('G64')
    ]
    assert lines == strip_feeds(PART).replace(' G64 P0.02', '').splitlines()


def test_what_cannot_be_kept_is_said_in_a_sentence_and_by_the_code(fuzzycnc, part):
    outcome = fuzzycnc(
        'advise', part, '--tolerance', '0.01um', '--corners', 'none', '--json', 'a.json'
    )
    assert outcome.code == 1
    assert '! no remedy tried keeps 0.01 µm; the least error' in outcome.out
    found = json.loads(Path('a.json').read_text())
    errors = [one['simulated']['error'] for one in found['remedies']]
    assert errors[found['best']] == min(errors)
    assert not found['kept']


def test_a_program_that_is_good_is_left_alone(fuzzycnc, part):
    part.write_text('G21 G64 P0.01\nG1 X30 F600\nX60\n')
    outcome = fuzzycnc('advise', part, '--tolerance', '20um', '--out', 'out.ngc')
    assert outcome.code == 0
    assert 'leave it as it is' in outcome.out
    assert Path('out.ngc').read_text() == part.read_text()


def test_feeds_are_refined_no_further_than_somebody_wants(fuzzycnc, part, monkeypatch):
    """As it is the program keeps the tolerance; with a path mode its corners had to creep."""
    part.write_text('G21 G90 G17\nF800\nG0 X2 Y0 Z0\nG2 X2 Y0 I-2 J0 Z-1\nG1 X0\nG1 Y3\nM2\n')
    tried = []
    simulate = advice.simulate
    monkeypatch.setattr(advice, 'simulate', lambda *given: tried.append(1) or simulate(*given))
    outcome = fuzzycnc('advise', part, '--tolerance', '20um', '--json', 'a.json')
    assert outcome.code == 0, outcome.err
    found = json.loads(Path('a.json').read_text())
    durations = [one['simulated']['duration'] for one in found['remedies']]
    assert durations[-1] > advice.LOST * durations[found['best']]
    assert len(tried) <= 12  # of 48


def mode_after(text, before=None):
    """Return the path mode that a program ends with."""
    *_, (_, mode) = path_modes(read_program(text).blocks, before)
    return mode


class Harder:
    """A LinuxCNC that accelerates more than it should, so that it leaves more.

    As the real one it keeps the path mode from program to program.
    """

    more = 1.0

    def __init__(self):
        self.runs = []
        self._acceleration = (0.0,) * 3
        self._mode = None

    def limit(self, velocity, acceleration):
        self._velocity, self._acceleration = velocity, acceleration

    def origin(self, path_mode='G64'):
        self._mode = mode_after(f'G21 {path_mode}\n')

    def run(self, text, timeout):
        limits = ControllerLimits(
            velocity=self._velocity,
            acceleration=tuple(self.more * rise for rise in self._acceleration),
            path_velocity=0.25,
        )
        self.runs.append(text)
        [found] = simulate(program_moves(read_program(text).blocks, self._mode), limits)
        self._mode = mode_after(text, self._mode)
        return found.position


@pytest.fixture
def harder(monkeypatch):
    """Have the command run remedies on such a LinuxCNC."""
    machine = Harder()

    @contextlib.contextmanager
    def recording():
        yield machine

    monkeypatch.setattr('fuzzycnc_ros.adapters.linuxcnc.recorder.recording', recording)
    return machine


@pytest.mark.parametrize('more', [1.12, 1.3])
def test_what_leaves_too_much_on_linuxcnc_is_looked_for_again_with_a_lower_aim(
    fuzzycnc, part, harder, more
):
    harder.more = more
    _, found = advised(fuzzycnc, part, '--corners', 'none', '--linuxcnc')
    remedies, best = found['remedies'], found['remedies'][found['best']]
    tries = len(harder.runs) - len(remedies)
    assert 0 < tries <= advice.AGAIN * len(remedies)
    assert found['kept']
    assert 0.9 * 20e-6 < best['linuxcnc']['error'] <= 20e-6, 'dropped, or aimed too low'
    assert best['simulated']['error'] < found['aim']
    # nothing is left that might be faster
    for one in remedies:
        if one['simulated']['error'] <= found['aim'] and one['linuxcnc']['error'] > 20e-6:
            assert one['linuxcnc']['duration'] >= best['linuxcnc']['duration']


def test_what_keeps_the_tolerance_on_linuxcnc_runs_once(fuzzycnc, part, harder):
    _, found = advised(fuzzycnc, part, '--corners', 'none', '--linuxcnc')
    assert len(harder.runs) == len(found['remedies'])


@pytest.mark.parametrize('blend', [[], ['--blend', '0.01mm']])
def test_a_program_without_a_path_mode_runs_on_linuxcnc_in_the_one_that_was_simulated(
    fuzzycnc, part, harder, blend
):
    harder.more = 1.0
    part.write_text(PART.replace(' G64 P0.02', ''))
    _, found = advised(fuzzycnc, part, '--corners', 'none', '--linuxcnc', *blend)
    for one in found['remedies']:
        driven, simulated = one['linuxcnc'], one['simulated']
        assert driven['duration'] == pytest.approx(simulated['duration'], abs=0.003)
        # where corners are left by far the nearest place is not the one that was commanded
        assert driven['error'] == pytest.approx(simulated['error'], rel=0.03)


@pytest.mark.parametrize(
    ('options', 'naming'),
    [
        (['--corners', 'round'], ['--corners', 'none, feed, split']),
        (['--tolerance', '5'], ['--tolerance']),
        (['--blend', 'much'], ['--blend']),
        (['--units', 'cm'], ['--units']),
        (['--out', 'part.ngc'], ['part.ngc', '--in-place']),
        (['--out', '-'], ['--out', 'a file']),
        (['--machine-file', 'none.yaml'], ['none.yaml']),
    ],
)
def test_bad_options_are_refused(refused, part, options, naming):
    refused('advise', part, *options, naming=naming)
    assert [path.name for path in Path().iterdir()] == ['part.ngc']


def test_bad_programs_are_refused(fuzzycnc, refused):
    Path('still.ngc').write_text('M3 S100\nM2\n')
    refused('advise', 'still.ngc', '--tolerance', '20um', naming=['still.ngc', 'moves the tool'])
    Path('wrong.ngc').write_text('G1 X1\n')
    refused('advise', 'wrong.ngc', '--tolerance', '20um', naming=['wrong.ngc', 'line 1', 'feed'])


def test_a_slower_loop_asks_for_more(fuzzycnc, part):
    Path('m.yaml').write_text(
        '/**/feedrate_scheduler:\n  ros__parameters:\n    tolerance: 2e-5\n'
        '/**/simulated_machine:\n  ros__parameters:\n    axis_position_gain: 20.0\n'
    )
    _, ours = advised(fuzzycnc, part, '--corners', 'none')
    _, slow = advised(fuzzycnc, part, '--corners', 'none', '--machine-file', 'm.yaml')

    def fastest(found):
        return found['remedies'][found['best']]['simulated']['duration']

    assert slow['remedies'][0]['simulated']['error'] > ours['remedies'][0]['simulated']['error']
    assert fastest(slow) > fastest(ours)
    assert np.isclose(
        slow['remedies'][0]['simulated']['duration'], ours['remedies'][0]['simulated']['duration']
    )


def test_what_takes_longer_than_the_best_so_far_is_not_measured(monkeypatch):
    """The same is found as when all is measured, with fewer runs and none of them twice."""
    program = read_program('G21 G90 G17\nF1500\nG1 X2 Y0 Z0\nY2\nG3 X1 Y3 I-1 J0\nG1 X0 Y2\nM2\n')
    settings = program_settings(FeedrateSchedulerConfig(tolerance=2e-5, blend=1e-5))
    limits = ControllerLimits(velocity=(0.4,) * 3, acceleration=(2.0,) * 3, path_velocity=0.5)
    run_within = ProgramPath.run_within
    runs = {'within': [], 'all': []}

    def found(name, longest_of):
        def run(path, longest, moves, limits, machine):
            judged = run_within(path, longest_of(longest), moves, limits, machine)
            mode = moves.moves.rounding[0], moves.moves.merging[0]
            feeds = tuple(moves.moves.feed.tolist())
            runs[name].append((limits.acceleration, mode, feeds, judged is not None))
            return judged

        monkeypatch.setattr(ProgramPath, 'run_within', run)
        advised = advice.Adviser(program, 2e-5, limits, ContouringConfig(), settings)
        return advised.advise('none')

    quick, whole = found('within', lambda longest: longest), found('all', lambda longest: np.inf)
    assert repr(quick) == repr(whole)
    measured = [one for one in runs['within'] if one[-1]]
    assert len(set(measured)) == len(measured)
    assert len(measured) < len(runs['all'])

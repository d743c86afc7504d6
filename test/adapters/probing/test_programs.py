# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Programs of a probing cycle: where they move, what they leave as it was, and their syntax."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from fuzzycnc_ros.adapters.probing.probe_file import read_plan
from fuzzycnc_ros.adapters.probing.programs import BEGIN, DIALECTS, END, write_programs
from fuzzycnc_ros.core.probing.plan import PROBED_AXES, ProbePlan
from fuzzycnc_ros.ros.parameters import ParameterError

FILE = """
box: {X: [0, 300], Y: [-200, 0], Z: [-150, -5]}
travel_height: -10
tip: 6
artefacts:
  - {name: left, kind: sphere, at: [50, -40, -120], diameter: 25}
  - {name: right, kind: ring, at: [250, -40, -120], diameter: 50, axes: X}
  - {name: 'block (1)', kind: block, at: [150, -160, -120], face: Y-}
  - {name: setter, kind: setter, at: [200, -100, -140]}
"""
TOOLS = 'T1 P1 Z100 D6 ;mill\nT99 P99 Z50 ;probe\n'
INI = """[EMC]
VERSION = 1.1
[RS274NGC]
PARAMETER_FILE = test.var
SUBROUTINE_PATH = .
[EMCIO]
TOOL_TABLE = tool.tbl
[TRAJ]
LINEAR_UNITS = mm
"""
WORLDS = {
    'bare': ['G54'],
    'work offset': ['G10 L2 P1 X10 Y20 Z30', 'G54'],
    'shifted': ['G10 L2 P2 X-5 Y7 Z11', 'G55', 'G92 X3 Y4 Z5'],
    'tool length': ['G10 L2 P1 X1 Y2 Z3', 'G54', 'G43 H99'],
    'incremental': ['G54', 'G91', 'G93', 'G99'],
}
NUMBER = r'[-+]?\d+\.?\d*'


@pytest.fixture
def plan(tmp_path) -> ProbePlan:
    path = tmp_path / 'probe.yaml'
    path.write_text(FILE)
    return read_plan(path)


class Interpreter:
    """LinuxCNC's interpreter alone, and what it was told to do, in machine coordinates."""

    def __init__(self, folder, texts, *, hits):
        self.folder = folder
        for name, text in texts.items():
            # Alone it never touches anything: where it shall, the answer is put in its mouth.
            said = text.replace('#<_fuzzycnc_missed> = #5070', '#<_fuzzycnc_missed> = 0')
            (folder / name).write_text(said.replace('[1 - #5070]', '[0]') if hits else text)
        (folder / 'test.ini').write_text(INI)
        (folder / 'tool.tbl').write_text(TOOLS)

    def run(self, lines, begin=(10.0, -10.0, -5.0)):
        place = 'G53 G0 X{} Y{} Z{}'.format(*begin)
        program = ['G21 G90', place, *lines, 'o<fuzzycnc_probe> call', '(MSG, returned)', 'M2', '']
        (self.folder / 'main.ngc').write_text('\n'.join(program))
        (self.folder / 'test.var').write_text('')
        words = ['rs274', '-g', '-i', 'test.ini', '-t', 'tool.tbl', '-v', 'test.var', 'main.ngc']
        done = subprocess.run(words, cwd=self.folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return [line.split(' ', 1)[1] for line in map(str.strip, done.stdout.splitlines())]

    def variables(self):
        """Return what is kept: coordinate systems, their rotation, and which is in force."""
        return (self.folder / 'test.var').read_text()


def moves(lines):
    """Yield the moves of the cycle as machine coordinates, with their kind."""
    offsets = {name: np.zeros(3) for name in ('SET_G5X_OFFSET', 'SET_G92_OFFSET', 'TOOL')}
    inside = False
    for line in lines:
        inside |= 'SET_AUX_OUTPUT_VALUE' in line
        inside &= 'returned' not in line
        numbers = [float(text) for text in re.findall(NUMBER, line.partition('(')[2])]
        if 'SET_G5X_OFFSET(' in line:
            offsets['SET_G5X_OFFSET'] = np.array(numbers[1:4])
        elif 'SET_G92_OFFSET(' in line:
            offsets['SET_G92_OFFSET'] = np.array(numbers[:3])
        elif 'USE_TOOL_LENGTH_OFFSET(' in line:
            offsets['TOOL'] = np.array(numbers[:3])
        found = re.search(r'STRAIGHT_(TRAVERSE|FEED|PROBE)\(', line)
        if found and inside:
            yield found[1], np.array(numbers[:3]) + sum(offsets.values())


def changes(lines):
    """Return what the cycle itself does to coordinate systems, tool lengths and tools."""
    at = [i for i, line in enumerate(lines) if 'SET_AUX_OUTPUT_VALUE' in line]
    end = next(i for i, line in enumerate(lines) if 'returned' in line)
    return [
        line
        for line in lines[at[0] : end]
        if re.search(r'SET_G5X|SET_G92|TOOL|ROTATION|USE_LENGTH_UNITS', line)
    ]


needs_rs274 = pytest.mark.skipif(
    shutil.which('rs274') is None, reason='rs274 is missing: apt-get install linuxcnc-uspace'
)


@needs_rs274
@pytest.mark.parametrize('world', WORLDS)
def test_the_cycle_moves_in_its_box_and_changes_nothing(plan, tmp_path, world):
    texts = write_programs(plan, 'linuxcnc')
    interpreter = Interpreter(tmp_path, texts, hits=True)
    found = interpreter.run(WORLDS[world])
    kept = interpreter.variables()
    low, high = (np.array([plan.box[axis][side] for axis in PROBED_AXES]) * 1e3 for side in (0, 1))
    way = list(moves(found))
    assert len(way) > 8 * len(plan.touches)
    for kind, point in way:
        assert (low - 1e-3 <= point).all(), (kind, point)
        assert (point <= high + 1e-3).all(), (kind, point)
    # whatever is below the height of travel was reached by probing, or lies on a way probed before
    fast = [point for kind, point in way if kind == 'TRAVERSE']
    assert min(point[2] for point in fast) >= 1e3 * plan.travel_height - 1e-3
    assert not changes(found)
    assert (tmp_path / 'tool.tbl').read_text() == TOOLS
    # what is kept is what the program without the cycle keeps
    (tmp_path / 'fuzzycnc_probe.ngc').write_text(
        'o<fuzzycnc_probe> sub\no<fuzzycnc_probe> endsub\n'
    )
    interpreter.run(WORLDS[world])
    assert kept == interpreter.variables()


@needs_rs274
def test_results_are_told_in_order_in_machine_coordinates(plan, tmp_path):
    told = []
    for world in ('bare', 'tool length'):
        folder = tmp_path / world
        folder.mkdir()
        interpreter = Interpreter(folder, write_programs(plan, 'linuxcnc', 4, 5), hits=True)
        lines = interpreter.run(WORLDS[world])
        pairs = re.findall(r'SET_AUX_OUTPUT_VALUE\(([0-9]+),([-0-9.]+)\)', '\n'.join(lines))
        told.append([float(value) for number, value in pairs if number == '5'])
        codes = [float(value) for number, value in pairs if number == '4']
        assert codes == [BEGIN, *range(1, plan.count + 1), END]
        assert all(number in '45' for number, _ in pairs)
    assert told[0][0] == plan.signature
    np.testing.assert_allclose(told[0], told[1], atol=1e-3)
    # alone the interpreter touches at the end of its way, near the surface
    surfaces = [1e3 * touch.surface for _, _, touch in plan.touches for _ in range(plan.repeats)]
    np.testing.assert_allclose(told[0][1:], surfaces, atol=3.0)


@needs_rs274
def test_a_miss_ends_the_cycle_above(plan, tmp_path):
    lines = Interpreter(tmp_path, write_programs(plan, 'linuxcnc'), hits=False).run(['G54'])
    way = list(moves(lines))
    assert len([kind for kind, _ in way if kind == 'PROBE']) == 2  # down, and past the surface
    assert way[-1][1][2] == pytest.approx(1e3 * plan.travel_height)
    assert way[-2][1][:2] == pytest.approx(1e3 * np.array(plan.touches[0][2].start[:2]))
    codes = [line for line in lines if 'SET_AUX_OUTPUT_VALUE(0,' in line]
    assert len(codes) == 2
    assert codes[-1].endswith('(0,-1.000000)')


@needs_rs274
@pytest.mark.parametrize(
    ('lines', 'begin', 'text'),
    [
        (['S100 M3'], (10, -10, -5), 'the spindle turns'),
        ([], (10, -10, -4), 'outside of its box'),
        ([], (-1, -10, -5), 'outside of its box'),
        (['G10 L2 P1 R10', 'G54'], (10, -10, -5), 'is turned'),
        (['G20'], (10, -10, -5), 'needs G21'),
    ],
)
def test_the_cycle_is_not_begun_where_it_could_do_harm(plan, tmp_path, lines, begin, text):
    found = Interpreter(tmp_path, write_programs(plan, 'linuxcnc'), hits=True).run(lines, begin)
    assert any('not begun' in line and text in line for line in found)
    assert not list(moves(found))


def test_the_cycle_asks_for_its_tool(tmp_path):
    path = tmp_path / 'probe.yaml'
    path.write_text(FILE + 'tool: 99\n')
    text = write_programs(read_plan(path), 'linuxcnc')['fuzzycnc_probe.ngc']
    assert 'o4 if [[99 NE 0] AND [#<_current_tool> NE 99]]' in text


FANUC = re.compile(
    r"""%|O\d{4}\([A-Z .\-]+\)|\([A-Z0-9 .,_\-#]+\)|
    (N\d+\ )?(
        (\#(\d+|\[[^=]+\])=[-+*/\[\]#\d.A-Z]+)|
        IF\[[-+*/\[\]#\d.A-Z]+\]GOTO\d+|WHILE\[[-+*/\[\]#\d.A-Z]+\]DO\d|END\d|GOTO\d+|
        POPEN|PCLOS|M99|DPRNT(\[\#\d+\[\d\d\]\*\#\d+\[\d\d\]\])|
        G65\ P\d{4}(\ [A-Z]-?\d+\.\d*)+|
        (G(\d+|\#\d+)\ ?)+([XYZF](-?\d+\.\d+|\#\d+|\[[-+*/\[\]#\d]+\])\ ?)*
    )""",
    re.VERBOSE,
)
SIEMENS = re.compile(
    r"""PROC\ [A-Z_]+(\((VAR\ )?(INT|REAL)\ _\w+(,\ (INT|REAL)\ _\w+)*\))?\ SAVE\ DISPLOF|;.*|
    EXTERN\ [A-Z_]+\([A-Z ,]+\)|DEF\ (INT|REAL)\ _\w+(\[\d\])?(\ =\ -?\d+)?|RET|STOPRE|
    (IF|WHILE)\ .+(==|<>|<|>).+|ENDIF|ENDWHILE|D=_\w+|
    [_A-Z]+(\[[_A-Z\d]+\])?\ =\ [-+\d._A-Z$\[\]\ ]+|
    WRITE\(_ERR,\ "FUZZYCNC_PROBE_TXT",\ ("-?\d+\ -?[\d.]+"|<<\([-+_A-Z\d ]+\)<<"\ 0?"(<<_AT)?)\)|
    FUZZYCNC_TOUCH\(_MISSED(,\ -?[\d.]+){6}\)|
    (MEAS=1\ )?(G\d+\ ?)+(SUPA|D0)?(\ [XYZ]=[-\d._A-Z\[\]]+)*(\ F\d+\.\d)?""",
    re.VERBOSE,
)


@pytest.mark.parametrize('dialect', sorted(DIALECTS))
def test_no_name_makes_a_line_that_a_control_refuses(tmp_path, dialect):
    path = tmp_path / 'probe.yaml'
    path.write_text(FILE.replace('name: left', f'name: {"x" * 1000}'))
    for text in write_programs(read_plan(path), dialect).values():
        assert max(map(len, text.splitlines())) < 128


@pytest.mark.parametrize(('dialect', 'syntax'), [('fanuc', FANUC), ('siemens', SIEMENS)])
def test_other_controls_get_programs_of_their_syntax(plan, dialect, syntax):
    for name, text in write_programs(plan, dialect).items():
        lines = [line.strip() for line in text.splitlines()]
        wrong = [line for line in lines if not syntax.fullmatch(line)]
        assert not wrong, (name, wrong)
        # a label is there once, and a loop or a condition ends
        for label in re.findall(r'GOTO(\d+)', text):
            assert len(re.findall(rf'^N{label} ', text, re.M)) == 1
        for first, last in (('IF ', 'ENDIF'), ('WHILE ', 'ENDWHILE'), ('WHILE[', 'END1')):
            begun = sum(line.startswith(first) for line in lines)
            if dialect == 'siemens' or first == 'WHILE[':
                assert begun == lines.count(last)
        assert not re.search(r'\bG(10|92|54|43)\b|\$P_UIFR|\$TC_|#5[23]\d\d|#2\d{3}|L2', text)


@pytest.mark.parametrize(
    ('before', 'after', 'text'),
    [
        (
            'Z: [-150, -5]',
            'Z: [-141.2, -5]',
            'setter, Z: the end of the search: expected Z within',
        ),
        (
            'X: [0, 300]',
            'X: [33, 300]',
            'left, X: the way across: expected X within the box, 33 to',
        ),
        ('travel_height: -10', 'travel_height: -1', 'the way across: expected Z within the box'),
        ('travel_height: -10', 'travel_height: -120', 'expected a start below travel_height'),
        ('tip: 6', 'tip: 6\nback_off: 3', 'back_off: expected less than clearance'),
        ('diameter: 25', 'diameter: 0', 'expected a diameter of a sphere'),
        ('axes: X', 'axes: Z', 'expected some of XY, each once, for a ring but found Z'),
        ('face: Y-', 'face: Q', 'line 8'),
        ('name: setter', 'name: left', 'expected another name for each artefact'),
        ('at: [50, -40, -120]', 'at: [50, -40]', 'expected three coordinates'),
        ('box:', 'bix:', "expected the field 'box'"),
        ('diameter: 50', 'diameter: 2', 'a bore of over 10 mm, in which the tip and its way fit'),
        ('diameter: 50', 'diameter: 10', 'right: expected a bore of over 10 mm'),
    ],
)
def test_a_file_that_would_leave_its_box_is_refused(tmp_path, before, after, text):
    path = tmp_path / 'probe.yaml'
    assert before in FILE
    path.write_text(FILE.replace(before, after, 1))
    with pytest.raises(ParameterError, match=re.escape(text)):
        read_plan(path)


def test_a_plan_is_read_from_its_text_and_named_by_its_signature(plan, tmp_path):
    assert ProbePlan.from_json(plan.to_json()) == plan
    (tmp_path / 'probe.yaml').write_text(FILE.replace('tip: 6', 'tip: 6.001'))
    assert read_plan(tmp_path / 'probe.yaml').signature != plan.signature
    assert plan.channels == ('X', 'Y', 'Z', 'X right', 'Y block (1)', 'Z setter')
    for broken in ('{}', '[]', 'x', '{"places": 3}'):
        with pytest.raises(ValueError, match=r'expected|Expecting'):
            ProbePlan.from_json(broken)

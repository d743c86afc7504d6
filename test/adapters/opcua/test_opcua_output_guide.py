# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What docs/how-to/opcua-output.md shows: the control's program, an adapter of one's own."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from benches.component_bench import Bench
from benches.line_control import LineControl
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.adapters.opcua.control_file import read_control
from fuzzycnc_ros.adapters.opcua.opcua_bridge import OpcuaBridge, OpcuaBridgeConfig
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.records import Compensation, nanoseconds

GUIDE = (Path(__file__).parents[3] / 'docs' / 'how-to' / 'opcua-output.md').read_text(
    encoding='utf-8'
)
MICRON = 1e-6
CYCLE = 0.1


def block(language):
    """Return the only block of the guide in a language."""
    (found,) = re.findall(rf'```{language}\n(.*?)```', GUIDE, re.S)
    return found


class Program:
    """The structured text of the guide, turned into Python line by line."""

    KEYWORDS = ('VAR_INPUT', 'VAR_OUTPUT', 'VAR')

    def __init__(self):
        text = re.sub(r'\(\*.*?\*\)', '', block('iecst'), flags=re.S)
        text = text.partition('\n')[2].rpartition('END_FUNCTION_BLOCK')[0]
        declared, body = re.fullmatch(r'(.*END_VAR)(.*)', text, re.S).groups()
        self.values = {}
        for names, kind, value in re.findall(
            r'([\w, ]+?)\s*:\s*(BOOL|INT|LREAL)\s*(?::=\s*([-\w.+]+))?;', declared
        ):
            for name in names.split(','):
                start = {'BOOL': False, 'INT': 0, 'LREAL': 0.0}[kind]
                self.values[name.strip()] = float(value) if value else start
        self._code = compile(self._python(body), 'guide', 'exec')

    def _python(self, body):
        """Statements, IF with END_IF, comparisons and LIMIT are all that it has."""
        lines, depth = [], 0
        for line in (part.strip() for part in body.splitlines()):
            if line == 'END_IF':
                depth -= 1
                continue
            if not line:
                continue
            python = re.sub(r'\bAND\b', 'and', line.replace('<>', '!='))
            if match := re.fullmatch(r'IF (.*) THEN', python):
                lines.append(f'{"    " * depth}if {match[1]}:')
                depth += 1
                continue
            match = re.fullmatch(r'(\w+) := (.*);', python)
            assert match, line
            assert match[1] in self.values, line
            lines.append(f'{"    " * depth}{match[1]} = {match[2]}')
        assert depth == 0
        return '\n'.join(lines)

    def scan(self, **inputs):
        """Run it once."""
        assert set(inputs) <= set(self.values)
        self.values |= inputs
        exec(
            self._code, {'LIMIT': lambda low, value, high: max(low, min(value, high))}, self.values
        )


ERROR_LINES = {
    # Siemens, Extended Functions, K3: dK = K0 + tan b (P - P0), in mm
    'Sinumerik': lambda offset, slope, place, x: 1e-3 * (offset + slope * (1e3 * x - place)),
    # Beckhoff, P-AXIS-00272 to 00274: 0.1 um, um/m and 0.1 um
    'TwinCAT': lambda offset, slope, place, x: 1e-7 * offset + 1e-6 * slope * (x - 1e-7 * place),
}


@pytest.mark.parametrize('control', ERROR_LINES)
def test_what_controls_are_given_is_the_negative_of_their_error_line(control, tmp_path):
    """Signs and units of the page, put into the formulas of the makers."""
    whole = yaml.safe_load(re.findall(r'```yaml\n(.*?)```', GUIDE, re.S)[0])
    whole['state']['on'] = whole['state'].pop(True)  # this reader takes a bare one for a yes
    (text,) = re.findall(rf'```yaml\n# {control}\n(.*?)```', GUIDE, re.S)
    given = yaml.safe_load(text)
    given['axes']['X'] |= {'applied': 'ns=2;s=Comp.X.Applied', 'travel': [-100, 500]}
    file = tmp_path / 'control.yaml'
    file.write_text(yaml.safe_dump({**whole, **given}))
    found = read_control(file).variables
    line = {'offset': 12e-6, 'slope': 286e-6, 'reference_position': -0.1}
    written = [value / found[f'X.{name}'].scale for name, value in line.items()]
    for x in (-0.1, 0.0, 0.4):
        error = ERROR_LINES[control](*written, x)
        assert -error == pytest.approx(12e-6 + 286e-6 * (x + 0.1), rel=1e-9)


def test_no_variable_of_the_program_hides_a_function_or_another():
    """Names of structured text have no case."""
    names = [name.lower() for name in Program().values]
    assert len(set(names)) == len(names)
    assert not {'limit', 'and', 'if', 'real', 'int'} & set(names)


STEPS = st.tuples(
    st.sampled_from(['set', 'beat', 'silence', 'off', 'on', 'back', 'move']),
    st.integers(-100, 100),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(STEPS, max_size=25))
def test_program_of_the_guide_is_the_one_that_the_tests_run(steps):
    program, control = Program(), LineControl(1)
    control.watchdog = program.values['Watchdog']
    control.limit = MICRON * np.array([program.values['OffsetMax']])
    control.slew = MICRON * program.values['SlewMax']
    for step, number in steps:
        if step == 'set':
            control.offset = np.array([MICRON * number])
            control.slope = np.array([1e-6 * number])
            control.reference_position = np.array([1e-3 * number])
            control.valid_for = 2.0
            control.sequence = control.sequence % 5 + 1
        elif step == 'back':
            control.sequence = 0
        elif step in ('off', 'on'):
            control.on = step == 'on'
        elif step == 'move':
            control.position = np.array([1e-2 * number])
        control.heartbeat += step == 'beat'
        for _ in range(60 if step == 'silence' else 3):
            control.scan(CYCLE)
            program.scan(
                Enable=control.on,
                Sequence=control.sequence,
                Heartbeat=control.heartbeat,
                K0=control.offset[0] / MICRON,
                Slope=1e3 * control.slope[0],
                P0=1e3 * control.reference_position[0],
                ValidFor=control.valid_for,
                Position=1e3 * control.position[0],
                CycleTime=CYCLE,
            )
            assert program.values['Applied'] == pytest.approx(
                control.applied[0] / MICRON, abs=1e-9
            )
            assert program.values['Alive'] == control.alive
            assert program.values['Acknowledged'] == control.acknowledged


def in_force(**inputs):
    """Return the program with a set in force, and what it is scanned with."""
    program = Program()
    inputs = {
        **{'Enable': True, 'Heartbeat': 1, 'Sequence': 1, 'CycleTime': 0.001, 'ValidFor': 60.0},
        **{'K0': 10.0, 'Slope': 0.0, 'P0': 0.0, 'Position': 0.0, **inputs},
    }
    for _ in range(5000):
        program.scan(**inputs)
    return program, inputs


def test_program_follows_an_axis_that_moves_faster_than_its_ramp():
    """200 mm/s along 286 um/m are 57 um/s; what is asked for at a place goes at 20 um/s."""
    program, inputs = in_force(K0=-30.0, Slope=0.286)
    assert program.values['Applied'] == pytest.approx(-30.0)
    for step in range(1000):
        program.scan(**{**inputs, 'Position': 0.2 * (step + 1)})
        assert program.values['Applied'] == pytest.approx(-30.0 + 0.286 * 0.2 * (step + 1))
    program.scan(**{**inputs, 'Position': 0.0})  # it leaps, as when it is homed
    assert program.values['Applied'] == pytest.approx(27.2 - 0.02)


@pytest.mark.parametrize('written', range(4))
def test_half_a_set_is_never_in_force(written):
    """However many of its values stand, the set before is followed until the number comes."""
    program, inputs = in_force()
    new = [('K0', -40.0), ('Slope', 0.2), ('P0', 100.0), ('ValidFor', 0.01)]
    for heartbeat in range(2, 200):
        inputs |= {'Heartbeat': heartbeat, **dict(new[: written + 1])}
        program.scan(**inputs)
        assert program.values['Applied'] == pytest.approx(10.0)


def test_adapter_of_the_guide_carries_offsets():
    space = {}
    exec(block('python'), space)
    image = dict.fromkeys(
        ('offset', 'valid_for', 'sequence', 'heartbeat', 'applied', 'acknowledged'), 0.0
    ) | {'on': True, 'homed': True}
    control = LineControl(1)
    adapter = space['ImageControl'](image)
    bench = Bench(OpcuaBridge(OpcuaBridgeConfig(axes=('X',), slew_max=20e-6)))
    bridge = bench.component
    assert bench.request('activate').success
    time = 100.0

    def run(duration):
        nonlocal time
        for _ in range(round(duration / CYCLE)):
            time += CYCLE
            orders = bridge.orders
            status = adapter.read() if orders is None else adapter.write(orders)
            bench.emitted += bridge.observe(nanoseconds(time), status)
            if bridge.wants_control:
                adapter.claim()
                bridge.take_control()
            control.offset = MICRON * np.array([image['offset']])
            for name in ('valid_for', 'sequence', 'heartbeat'):
                setattr(control, name, image[name])
            control.scan(CYCLE)
            image['applied'] = control.applied[0] / MICRON
            image['acknowledged'] = control.acknowledged

    run(2.0)
    stamp = nanoseconds(time)
    bench.push(
        'compensation',
        Compensation(
            stamp=stamp,
            epoch=1,
            state=1,
            axis=('X',),
            offset=np.array([12e-6]),
            slope=np.zeros(1),
            reference_position=np.zeros(1),
            at_limit=np.zeros(1, bool),
            slewing=np.zeros(1, bool),
            valid_until=stamp + nanoseconds(60.0),
            source=('test',),
        ),
    )
    bench.emitted += bench.merger.advance(stamp)
    run(3.0)
    assert image['applied'] == pytest.approx(12.0, abs=0.02)
    last = bench.records('compensation_applied')[-1]
    assert last.status == OffsetStatus.FOLLOWING
    assert last.offset[0] == pytest.approx(12e-6, abs=2e-8)
    adapter.release()
    assert image['sequence'] == 0
    adapter.close()

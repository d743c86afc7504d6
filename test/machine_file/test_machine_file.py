# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Machine files: read, written, and what is wrong with them."""

import os
import re
from dataclasses import replace

import pytest

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.core.servo.built_in import BUILT_IN_AXES
from fuzzycnc_ros.core.units import DECLARED, si_value, written
from fuzzycnc_ros.machine_file.doubts import machine_doubts
from fuzzycnc_ros.machine_file.feeds import scheduler_parameters, simulated_loop
from fuzzycnc_ros.machine_file.listing import machine_values
from fuzzycnc_ros.machine_file.parameters import node_parameters, parameter_text
from fuzzycnc_ros.machine_file.reader import BUILT_IN, is_machine_file, read_machine_file
from fuzzycnc_ros.machine_file.writer import machine_text
from fuzzycnc_ros.simulation.servo.axes import simulated_axis

INI = """
[EMC]
MACHINE = old mill
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = inch
MAX_LINEAR_VELOCITY = 2.0
[AXIS_X]
MAX_VELOCITY = 4.0
MAX_ACCELERATION = 20.0
OFFSET_AV_RATIO = 0.25
MIN_LIMIT = -10
MAX_LIMIT = 10
[AXIS_Y]
MAX_VELOCITY = 3.0
MAX_LIMIT = 1e99
"""


@pytest.fixture
def machine(tmp_path):
    def read(text):
        path = tmp_path / 'machine.yaml'
        path.write_text(text)
        return read_machine_file(path)

    return read


@pytest.mark.parametrize('name', BUILT_IN)
def test_what_is_written_is_read_again(machine, name):
    known = read_machine_file(name)
    assert replace(machine(machine_text(known)), source={}) == replace(known, source={})


def test_files_that_state_a_backlash_of_the_identification_are_still_read(machine):
    text = 'axes:\n  X:\n    knowledge:\n      known_to: 30 Hz\n      backlash: 0 um\n'
    assert machine(text).axes['X'].knowledge.known_to == pytest.approx(30.0)


def test_built_in_machines_are_the_simulated_ones():
    lathe = read_machine_file('lathe').axes['X']
    assert replace(lathe, settings={}) == BUILT_IN_AXES['lathe']
    assert read_machine_file('ballscrew').axes['X'] == BUILT_IN_AXES['ballscrew']
    mill = read_machine_file('mill')
    assert simulated_loop(mill) == ContouringConfig()
    default = FeedrateSchedulerConfig()
    found = FeedrateSchedulerConfig(**scheduler_parameters(mill))
    assert found.machine_constant == pytest.approx(default.machine_constant, rel=2e-5)
    assert replace(found, machine_constant=default.machine_constant) == default


def test_units_and_plain_numbers_mean_the_same(machine):
    one = machine('axes: {Y: {limits: {velocity: 12 m/min, acceleration: 900 mm/s², load: 40 %}}}')
    other = machine('axes: {Y: {limits: {velocity: 0.2, acceleration: 0.9, load: 4e-1}}}')
    assert one.axes == other.axes
    assert one.axes['Y'].limits.velocity == 0.2
    assert one.source['axes.Y.limits.load'] == 'line 1'


@pytest.mark.parametrize('unit', sorted(DECLARED))
def test_written_numbers_are_read_as_they_were(unit):
    for value in (0.0, 1.0, -2.5, 3.3e-7, 123456.789):
        assert si_value(written(value, unit), unit) == pytest.approx(value, rel=1e-9)


def test_limits_of_linuxcnc(machine, tmp_path):
    (tmp_path / 'mill.ini').write_text(INI)
    found = machine(
        'linuxcnc: {ini: mill.ini}\naxes: {X: {limits: {acceleration: 0.3}}}\n'
        'path: {feed: 10 mm/s}'
    )
    assert found.name == 'old mill'
    x, y = found.axes['X'].limits, found.axes['Y'].limits
    assert x.velocity == pytest.approx(4.0 * 25.4e-3 * 0.75)  # the rest is kept for offsets
    assert x.acceleration == 0.3  # the machine file's own
    assert (x.travel_low, x.travel_high) == pytest.approx((-0.254, 0.254))
    assert y.velocity == pytest.approx(3.0 * 25.4e-3)
    assert y.travel_high == 0.25  # 1e99 is none
    assert found.path.velocity == pytest.approx(2.0 * 25.4e-3)
    source = {item.place: item.source for item in machine_values(found)}
    assert source['axes.X.limits.velocity'] == 'mill.ini'
    assert source['axes.X.limits.acceleration'] == 'line 2'
    assert source['axes.X.limits.jerk'] == 'default'
    assert source['loop.velocity_max'] == 'the limits above'


@pytest.mark.parametrize('constant', [5e-5, 2.15e-4, 1e-3])
def test_simulated_axes_have_the_measured_constant(machine, constant):
    found = machine(f'contour_constant: {{XY: {constant} s^2, XZ: 1e-5 s^2, YZ: 1e-5}}')
    assert found.machine_constant == constant
    assert simulated_loop(found).contour_constant == pytest.approx(constant)


def test_pairs_that_are_not_measured_are_those_of_the_loop(machine):
    assert machine('contour_constant: {XY: 1e-5}').machine_constant == pytest.approx(
        ContouringConfig().contour_constant
    )


def test_jerk_limits_reach_the_feeds(machine):
    found = scheduler_parameters(
        machine('axes: {X: {limits: {jerk: 50}}, Z: {limits: {velocity: 0.1}}}')
    )
    assert found['axis_jerk'] == (50.0, 50.0, 0.0)
    assert found['axis_velocity'] == (0.25, 0.1, 0.1)


def test_nodes_get_what_they_know():
    from fuzzycnc_ros.registry import COMPONENTS

    found = node_parameters(read_machine_file('mill'))
    for node, parameters in found.items():
        COMPONENTS[node].CONFIG(**parameters)
    assert '"/**/feedrate_scheduler"' in parameter_text(read_machine_file('mill'))


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('', ['empty file']),
        ('- 1', ['line 1', 'names and values']),
        ('axis: {}', ['line 1', 'unknown name axis', 'did you mean axes?']),
        ('path: {velocty: 1}', ['unknown name velocty', 'did you mean velocity?']),
        ('path:\n  velocity: 3 kg', ['line 2', 'path.velocity', 'mm/s', "'3 kg'"]),
        ('path:\n  velocity: fast', ['line 2', 'path.velocity', "'fast'"]),
        ('path:\n  velocity: -1', ['line 2', 'velocity = -1', 'm/s']),
        ('path:\n  velocity: .nan', ['line 2', 'velocity']),
        ('path:\n  velocity: [1]', ['line 2', 'velocity', 'expected float']),
        ('path: {velocity: 1, velocity: 2}', ['expected velocity once']),
        ('axes: {X: {plant: {mass: 1}}}', ['axes.X.plant.model', 'lags, mass', 'none']),
        ('axes: {X: {plant: {model: rubber}}}', ['lags, mass', 'rubber']),
        ('axes: {X: {plant: {model: mass, gain_factor: 2}}}', ['unknown name gain_factor']),
        ('axes: {X: {plant: {model: mass, mass: 3 m}}}', ['axes.X.plant.mass', 'kg']),
        ('axes: {"1 X": {}}', ['expected names such as X']),
        ('axes: {X: {limits: {travel_low: 1}}}', ['travel_high', 'travel_low = 1']),
        ('axes: {X: {controller: {name: 3}}}', ['expected a name', '3']),
        ('axes: {X: {controller: {settings: {a: b}}}}', ['settings.a', "'b'"]),
        ('contour_constant: {XX: 1e-4}', ['XY, XZ, YZ', 'XX']),
        ('contour_constant: {XY: 3}', ['1e-09 to 1 s^2']),
        ('contour_constant: {XY: yes}', ['expected a number', 'True']),
        ('loop: {position_gain: 9000}', ['line 1', 'position_gain']),
        ('linuxcnc: {ini: none.ini}', ['linuxcnc.ini', 'none.ini', 'nothing is there']),
        ('linuxcnc: {ini: 3}', ['expected a file', '3']),
        ('machine: &a 1\npath: *a', ['no references']),
    ],
)
def test_refusals_name_the_place(machine, text, said):
    with pytest.raises(ValueError, match=r'machine\.yaml') as error:
        machine(text)
    for word in said:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('[TRAJ]\nMAX_VELOCITY=1', ['LINEAR_UNITS']),
        ('[TRAJ]\nLINEAR_UNITS=furlong', ['line 2', 'furlong']),
        (
            '[TRAJ]\nLINEAR_UNITS=mm\nCOORDINATES=XYZ\n[AXIS_X]\nMAX_VELOCITY=fast',
            ['line 5', 'MAX_VELOCITY', "'fast'"],
        ),
    ],
)
def test_configurations_that_are_none(machine, tmp_path, text, said):
    (tmp_path / 'mill.ini').write_text(text)
    with pytest.raises(ValueError, match=r'mill\.ini') as error:
        machine('linuxcnc: {ini: mill.ini}')
    for word in said:
        assert word in str(error.value)


def test_a_drive_has_to_reach_what_it_is_asked_for(machine):
    text = machine_text(read_machine_file('ballscrew'))
    assert not machine_doubts(machine(text))
    fast = machine(text.replace('positioning_acceleration: 1.5 ', 'positioning_acceleration: 4 '))
    (doubt,) = machine_doubts(fast)
    assert 'more than the drive can give the mass, 3.7 m/s²' in doubt
    (doubt,) = machine_doubts(machine(text.replace('friction: 0.12', 'friction: 0.01')))
    assert 'less than the friction of the plant, 5.8 %' in doubt


def test_a_plant_is_simulated_with_changes():
    axis = read_machine_file('lathe').axes['X']
    assert simulated_axis(axis, direction=-1.0).config.linear().gain == -0.286
    with pytest.raises(ValueError, match='expected a parameter of the model lags'):
        simulated_axis(axis, mass=3.0)
    with pytest.raises(ValueError, match='limits alone'):
        simulated_axis(read_machine_file('mill').axes['X'])


def test_other_yaml_is_no_machine_file(tmp_path):
    path = tmp_path / 'other.yaml'
    path.write_text('feedrate_scheduler: {ros__parameters: {}}')
    assert not is_machine_file(path)
    assert is_machine_file('mill')
    assert not is_machine_file(tmp_path / 'missing')


@pytest.mark.parametrize(
    ('line', 'naming'),
    [
        ('OFFSET_AV_RATIO = -3', 'line 3: OFFSET_AV_RATIO: expected a share from 0 to below 1'),
        ('OFFSET_AV_RATIO = 1', 'line 3: OFFSET_AV_RATIO: expected a share from 0 to below 1'),
        ('OFFSET_AV_RATIO = nan', 'line 3: OFFSET_AV_RATIO: expected a number'),
        ('MAX_VELOCITY = 5_0', 'line 3: MAX_VELOCITY: expected a number'),
        ('MAX_VELOCITY = \N{ARABIC-INDIC DIGIT FIVE}', 'line 3: MAX_VELOCITY: expected a number'),
        ('MAX_VELOCITY = 0x10', 'line 3: MAX_VELOCITY: expected a number'),
        ('MAX_VELOCITY = -50', 'velocity = -0.05 is outside'),
        ('MAX_VELOCITY = 5e-324', 'velocity = 0.0 is outside'),
        ('MIN_LIMIT = 20\nMAX_LIMIT = 10', 'travel_high: expected more than travel_low'),
    ],
)
def test_hostile_limits_of_linuxcnc_are_refused_by_line(machine, tmp_path, line, naming):
    """A negative share for offsets would raise all limits."""
    text = f'[TRAJ]\n[AXIS_X]\n{line}\n[TRAJ]\nLINEAR_UNITS = mm\nCOORDINATES = X\n'
    (tmp_path / 'mill.ini').write_text(text, encoding='utf-8')
    with pytest.raises(ValueError, match=re.escape(naming)):
        machine('linuxcnc: {ini: mill.ini}')


def test_a_configuration_of_linuxcnc_has_lines_as_linuxcnc_reads_them(machine, tmp_path):
    text = '[EMC]\nMACHINE = a\u2028[TRAJ]\x85LINEAR_UNITS = inch\n[TRAJ]\nLINEAR_UNITS = mm\n'
    (tmp_path / 'mill.ini').write_text(f'{text}[AXIS_X]\nMAX_VELOCITY = 50\n', encoding='utf-8')
    assert machine('linuxcnc: {ini: mill.ini}').axes['X'].limits.velocity == pytest.approx(0.05)


def test_limits_in_files_that_a_configuration_of_linuxcnc_includes_count(machine, tmp_path):
    text = '#INCLUDE limits.inc\n[TRAJ]\nLINEAR_UNITS = mm\n'
    limits = tmp_path / 'limits.inc'
    limits.write_text('#INCLUDE limits.inc\n[AXIS_X]\nMAX_VELOCITY = 50\n')
    (tmp_path / 'mill.ini').write_text(text)
    assert machine('linuxcnc: {ini: mill.ini}').axes['X'].limits.velocity == pytest.approx(0.05)
    (tmp_path / 'mill.ini').write_text(2_000 * '#INCLUDE limits.inc\n' + text)
    limits.write_text(100 * '[AXIS_X]\n')
    with pytest.raises(ValueError, match=r'line \d+: #INCLUDE: expected .* 1 MB in all'):
        machine('linuxcnc: {ini: mill.ini}')
    limits.unlink()
    with pytest.raises(ValueError, match=r'line 1: #INCLUDE: .*limits\.inc'):
        machine('linuxcnc: {ini: mill.ini}')


@pytest.mark.parametrize('kind', ['pipe', 'device', 'folder'])
def test_what_is_no_file_is_no_configuration_of_linuxcnc(machine, tmp_path, kind):
    """A pipe would be waited for, and a device may have no end."""
    path = tmp_path / 'mill.ini'
    {
        'pipe': lambda: os.mkfifo(path),
        'device': lambda: path.symlink_to('/dev/zero'),
        'folder': path.mkdir,
    }[kind]()
    with pytest.raises(ValueError, match=r'mill\.ini: expected a'):
        machine('linuxcnc: {ini: mill.ini}')

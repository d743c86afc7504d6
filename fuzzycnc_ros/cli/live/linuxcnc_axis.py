# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of LinuxCNC under exported controllers: installed, checked, tried without hardware."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from fuzzycnc_ros.adapters.linuxcnc.axis_loop import PLANT, LoopController, axis_loop
from fuzzycnc_ros.adapters.linuxcnc.component import (
    install_component,
    installed_component,
    linuxcnc_version,
)
from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.simulation import Limits
from fuzzycnc_ros.cli.axes.servo_machine import (
    exported_controller,
    exported_plant,
    machine_axis,
    own_controller,
)
from fuzzycnc_ros.cli.live.linuxcnc_configuration import (
    Finding,
    coordinates_of,
    hal_files,
    joint_of,
)
from fuzzycnc_ros.core.machine.machine_data import AxisData, axis_hash
from fuzzycnc_ros.machine_file.linuxcnc_ini import read_sections
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.studies.servo.linuxcnc_bag import UNIT, write_axis_bag

MACHINE_FILE, HASH = 'FUZZYCNC_MACHINE_FILE', 'FUZZYCNC_MACHINE_HASH'
"""Entries of a joint's section: its machine file, and the hash of the axis in it."""
PINS = ('enable', 'command', 'command-deriv', 'feedback', 'output', 'machine-file')
"""Pins that have to be connected or set."""
UNITS = {'mm': UNIT, 'metric': UNIT, 'inch': 0.0254, 'imperial': 0.0254}
"""Length of LinuxCNC's units [m]."""
QUIET = 0.3
"""Noise of a sensor of which none is known, in counts."""
DIGITS = 8
"""Digits of a hash that HAL keeps."""

HAL = """\
# in the place of `loadrt pid` and of `addf pid.N.do-pid-calcs`, behind motion-controller:
loadrt {component}
addf {prefix} servo-thread
setp {prefix}.machine-file [JOINT_{joint}]{HASH}
setp {prefix}.unit {unit}
# in your nets {prefix} takes the place of pid.N: command, feedback, output, error
net {axis}-enable joint.{joint}.amp-enable-out => {prefix}.enable
net {axis}-command-deriv joint.{joint}.vel-cmd => {prefix}.command-deriv
net {axis}-fault {prefix}.fault => joint.{joint}.amp-fault-in
"""


class InstalledAxis(NamedTuple):
    """Axis whose controller was installed: the component, and lines for the INI and HAL files."""

    component: Path
    ini: list[str]
    hal: list[str]


def component_of(axis: str) -> str:
    """Return the name of the component of an axis."""
    return f'fuzzycnc_axis_{axis.lower()}'


def install_axis(ini: Path, file: str, axis: str, params: Path | None) -> InstalledAxis:
    """Export, build and install the controller of an axis.

    Raises
    ------
    ValueError
        If the configuration has no such axis, the machine file no controller for it, or LinuxCNC
        cannot be used.
    """
    _, axis, data = machine_axis(file, axis)
    joint, sections = joint_of(ini, axis), read_sections(ini)
    word = sections.get('TRAJ', {}).get('LINEAR_UNITS', ('mm', 0))[0].lower()
    if word not in UNITS:
        raise ValueError(f'{ini}: LINEAR_UNITS: expected mm or inch but found {word!r}')
    name = component_of(axis)
    text = exported_controller(file, axis, data, own_controller(data, params), params, 'hal', name)
    try:
        linuxcnc_version()
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder, f'{name}.comp')
            source.write_text(text)
            install_component(source)
        found = installed_component(name)
    except LinuxcncError as error:
        raise ValueError(str(error)) from error
    assert found is not None
    prefix = name.replace('_', '-')
    known = {'component': name, 'prefix': prefix, 'joint': joint, 'axis': axis.lower()}
    lines = HAL.format(**known, HASH=HASH, unit=UNITS[word]).splitlines()
    path = Path(file)
    lines_of_ini = [
        f'[JOINT_{joint}]{MACHINE_FILE} = {path.absolute() if path.exists() else file}',
        f'[JOINT_{joint}]{HASH} = 0x{axis_hash(axis, data)[:DIGITS]}',
    ]
    return InstalledAxis(found, lines_of_ini, lines)


def check_axes(ini: Path) -> Iterator[Finding]:
    """Look at every joint whose section names a machine file.

    Raises
    ------
    ValueError
        If the INI file cannot be read.
    """
    sections = read_sections(ini)
    for joint, axis in enumerate(coordinates_of(ini).replace(' ', '')):
        section = sections.get(f'JOINT_{joint}', {})
        if MACHINE_FILE not in section:
            continue
        given = section[MACHINE_FILE][0]
        file = str(ini.parent / given) if (ini.parent / given).exists() else given
        try:
            data = read_machine_file(file).axes.get(axis)
        except ValueError as error:
            yield Finding(f'axis {axis}', False, str(error))
            continue
        if data is None:
            yield Finding(f'axis {axis}', False, f'{file} has no axis {axis}')
            continue
        yield _export_of(ini, file, axis, data, section.get(HASH, ('', 0))[0])
        yield _connections(ini, axis)


def _export_of(ini: Path, file: str, axis: str, data: AxisData, noted: str) -> Finding:
    """Compare machine file, INI file and installed component."""
    what, name, wanted = f'axis {axis}', component_of(axis), axis_hash(axis, data)
    again = f'fuzzycnc linuxcnc install {ini} --machine-file {file} --axis {axis}'
    try:
        found = installed_component(name)
    except LinuxcncError as error:
        return Finding(what, False, str(error))
    if found is None:
        return Finding(what, False, f'{name} is not installed: {again}')
    exported = re.search(rb'machine file ([0-9a-f]{64})', found.read_bytes())
    if exported is None or exported[1].decode() != wanted:
        return Finding(what, False, f'{found} is exported from another state of {file}: {again}')
    if noted.lower() != f'0x{wanted[:DIGITS]}':
        text = f'{HASH}: expected 0x{wanted[:DIGITS]} but found {noted or "none"}: {again}'
        return Finding(what, False, text)
    return Finding(what, True, f'{found}, of {file}')


def _connections(ini: Path, axis: str) -> Finding:
    """Look for the pins of the component in the HAL files."""
    prefix = component_of(axis).replace('_', '-')
    text = '\n'.join(
        path.read_text(errors='replace')
        for path in (ini.parent / name for name in hal_files(ini))
        if path.exists()
    )
    lines = [line.partition('#')[0] for line in text.splitlines()]
    used = {found for line in lines for found in re.findall(rf'{prefix}\.([\w-]+)', line)}
    lacking = [pin for pin in PINS if pin not in used]
    if not any(re.search(rf'\baddf\s+{prefix}\s', line) for line in lines):
        return Finding(f'HAL {axis}', False, f'no `addf {prefix} servo-thread`')
    missing = ', '.join(f'{prefix}.{pin}' for pin in lacking)
    text = f'nothing is connected to {missing}' if missing else prefix
    return Finding(f'HAL {axis}', not lacking, text)


class AxisRun(NamedTuple):
    """Run of an axis in LinuxCNC: its controller, and its following error [m]."""

    controller: str
    largest: float
    rms: float


def drive_axis(
    file: str, axis: str, controller: str, params: Path | None, program: str | None, out: Path
) -> AxisRun:
    """Move a simulated axis in LinuxCNC's servo thread, and write a bag.

    Raises
    ------
    ValueError
        If the machine file has no such axis, or LinuxCNC cannot be used or ends the program.
    """
    machine, axis, data = machine_axis(file, axis)
    chosen = controller or own_controller(data, params)
    name = 'fuzzycnc_loop_axis'
    source = exported_controller(file, axis, data, chosen, params, 'hal', name)
    plant, limits = data.known_plant(), data.limits
    own = LoopController(name, source, {'machine-file': f'0x{axis_hash(axis, data)[:DIGITS]}'})
    velocity, acceleration, _ = limits.positioning
    allowed = Limits(
        *(one / UNIT for one in (velocity, acceleration, limits.travel_low, limits.travel_high))
    )
    try:
        with axis_loop(
            [own],
            exported_plant(file, axis, data, PLANT),
            allowed,
            ('feedback', 'output', 'position', 'fault-code'),
            # Without any noise a loop may settle in a pattern that no real sensor shows.
            max(plant.noise, QUIET * plant.count),
        ) as loop:
            loop.ready()
            loop.run_program(program or way_there_and_back(allowed))
            samples = loop.samples()
    except LinuxcncError as error:
        raise ValueError(str(error)) from error
    samples = {name.removesuffix('-0'): values for name, values in samples.items()}
    codes = samples['fault-code'][samples['fault-code'] != 0.0]
    if len(codes):
        raise ValueError(f'axis {axis}: {name} gave up with the fault {codes[0]:.0f}')
    write_axis_bag(out, machine, axis, chosen, samples)
    enabled = samples['enable'][1:] > 0.0
    left = UNIT * (samples['command'][:-1] - samples['position'][1:])[enabled]
    return AxisRun(chosen, float(abs(left).max()), float((left @ left / len(left)) ** 0.5))


def way_there_and_back(limits: Limits) -> str:
    """Return a part program of short and long ways within the travel, with rests."""
    middle, half = 0.5 * (limits.low + limits.high), 0.5 * (limits.high - limits.low)
    ways = [middle + share * half for share in (0.2, 0.201, -0.3, -0.3001, 0.0)]
    moves = [f'G0 X{way:.6f}\nG4 P0.2' for way in ways]
    feeds = [f'G1 X{middle + way:.6f} F600' for way in (1.0, 0.0)]
    return '\n'.join(['G21 G90 G64 P0.001', *feeds, *moves, 'M2', ''])

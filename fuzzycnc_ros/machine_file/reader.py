# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From a machine file to machine data; every complaint names file, line and place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path

from fuzzycnc_ros.core.machine.knowledge import AxisKnowledge
from fuzzycnc_ros.core.machine.machine_data import (
    PLANTS,
    AxisData,
    AxisLimits,
    MachineData,
    PathLimits,
    PlantConfig,
)
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.files.yaml_file import Entry, YamlReading, compose
from fuzzycnc_ros.machine_file.linuxcnc_ini import LinuxcncLimits, read_linuxcnc_ini

BUILT_IN = ('mill', 'lathe', 'ballscrew')
"""Machines that come with the package, by name."""

FAULTS = frozenset(
    {
        'gain_factor', 'mass_factor', 'friction_factor', 'load', 'load_time', 'counts_lost',
        'count_loss_time', 'count_factor', 'count_change_time', 'dropout_time',
        'dropout_duration', 'seed', 'substeps',
    }
)  # fmt: skip
"""Parameters of plants that no machine file has: faults of a simulation, and its own."""

SECTIONS = ('machine', 'linuxcnc', 'axes', 'path', 'loop', 'contour_constant')
"""Names at the top of a machine file."""

_WANTED = 'a machine file'


def built_in_path(name: str) -> Path:
    """Return the file of a machine that comes with the package."""
    return Path(str(files('fuzzycnc_ros.machine_file') / 'built_in' / f'{name}.yaml'))


def is_machine_file(path: Path | str) -> bool:
    """Return True for a machine file, by its first key, and for a built-in machine's name."""
    import yaml

    if str(path) in BUILT_IN:
        return True
    try:
        root = compose(Path(path), _WANTED)
    except ValueError:
        return False  # whoever reads it says why
    return isinstance(root, yaml.MappingNode) and any(
        key.value in SECTIONS for key, _ in root.value
    )


def read_machine_file(path: Path | str) -> MachineData:
    """Read a machine file, or a machine that comes with the package by its name.

    Parameters
    ----------
    path : Path or str
        A file, or one of `BUILT_IN`; a file of that name in the folder comes first.

    Returns
    -------
    MachineData
        What it says; `source` has where each value comes from.

    Raises
    ------
    ValueError
        If it is no machine file; the message names file, line and place.
    """
    place = Path(path)
    if str(path) in BUILT_IN and not place.exists():
        place = built_in_path(str(path))
    reading = YamlReading(place, _WANTED)
    found = reading.top()
    reading.known(found, SECTIONS, _WANTED)
    ini = _ini(reading, found)
    name = str(reading.value(found['machine'])) if 'machine' in found else ini.name or place.stem
    axes = dict(_axes(reading, found, ini))
    path_limits = reading.config(
        PathLimits, reading.section(found, 'path'), 'path', given=ini.path
    )
    moving = MachineData(axes=axes, path=path_limits)
    loop = reading.config(
        ContouringConfig,
        reading.section(found, 'loop'),
        'loop',
        given={
            'velocity_max': max(moving.limits('velocity')),
            'acceleration_max': min(moving.limits('acceleration')),
            'path_acceleration_max': path_limits.acceleration,
        },
    )
    for limit in ('velocity_max', 'acceleration_max', 'path_acceleration_max'):
        reading.source.setdefault(f'loop.{limit}', 'the limits above')
    constant = _constants(reading, reading.section(found, 'contour_constant'))
    try:
        return MachineData(
            name=name,
            axes=axes,
            path=path_limits,
            loop=loop,
            contour_constant=constant,
            source=reading.source,
        )
    except ValueError as error:
        raise reading.wrong(found['contour_constant'].line, 'machine', str(error)) from error


def _ini(reading: YamlReading, found: Mapping[str, Entry]) -> LinuxcncLimits:
    """Return the limits of the controller's own configuration."""
    section = reading.section(found, 'linuxcnc')
    reading.known(section, ('ini',), 'linuxcnc')
    if 'ini' not in section:
        return LinuxcncLimits('', {}, {})
    entry = section['ini']
    text = reading.text(entry, 'linuxcnc.ini', 'a file')
    ini = Path(text).expanduser()
    ini = ini if ini.is_absolute() else reading.path.parent / ini
    try:
        limits = read_linuxcnc_ini(ini)
    except ValueError as error:
        raise reading.wrong(entry.line, 'linuxcnc.ini', str(error)) from error
    reading.source['linuxcnc.ini'] = text
    for axis, values in limits.axes.items():
        reading.source.update({f'axes.{axis}.limits.{name}': ini.name for name in values})
    reading.source.update({f'path.{name}': ini.name for name in limits.path})
    return limits


def is_axis_name(name: str) -> bool:
    """Return True if a name is one of an axis: a letter, and up to seven letters and digits."""
    return 0 < len(name) <= 8 and name.isalnum() and name[0].isalpha()


def _axes(
    reading: YamlReading, found: Mapping[str, Entry], ini: LinuxcncLimits
) -> Iterator[tuple[str, AxisData]]:
    sections = reading.section(found, 'axes')
    for axis in dict.fromkeys([*sections, *ini.axes]):
        place = f'axes.{axis}'
        if not is_axis_name(axis):
            raise reading.wrong(
                sections[axis].line,
                'axes',
                f'expected names such as X of letters and digits but found {axis!r}',
            )
        section = reading.mapping(sections[axis], place) if axis in sections else {}
        reading.known(section, ('limits', 'plant', 'knowledge', 'controller'), place)
        limits = reading.config(
            AxisLimits,
            reading.section(section, 'limits', place),
            f'{place}.limits',
            given=ini.axes.get(axis),
        )
        plant = reading.section(section, 'plant', place)
        known = reading.section(section, 'knowledge', place)
        known.pop('backlash', None)  # files of `machine identify` had it, always 0
        knowledge = reading.config(AxisKnowledge, known, f'{place}.knowledge')
        controller, settings = _controller(reading, section, place)
        yield (
            axis,
            AxisData(
                limits=limits,
                plant=_plant(reading, section, plant, f'{place}.plant') if plant else None,
                knowledge=knowledge,
                controller=controller,
                settings=settings,
            ),
        )


def _plant(
    reading: YamlReading, section: Mapping[str, Entry], found: dict[str, Entry], place: str
) -> PlantConfig:
    model = found.pop('model', None)
    name = reading.value(model) if model is not None else None
    if not isinstance(name, str) or name not in PLANTS:
        line = section['plant'].line if model is None else model.line
        raise reading.wrong(
            line,
            f'{place}.model',
            f'expected one of {", ".join(PLANTS)} but found {"none" if model is None else name}',
        )
    reading.source[f'{place}.model'] = f'line {model.line}' if model else ''
    return reading.config(PLANTS[name], found, place, without=FAULTS)


def _controller(
    reading: YamlReading, section: Mapping[str, Entry], place: str
) -> tuple[str, dict[str, float]]:
    """Return the controller's name and its settings."""
    found = reading.section(section, 'controller', place)
    place = f'{place}.controller'
    reading.known(found, ('name', 'settings'), place)
    name = reading.text(found['name'], place, 'a name') if 'name' in found else ''
    settings = {
        key: reading.number(entry, f'{place}.settings.{key}')
        for key, entry in reading.section(found, 'settings', place).items()
    }
    return name, settings


def _constants(reading: YamlReading, found: Mapping[str, Entry]) -> dict[str, float]:
    constant: dict[str, float] = {}
    for pair, entry in found.items():
        place = f'contour_constant.{pair}'
        constant[pair] = reading.number(entry, place, 's^2')
        reading.source[place] = f'line {entry.line}'
    return constant

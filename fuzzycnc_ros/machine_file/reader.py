# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From a machine file to machine data; every complaint names file, line and place."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from fuzzycnc_ros.bags.yaml_file import compose, construct
from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.machine.machine_data import (
    PLANTS,
    AxisData,
    AxisLimits,
    MachineData,
    PathLimits,
    PlantConfig,
)
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.core.names import repeated_names
from fuzzycnc_ros.machine_file.linuxcnc_ini import LinuxcncLimits, read_linuxcnc_ini
from fuzzycnc_ros.machine_file.units import si_value

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

SomeConfig = TypeVar('SomeConfig', bound=Config)


class _Entry(NamedTuple):
    line: int
    node: Any


@dataclass
class _Reading:
    path: Path
    source: dict[str, str] = field(default_factory=dict)

    def wrong(self, line: int, place: str, message: str) -> ValueError:
        return ValueError(f'{self.path}: line {line}: {place}: {message}')

    def mapping(self, entry: _Entry, place: str) -> dict[str, _Entry]:
        """Return what a mapping holds by name; refuses names that come twice."""
        import yaml

        if not isinstance(entry.node, yaml.MappingNode):
            raise self.wrong(entry.line, place, 'expected names and values but found neither')
        pairs = [
            # A bare Y is true in YAML 1.1; its text is the axis.
            (str(key.value), _Entry(key.start_mark.line + 1, value))
            for key, value in entry.node.value
        ]
        for twice in repeated_names(name for name, _ in pairs):
            line = [item.line for name, item in pairs if name == twice][1]
            raise self.wrong(line, place, f'expected {twice} once but found it again')
        return dict(pairs)

    def value(self, entry: _Entry) -> Any:
        return construct(self.path, entry.node)

    def known(self, found: Mapping[str, _Entry], names: tuple[str, ...], place: str) -> None:
        for name, entry in found.items():
            if name not in names:
                near = difflib.get_close_matches(name, names, 1)
                meant = f'; did you mean {near[0]}?' if near else f'; known: {", ".join(names)}'
                raise self.wrong(entry.line, place, f'unknown name {name}{meant}')

    def config(
        self,
        kind: type[SomeConfig],
        found: Mapping[str, _Entry],
        place: str,
        *,
        without: frozenset[str] = frozenset(),
        given: Mapping[str, float] | None = None,
    ) -> SomeConfig:
        """Return a configuration from a section, `given` where the section says nothing."""
        items = {item.name: item for item in fields(kind) if item.name not in without}
        self.known(found, tuple(items), place)
        values: dict[str, Any] = dict(given or {})
        for name, entry in found.items():
            item = items[name]
            raw = self.value(entry)
            if isinstance(item.default, (int, float)) and not isinstance(item.default, bool):
                try:
                    raw = si_value(raw, item.metadata['unit'])
                except ValueError as error:
                    raise self.wrong(entry.line, f'{place}.{name}', str(error)) from error
            values[name] = raw
            self.source[f'{place}.{name}'] = f'line {entry.line}'
        try:
            return kind(**values)
        except ValueError as error:
            text = str(error)
            named = next((n for n in values if text.startswith((f'{n}:', f'{n} '))), '')
            line = (
                found[named].line
                if named in found
                else min((entry.line for entry in found.values()), default=1)
            )
            raise self.wrong(line, place, text) from error


def built_in_path(name: str) -> Path:
    """Return the file of a machine that comes with the package."""
    return Path(str(files('fuzzycnc_ros.machine_file') / 'built_in' / f'{name}.yaml'))


def is_machine_file(path: Path | str) -> bool:
    """Whether a file says at its top what machine files do, or is a built-in machine's name."""
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
    root = compose(place, _WANTED)
    if root is None:
        raise ValueError(f'{place}: expected {_WANTED} but found an empty file')
    reading = _Reading(place)
    found = reading.mapping(_Entry(1, root), _WANTED)
    reading.known(found, SECTIONS, _WANTED)
    ini = _ini(reading, found)
    name = str(reading.value(found['machine'])) if 'machine' in found else ini.name or place.stem
    axes = dict(_axes(reading, found, ini))
    path_limits = reading.config(
        PathLimits, _section(reading, found, 'path'), 'path', given=ini.path
    )
    moving = MachineData(axes=axes, path=path_limits)
    loop = reading.config(
        ContouringConfig,
        _section(reading, found, 'loop'),
        'loop',
        given={
            'velocity_max': max(moving.limits('velocity')),
            'acceleration_max': min(moving.limits('acceleration')),
            'path_acceleration_max': path_limits.acceleration,
        },
    )
    for limit in ('velocity_max', 'acceleration_max', 'path_acceleration_max'):
        reading.source.setdefault(f'loop.{limit}', 'the limits above')
    constant = _constants(reading, _section(reading, found, 'contour_constant'))
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


def _section(reading: _Reading, found: Mapping[str, _Entry], name: str) -> dict[str, _Entry]:
    return reading.mapping(found[name], name) if name in found else {}


def _ini(reading: _Reading, found: Mapping[str, _Entry]) -> LinuxcncLimits:
    """Return the limits of the controller's own configuration."""
    section = _section(reading, found, 'linuxcnc')
    reading.known(section, ('ini',), 'linuxcnc')
    if 'ini' not in section:
        return LinuxcncLimits('', {}, {})
    entry = section['ini']
    text = reading.value(entry)
    if not isinstance(text, str):
        raise reading.wrong(entry.line, 'linuxcnc.ini', f'expected a file but found {text!r}')
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
    """Whether a name is one of an axis: a letter, and up to seven letters and digits."""
    return 0 < len(name) <= 8 and name.isalnum() and name[0].isalpha()


def _axes(
    reading: _Reading, found: Mapping[str, _Entry], ini: LinuxcncLimits
) -> Iterator[tuple[str, AxisData]]:
    sections = _section(reading, found, 'axes')
    for axis in dict.fromkeys([*sections, *ini.axes]):
        place = f'axes.{axis}'
        if not is_axis_name(axis):
            raise reading.wrong(
                sections[axis].line,
                'axes',
                f'expected names such as X of letters and digits but found {axis!r}',
            )
        section = reading.mapping(sections[axis], place) if axis in sections else {}
        reading.known(section, ('limits', 'plant', 'controller'), place)
        limits = reading.config(
            AxisLimits,
            _inside(reading, section, 'limits', place),
            f'{place}.limits',
            given=ini.axes.get(axis),
        )
        plant = _inside(reading, section, 'plant', place)
        controller, settings = _controller(reading, section, place)
        yield (
            axis,
            AxisData(
                limits=limits,
                plant=_plant(reading, section, plant, f'{place}.plant') if plant else None,
                controller=controller,
                settings=settings,
            ),
        )


def _inside(
    reading: _Reading, section: Mapping[str, _Entry], name: str, place: str
) -> dict[str, _Entry]:
    return reading.mapping(section[name], f'{place}.{name}') if name in section else {}


def _plant(
    reading: _Reading, section: Mapping[str, _Entry], found: dict[str, _Entry], place: str
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
    reading: _Reading, section: Mapping[str, _Entry], place: str
) -> tuple[str, dict[str, float]]:
    """Return the controller's name and its settings."""
    found = _inside(reading, section, 'controller', place)
    place = f'{place}.controller'
    reading.known(found, ('name', 'settings'), place)
    name = reading.value(found['name']) if 'name' in found else ''
    if not isinstance(name, str):
        raise reading.wrong(found['name'].line, place, f'expected a name but found {name!r}')
    settings: dict[str, float] = {}
    for key, entry in _inside(reading, found, 'settings', place).items():
        try:
            settings[key] = float(reading.value(entry))  # 1e-3 is text in YAML 1.1
        except (TypeError, ValueError, OverflowError):
            raise reading.wrong(
                entry.line,
                f'{place}.settings.{key}',
                f'expected a number but found {reading.value(entry)!r}',
            ) from None
    return name, settings


def _constants(reading: _Reading, found: Mapping[str, _Entry]) -> dict[str, float]:
    constant: dict[str, float] = {}
    for pair, entry in found.items():
        try:
            value = si_value(reading.value(entry), 's^2')
        except ValueError as error:
            raise reading.wrong(entry.line, f'contour_constant.{pair}', str(error)) from error
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise reading.wrong(
                entry.line, f'contour_constant.{pair}', f'expected a number but found {value!r}'
            )
        constant[pair] = float(value)
        reading.source[f'contour_constant.{pair}'] = f'line {entry.line}'
    return constant

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""From machine data to the text of a machine file, units and meanings included."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import Field, fields
from typing import Any

from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.machine.machine_data import NOTHING_KNOWN, MachineData
from fuzzycnc_ros.core.units import written
from fuzzycnc_ros.machine_file.reader import FAULTS

_HEADER = """\
# A machine file: the description of a machine.  `fuzzycnc machine check` reads it, and
# `fuzzycnc machine show` prints it with where each value comes from.  Plain numbers are in SI
# units; omitted entries have defaults.
"""

_COMMENT_COLUMN = 44


def machine_text(
    machine: MachineData,
    *,
    ini: str = '',
    about: str = '',
    without: frozenset[str] = frozenset(),
) -> str:
    """Return the machine file of some machine data; read again it gives them to ten digits.

    Parameters
    ----------
    machine : MachineData
        What is known.
    ini : str
        LinuxCNC configuration that the file refers to; empty for none.
    about : str
        Lines of comment at the top: where the data come from.
    without : frozenset of str
        Places that are left out, such as `axes.X.limits.velocity`: the configuration has them.
    """
    lines = [_HEADER.rstrip('\n')]
    lines += [f'# {line}'.rstrip() for line in about.splitlines()]
    lines.append(f'machine: {_text(machine.name)}')
    if ini:
        lines += ['linuxcnc:', f'  ini: {_text(ini)}']
    if machine.axes:
        lines.append('axes:')
    for name, axis in machine.axes.items():
        lines += [f'  {_text(name)}:', '    limits:']
        lines += _section(axis.limits, 6, f'axes.{name}.limits', without)
        if axis.plant is not None:
            lines += ['    plant:', f'      model: {axis.model}']
            lines += _section(axis.plant, 6, '', FAULTS)
        if axis.knowledge != NOTHING_KNOWN:
            lines.append('    knowledge:')
            lines += _section(axis.knowledge, 6, '', frozenset())
        if axis.controller or axis.settings:
            lines.append('    controller:')
            if axis.controller:
                lines.append(f'      name: {axis.controller}')
            if axis.settings:
                lines.append('      settings:')
                lines += [f'        {key}: {value!r}' for key, value in _plain(axis.settings)]
    lines += ['path:', *_section(machine.path, 2, 'path', without)]
    lines += ['loop:', *_section(machine.loop, 2, 'loop', without)]
    if machine.contour_constant:
        lines.append('contour_constant:')
        lines += [
            f'  {pair}: {written(value, "s^2")}'
            for pair, value in machine.contour_constant.items()
        ]
    return '\n'.join(lines) + '\n'


def _section(config: Config, indent: int, place: str, without: frozenset[str]) -> Iterator[str]:
    """Yield the lines of a configuration, each with its meaning."""
    for item in fields(config):
        if (f'{place}.{item.name}' if place else item.name) in without:
            continue
        text = f'{" " * indent}{item.name}: {_value(item, getattr(config, item.name))}'
        yield f'{text:<{_COMMENT_COLUMN}}  # {item.metadata["doc"]}'


def _value(item: Field[Any], value: Any) -> Any:
    if isinstance(value, float):
        return written(value, item.metadata['unit'])
    return _text(value) if isinstance(value, str) else value


def _plain(settings: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    for key, value in settings.items():
        yield key, float(value)


def _text(value: str) -> str:
    """Return a text so that YAML reads it as one."""
    import json

    plain = value.replace('_', '').isalnum() and value[:1].isalpha()
    words = {'y', 'n', 'yes', 'no', 'true', 'false', 'on', 'off', 'null'}
    return value if plain and value.lower() not in words else json.dumps(value)

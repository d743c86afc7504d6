# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Machine data value by value: place, value, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, NamedTuple

from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.machine.machine_data import NOTHING_KNOWN, MachineData
from fuzzycnc_ros.core.units import written
from fuzzycnc_ros.machine_file.reader import FAULTS


class MachineValue(NamedTuple):
    """One value: its place in the file, the value in SI, as text, and its source."""

    place: str
    value: Any
    text: str
    source: str


def machine_values(machine: MachineData) -> list[MachineValue]:
    """Return all values of machine data in the order of the file; defaults are marked so."""
    return list(_values(machine))


def _values(machine: MachineData) -> Iterator[MachineValue]:
    for name, axis in machine.axes.items():
        place = f'axes.{name}'
        yield from _section(machine, axis.limits, f'{place}.limits')
        if axis.plant is not None:
            source = machine.source.get(f'{place}.plant.model', '')
            yield MachineValue(f'{place}.plant.model', axis.model, axis.model, source)
            yield from _section(machine, axis.plant, f'{place}.plant', FAULTS)
        if axis.knowledge != NOTHING_KNOWN:
            yield from _section(machine, axis.knowledge, f'{place}.knowledge')
        if axis.controller:
            yield _plain(machine, f'{place}.controller.name', axis.controller)
        for key, value in axis.settings.items():
            yield _plain(machine, f'{place}.controller.settings.{key}', value)
    yield from _section(machine, machine.path, 'path')
    yield from _section(machine, machine.loop, 'loop')
    for pair, constant in machine.contour_constant.items():
        place = f'contour_constant.{pair}'
        yield MachineValue(place, constant, str(written(constant, 's^2')), _source(machine, place))


def _section(
    machine: MachineData, config: Config, place: str, without: frozenset[str] = frozenset()
) -> Iterator[MachineValue]:
    for item in fields(config):
        if item.name in without:
            continue
        value = getattr(config, item.name)
        text = str(written(value, item.metadata['unit']) if isinstance(value, float) else value)
        where = f'{place}.{item.name}'
        yield MachineValue(where, value, text, _source(machine, where))


def _plain(machine: MachineData, place: str, value: Any) -> MachineValue:
    return MachineValue(place, value, str(value), _source(machine, place))


def _source(machine: MachineData, place: str) -> str:
    return machine.source.get(place, 'default')

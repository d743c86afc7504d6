# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of a machine file as a list of texts: what a node's parameters carry of them.

A run is repeated from its parameters alone, so they hold the data, not the name of a file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any

from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.machine.machine_data import PLANTS, AxisData, AxisLimits

NO_MODEL = 'none'
"""Model of an axis of which only the limits are known."""


def axis_texts(axes: Mapping[str, AxisData]) -> tuple[str, ...]:
    """Return axes as texts such as `X:plant.gain:0.31`; `parse_axis_texts` reads them exactly.

    Parameters
    ----------
    axes : mapping of str to AxisData
        Axes by name.

    Returns
    -------
    tuple of str
        The model of each axis, and what differs from the defaults of model and limits; in SI.

    Examples
    --------
    >>> axis_texts({'X': AxisData(limits=AxisLimits(load=0.2), controller='pid')})
    ('X:model:none', 'X:limits.load:0.2', 'X:controller:pid')
    """
    return tuple(
        f'{axis}:{key}:{value}' for axis, data in axes.items() for key, value in _entries(data)
    )


def parse_axis_texts(name: str, texts: Iterable[str]) -> dict[str, AxisData]:
    """Return the axes that such texts describe, in the order given.

    Parameters
    ----------
    name : str
        Parameter that they come from, for the message.
    texts : iterable of str
        As `axis_texts` returns them.

    Raises
    ------
    ValueError
        If a text is none of these, or a value is unknown or out of its bounds.

    Examples
    --------
    >>> axes = parse_axis_texts('axis_data', ['X:model:lags', 'X:plant.gain:0.31'])
    >>> axes['X'].plant.gain
    0.31
    """
    found: dict[str, dict[str, str]] = {}
    for text in texts:
        axis, _, rest = text.partition(':')
        key, sign, value = rest.partition(':')
        entries = found.setdefault(axis, {})
        if not (axis and key and sign) or key in entries:
            raise ValueError(
                f'{name}: expected <axis>:<name>:<value>, each once, such as X:plant.gain:0.31, '
                f'but found {text!r}'
            )
        entries[key] = value
    return {axis: _axis_data(f'{name}: {axis}', entries) for axis, entries in found.items()}


def _entries(data: AxisData) -> Iterator[tuple[str, Any]]:
    """Yield what is to be said of an axis, by name."""
    yield 'model', data.model or NO_MODEL
    sections: dict[str, Config | None] = {'limits': data.limits, 'plant': data.plant}
    for section, config in sections.items():
        for item in fields(config) if config is not None else ():
            value = getattr(config, item.name)
            if value != item.default:
                yield f'{section}.{item.name}', value
    if data.controller:
        yield 'controller', data.controller
    for key, value in data.settings.items():
        yield f'settings.{key}', value


def _axis_data(place: str, entries: Mapping[str, str]) -> AxisData:
    """Return the axis of its entries; a refusal begins with the place."""
    model = entries.get('model', NO_MODEL)
    if model not in (*PLANTS, NO_MODEL):
        raise ValueError(
            f'{place}:model: expected one of {", ".join(PLANTS)}, {NO_MODEL} but found {model!r}'
        )
    kinds: dict[str, type[Config]] = {'limits': AxisLimits}
    if model in PLANTS:
        kinds['plant'] = PLANTS[model]
    defaults = {
        section: {item.name: item.default for item in fields(kind)}
        for section, kind in kinds.items()
    }
    values: dict[str, dict[str, Any]] = {section: {} for section in kinds}
    settings: dict[str, float] = {}
    for entry, text in entries.items():
        section, _, key = entry.partition('.')
        if key in defaults.get(section, {}):
            values[section][key] = _value(f'{place}:{entry}', text, defaults[section][key])
        elif section == 'settings' and key:
            settings[key] = _value(f'{place}:{entry}', text, 0.0)
        elif entry not in ('model', 'controller'):
            raise ValueError(
                f'{place}: expected model, controller, settings.<name> or a name among '
                f'{", ".join(f"{section}.<name>" for section in kinds)} but found {entry!r}'
            )
    try:
        return AxisData(
            limits=AxisLimits(**values['limits']),
            plant=PLANTS[model](**values['plant']) if model in PLANTS else None,
            controller=entries.get('controller', ''),
            settings=settings,
        )
    except ValueError as error:
        raise ValueError(f'{place}: {error}') from error


def _value(place: str, text: str, default: Any) -> Any:
    """Return a value in the type of its default."""
    try:
        return type(default)(text)
    except ValueError:
        raise ValueError(f'{place}: expected a number but found {text!r}') from None

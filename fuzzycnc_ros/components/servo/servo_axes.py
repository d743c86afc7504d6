# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Driven axes as parameters name them: `X:lathe`, and their plants with faults.

An axis of a machine file is named `X:machine_file`; its data are parameters, too.
"""

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, PlantConfig, parse_axis_texts
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis, LatheAxis, SimulatedAxis

FROM_FILE = 'machine_file'
"""Model of an axis whose data come from a machine file."""

MODELS = ('lathe', 'ballscrew', FROM_FILE)
"""Models of an axis: the lathe of Long et al. (2014), the ball screw of the EMPS benchmark, and
that of a machine file."""

_CONFIGS: Mapping[str, type[LatheAxisConfig] | type[BallscrewAxisConfig]] = MappingProxyType(
    {'lathe': LatheAxisConfig, 'ballscrew': BallscrewAxisConfig}
)


def parse_axes(name: str, texts: Iterable[str]) -> dict[str, str]:
    """Return the model of each axis, in the order given.

    Parameters
    ----------
    name : str
        Parameter that they come from, for the message.
    texts : iterable of str
        Axes as `X:lathe`.

    Raises
    ------
    ValueError
        If a text is no axis and model, or an axis occurs twice.

    Examples
    --------
    >>> parse_axes('axes', ['X:lathe', 'Z:ballscrew'])
    {'X': 'lathe', 'Z': 'ballscrew'}
    """
    found: dict[str, str] = {}
    for text in texts:
        axis, _, model = text.partition(':')
        if not axis or model not in MODELS or axis in found:
            raise ValueError(
                f'{name}: expected axes, each once, as X:{MODELS[0]}, of the models '
                f'{", ".join(MODELS)}, but found {text!r}'
            )
        found[axis] = model
    return found


def file_axes(name: str, axes: Mapping[str, str], texts: Iterable[str]) -> dict[str, AxisData]:
    """Return the data of those axes that are of a machine file.

    Parameters
    ----------
    name : str
        Parameter that names the axes, for the message.
    axes : mapping of str to str
        Model of each axis.
    texts : iterable of str
        Axes of the machine file, the parameter `axis_data`.

    Raises
    ------
    ValueError
        If a text is not understood, or the file lacks an axis or its model.
    """
    known = parse_axis_texts('axis_data', texts)
    wanted = [axis for axis, model in axes.items() if model == FROM_FILE]
    for axis in wanted:
        if not known:
            raise ValueError(
                f'{name}: expected data of the axis {axis} but found none; give the '
                'machine file that has it'
            )
        if axis not in known:
            raise ValueError(
                f'{name}: expected an axis of the machine file, {", ".join(known)}, but found '
                f'{axis}; name one of these, or add it to the file'
            )
        if known[axis].plant is None:
            raise ValueError(
                f'{name}: expected the model (plant) of {axis} in the machine file but found its '
                'limits alone; `fuzzycnc machine identify` finds one from a recording'
            )
    return {axis: known[axis] for axis in wanted}


def check_period(name: str, period: float, axes: Mapping[str, AxisData]) -> None:
    """Refuse a control period [s] that is not that of the axes, for which they were tuned."""
    for axis, data in axes.items():
        assert data.plant is not None
        if data.plant.period != period:
            raise ValueError(
                f'{name}: expected {data.plant.period:g} s, the control period of {axis} in the '
                f'machine file, but found {period:g} s'
            )


def parse_plants(
    name: str,
    axes: Mapping[str, str],
    texts: Iterable[str],
    data: Mapping[str, AxisData],
    **common: float,
) -> dict[str, SimulatedAxis]:
    """Return the plant of each axis.

    Parameters
    ----------
    name : str
        Parameter that the settings come from, for the message.
    axes : mapping of str to str
        Model of each axis.
    texts : iterable of str
        What differs from an axis' defaults, as `X:gain_factor:1.5`.
    data : mapping of str to AxisData
        Axes of a machine file; they begin at 0, or where their travel is nearest to it.
    **common : float
        What all axes have.

    Raises
    ------
    ValueError
        If an axis or setting is unknown, or a value is no number or out of its bounds.

    Examples
    --------
    >>> plants = parse_plants('servo_plant', {'X': 'lathe'}, ['X:direction:-1'], {})
    >>> plants['X'].config.direction
    -1.0
    """
    given: dict[str, dict[str, Any]] = {axis: dict(common) for axis in axes}
    for text in texts:
        axis, _, rest = text.partition(':')
        key, _, value = rest.partition(':')
        if axis not in axes:
            raise ValueError(
                f'{name}: expected an axis among {", ".join(axes) or "none"} but found {text!r}'
            )
        plain = data[axis].plant if axis in data else _CONFIGS[axes[axis]]()
        assert plain is not None
        defaults = {item.name: getattr(plain, item.name) for item in fields(plain)}
        if key not in defaults:
            raise ValueError(
                f'{name}: expected <axis>:<setting>:<value> with a setting among '
                f'{", ".join(defaults)} but found {text!r}'
            )
        given[axis][key] = _value(name, text, value, defaults[key])
    return {
        axis: _file_plant(data[axis], given[axis])
        if axis in data
        else make_plant(model, **given[axis])
        for axis, model in axes.items()
    }


def make_plant(model: str, **changes: Any) -> SimulatedAxis:
    """Return a plant of a model, with what differs from its defaults."""
    if model == 'lathe':
        return LatheAxis(LatheAxisConfig(**changes))
    return BallscrewAxis(BallscrewAxisConfig(**changes))


def _file_plant(data: AxisData, changes: Mapping[str, Any]) -> SimulatedAxis:
    """Return the plant of an axis of a machine file, within its travel."""
    assert data.plant is not None
    plant: PlantConfig = replace(data.plant, **changes)
    start = min(max(0.0, data.limits.travel_low), data.limits.travel_high)
    if isinstance(plant, LatheAxisConfig):
        return LatheAxis(plant, position=start)
    return BallscrewAxis(plant, position=start)


def _value(name: str, text: str, value: str, default: Any) -> Any:
    """Return a value in the type of its default."""
    if isinstance(default, str):
        return value
    try:
        return type(default)(value)
    except ValueError:
        raise ValueError(f'{name}: expected a number at the end but found {text!r}') from None

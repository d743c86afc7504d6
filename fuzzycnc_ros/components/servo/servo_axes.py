# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Driven axes as parameters name them: `X:lathe`, and their plants with faults."""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from fuzzycnc_ros.core.machine.axis_plant import AxisPlant
from fuzzycnc_ros.core.machine.ballscrew_axis import BallscrewAxis, BallscrewAxisConfig
from fuzzycnc_ros.core.machine.lathe_axis import LatheAxis, LatheAxisConfig

MODELS = ('lathe', 'ballscrew')
"""Models of an axis: the lathe of method sheet 004, the ball screw of the EMPS benchmark."""

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


def parse_plants(
    name: str, axes: Mapping[str, str], texts: Iterable[str], **common: float
) -> dict[str, AxisPlant]:
    """Return the plant of each axis.

    Parameters
    ----------
    name : str
        Parameter that the settings come from, for the message.
    axes : mapping of str to str
        Model of each axis.
    texts : iterable of str
        What differs from an axis' defaults, as `X:gain_factor:1.5`.
    **common : float
        What all axes have.

    Raises
    ------
    ValueError
        If an axis or setting is unknown, or a value is no number or out of its bounds.

    Examples
    --------
    >>> plants = parse_plants('servo_plant', {'X': 'lathe'}, ['X:direction:-1'])
    >>> plants['X'].linear().gain
    -0.286
    """
    given: dict[str, dict[str, Any]] = {axis: dict(common) for axis in axes}
    for text in texts:
        axis, _, rest = text.partition(':')
        key, _, value = rest.partition(':')
        if axis not in axes:
            raise ValueError(
                f'{name}: expected an axis among {", ".join(axes) or "none"} but found {text!r}'
            )
        defaults = {item.name: item.default for item in fields(_CONFIGS[axes[axis]])}
        if key not in defaults:
            raise ValueError(
                f'{name}: expected <axis>:<setting>:<value> with a setting among '
                f'{", ".join(defaults)} but found {text!r}'
            )
        given[axis][key] = _value(name, text, value, defaults[key])
    return {axis: make_plant(model, **given[axis]) for axis, model in axes.items()}


def make_plant(model: str, **changes: Any) -> AxisPlant:
    """Return a plant of a model, with what differs from its defaults."""
    if model == 'lathe':
        return LatheAxis(LatheAxisConfig(**changes))
    return BallscrewAxis(BallscrewAxisConfig(**changes))


def _value(name: str, text: str, value: str, default: Any) -> Any:
    """Return a value in the type of its default."""
    if isinstance(default, str):
        return value
    try:
        return type(default)(value)
    except ValueError:
        raise ValueError(f'{name}: expected a number at the end but found {text!r}') from None

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated axis and the controller that the positioning commands are told of."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.cli.console import say
from fuzzycnc_ros.cli.options import choice

if TYPE_CHECKING:
    from fuzzycnc_ros.core.servo.controller import AxisController
    from fuzzycnc_ros.simulation.servo.axes import AxisPlant
    from fuzzycnc_ros.studies.servo.servo_settings import ServoSettings

AXES = ('lathe', 'ballscrew')
"""Simulated axes."""

CHOICES = (
    'variable_universe',
    'variable_universe_model_free',
    'variable_universe_static',
    'variable_universe_paper',
    'fixed_universe',
    'fixed_universe_paper',
    'cascade',
    'pid',
)
"""Controllers of the lathe axis; the ball screw has the first and the last alone."""

FOR_ANY_AXIS = ('pid', 'cascade', 'linear_tangent', 'variable_universe')
"""Controllers of an axis of a machine file."""

DEFAULT = CHOICES[0]

TUNABLE = CHOICES[:3]
"""Controllers that settings from a file are for."""

Axis = Annotated[
    str,
    choice(
        f'Simulated axis, {AXES[0]} without it; with a machine file the name of its axis.',
        AXES,
        default=False,
        others=True,
    ),
]

Out = Annotated[
    Path, typer.Option(metavar='FILE', help='Where to write it: YAML, or JSON if it ends so.')
]


def check_axis(axis: str) -> None:
    """Refuse an axis that is not known."""
    if axis not in AXES:
        raise ValueError(f'--axis: expected one of {", ".join(AXES)} but found {axis!r}')


def made_with(make: Callable[..., AxisPlant], knobs: Mapping[str, tuple[str, Any]]) -> AxisPlant:
    """Return what is made with the values of knobs; refusals name their options."""
    try:
        return make(**{name: value for name, (_, value) in knobs.items()})
    except ValueError as error:
        text = str(error)
        for name, (option, _) in knobs.items():
            if text.startswith((f'{name} ', f'{name}:')):
                text = f'{option}: {text}'
        raise ValueError(text) from error


def check_controller(name: str, axis: str, settings: ServoSettings | None) -> None:
    """Refuse a controller that is unknown or not for an axis, and settings of no use to it."""
    if name not in CHOICES:
        raise ValueError(f'--controller: expected one of {", ".join(CHOICES)} but found {name!r}')
    if axis == 'ballscrew' and name not in (DEFAULT, 'pid'):
        raise ValueError(
            f'--controller: expected {DEFAULT} or pid for the ballscrew axis but found {name}; '
            'the others are set for the lathe axis'
        )
    if settings is not None and name not in TUNABLE:
        raise ValueError(
            f'--params: expected one of the controllers {", ".join(TUNABLE)} but found {name}, '
            'which has no such parameters'
        )


def make_controller(
    name: str,
    axis: str,
    settings: ServoSettings | None = None,
    *,
    direction: float = 1.0,
    unstable: bool = False,
) -> AxisController:
    """Return a controller as it is meant to be used on an axis, or with settings of its own.

    Settings whose loop does not settle are refused unless `unstable`.

    Raises
    ------
    ValueError
        If the settings are those of another axis, or leave a loop that does not settle.
    """
    if settings is None:
        from fuzzycnc_ros.core.servo.built_in import built_in_controller

        return built_in_controller(axis, name, direction=direction)
    if settings.axis not in ('', axis):
        raise ValueError(
            f'{settings.path}: expected settings for the {axis} axis but found those for the '
            f'{settings.axis} axis'
        )
    controller = settings.controller(name, axis)
    if not unstable:
        settings.check(controller)
    return controller


@contextmanager
def warnings_said() -> Iterator[None]:
    """Print what the controllers warn of as lines of the result."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter('always')
        yield
    for text in dict.fromkeys(str(item.message) for item in found):
        say(f'note: {text}')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position controllers by name, the one naming of nodes, commands and documentation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.baselines import CascadeController, PidController
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.params import VariableUniverseParams
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.papers.servo import FixedUniverseController

Factory = Callable[..., AxisController]
"""Makes a controller from the nominal model of an axis and options by name."""


def _paper_scales(axis: LinearAxis, **options: Any) -> AxisController:
    """Return the published rules on the published universes, which do not contract."""
    published = VariableUniverseParams.published()
    return FixedUniverseController(
        axis,
        mode='static',
        error_range=published.error_range,
        rate_range=published.rate_range,
        output_gain=published.output_gain,
        **options,
    )


def _in_mode(mode: str) -> Factory:
    def make(axis: LinearAxis, **options: Any) -> AxisController:
        return VariableUniverseController(axis, mode=mode, **options)

    return make


def _model_free(axis: LinearAxis, **options: Any) -> AxisController:
    return VariableUniverseController(axis, observer=False, **options)


CONTROLLERS: Mapping[str, Factory] = MappingProxyType(
    {
        'variable_universe': VariableUniverseController,
        'variable_universe_model_free': _model_free,
        'variable_universe_static': _in_mode('static'),
        'variable_universe_paper': _in_mode('paper_literal'),
        'fixed_universe': FixedUniverseController,
        'fixed_universe_paper': _paper_scales,
        'cascade': CascadeController,
        'pid': PidController,
    }
)
"""Controllers by name, the default first, as they are meant to be used on the lathe axis.

`variable_universe` is the repaired form with observer and feedforward, `_model_free` the same with
filtered differences and an integral, `_static` the published surface alone, `_paper` the published
recursion as printed.  `fixed_universe` is the default on universes that do not contract,
`fixed_universe_paper` the published rules on the published ones.
"""

DEFAULT_CONTROLLER = next(iter(CONTROLLERS))
"""Controller that axes get if nothing else is asked for."""

FOR_USE = tuple(name for name in CONTROLLERS if name != 'fixed_universe_paper')
"""Controllers that a node offers; the one left out stops far short, for comparison alone."""

SUITED = 'suited'
"""Stands for the controller that won on an axis after tuning with equal effort."""

WITH_PARAMS = tuple(name for name in CONTROLLERS if name.startswith('variable_universe'))
"""Controllers that `VariableUniverseParams` are for."""


def make_controller(
    name: str,
    axis: LinearAxis,
    params: VariableUniverseParams | None = None,
    **options: Any,
) -> AxisController:
    """Return the controller of a name for an axis.

    Parameters
    ----------
    name : str
        Of `CONTROLLERS`.
    axis : LinearAxis
        Nominal model of the axis.
    params : VariableUniverseParams, optional
        Universes and rules instead of the controller's own.
    **options
        What the controller takes beside: `duty_max`, `duty_slew` and `limits` all do, `noise`
        those with an observer.

    Raises
    ------
    ValueError
        If the name is unknown, the controller has no universes to set, or a number is out of its
        range.

    Examples
    --------
    >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
    >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
    >>> type(make_controller('cascade', axis)).__name__
    'CascadeController'
    """
    if name not in CONTROLLERS:
        raise ValueError(
            f'controller: expected one of {", ".join(CONTROLLERS)} but found {name!r}'
        )
    if params is None:
        return CONTROLLERS[name](axis, **options)
    if name not in WITH_PARAMS:
        raise ValueError(
            f'params: expected one of the controllers {", ".join(WITH_PARAMS)} but found {name}, '
            'which has no such parameters'
        )
    return CONTROLLERS[name](axis, params=params, **options)

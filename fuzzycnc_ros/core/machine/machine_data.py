# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Machine data: what is known of one machine, its axes, its path motion and its controller.

A node's parameters carry axes as a list of texts.  A run is repeated from its parameters alone,
so they hold the data, not the name of a file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from hashlib import sha256
from itertools import combinations
from types import MappingProxyType
from typing import Any

from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.machine.knowledge import AxisKnowledge
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig

PlantConfig = LatheAxisConfig | BallscrewAxisConfig
"""Model of a driven axis: lags in a row, or a mass with friction."""

PLANTS: Mapping[str, type[LatheAxisConfig] | type[BallscrewAxisConfig]] = MappingProxyType(
    {'lags': LatheAxisConfig, 'mass': BallscrewAxisConfig}
)
"""Models by the name that a machine file calls them."""

LINEAR_AXES = 'XYZ'
"""Axes of a tool path."""

NOTHING_KNOWN = AxisKnowledge()
"""Knowledge of an axis that was not identified."""


@dataclass(frozen=True, kw_only=True)
class AxisLimits(Config):
    """Limits of an axis, and the forces on it."""

    velocity: float = param(0.25, 'm/s', 'Largest velocity', low=1e-6, high=100.0)
    acceleration: float = param(4.0, 'm/s^2', 'Largest acceleration', low=1e-6, high=1e4)
    jerk: float = param(0.0, 'm/s^3', 'Largest jerk; 0 is none', low=0.0, high=1e7)
    travel_low: float = param(
        -0.25, 'm', 'Lowest position that the axis is sent to', low=-100.0, high=100.0
    )
    travel_high: float = param(
        0.25, 'm', 'Highest position that the axis is sent to', low=-100.0, high=100.0
    )
    positioning_velocity: float = param(
        0.0, 'm/s', 'Velocity on the way to a position; 0 takes `velocity`', low=0.0, high=100.0
    )
    positioning_acceleration: float = param(
        0.0,
        'm/s^2',
        'Acceleration on the way to a position; 0 takes `acceleration`',
        low=0.0,
        high=1e4,
    )
    positioning_jerk: float = param(
        30.0, 'm/s^3', 'Jerk on the way to a position', low=1e-3, high=1e6
    )
    resonance: float = param(
        0.0,
        'Hz',
        'Lowest resonance, of which controllers stay well below; 0 if none is known',
        low=0.0,
        high=1e4,
    )
    vertical: bool = param(
        False, '-', 'Whether its own weight pulls the axis: it drops where the drive gives way'
    )
    load: float = param(
        0.12, '-', 'Largest steady load either way, as share of full duty', low=0.0, high=1.0
    )
    friction: float = param(
        0.12, '-', 'Largest friction, as share of full duty', low=0.0, high=1.0
    )

    def __post_init__(self) -> None:
        """Check the fields, and that there is travel.

        Raises
        ------
        ValueError
            If a field is out of its bounds, or the travel is empty.
        """
        super().__post_init__()
        if not self.travel_low < self.travel_high:
            raise ValueError(
                f'travel_high: expected more than travel_low = {self.travel_low} m but found '
                f'{self.travel_high} m'
            )

    @property
    def positioning(self) -> tuple[float, float, float]:
        """Velocity, acceleration and jerk on the way to a position [m/s, m/s^2, m/s^3]."""
        return (
            self.positioning_velocity or self.velocity,
            self.positioning_acceleration or self.acceleration,
            self.positioning_jerk,
        )


@dataclass(frozen=True, kw_only=True)
class PathLimits(Config):
    """Limits of the motion along a path."""

    velocity: float = param(0.25, 'm/s', 'Largest speed along the path', low=1e-6, high=100.0)
    acceleration: float = param(
        1.5, 'm/s^2', 'Largest change of speed along the path', low=1e-6, high=1e4
    )
    jerk: float = param(0.0, 'm/s^3', 'Largest jerk along the path; 0 is none', low=0.0, high=1e7)
    feed: float = param(
        0.0, 'm/s', 'Feed where the path asks for no less; 0 takes `velocity`', low=0.0, high=100.0
    )
    settle: float = param(
        0.1, 's', 'Rest at exact stops, for the axes to arrive', low=0.0, high=10.0
    )


@dataclass(frozen=True, kw_only=True)
class AxisData:
    """One axis of a machine.

    Parameters
    ----------
    limits : AxisLimits
        What it is allowed.
    plant : LatheAxisConfig or BallscrewAxisConfig or None
        Its model, sensor included; None where only its limits are known.
    knowledge : AxisKnowledge
        How well the model is known.
    controller : str
        Position controller that it is used with; empty for the default.
    settings : mapping of str to float
        What the controller's parameters are, where they are not its defaults.
    """

    limits: AxisLimits = AxisLimits()
    plant: PlantConfig | None = None
    knowledge: AxisKnowledge = NOTHING_KNOWN
    controller: str = ''
    settings: Mapping[str, float] = field(default_factory=dict)

    @property
    def model(self) -> str:
        """Name of the plant's model, of `PLANTS`; empty where there is none."""
        return next((name for name, kind in PLANTS.items() if type(self.plant) is kind), '')

    def known_plant(self) -> PlantConfig:
        """Return the plant's model.

        Raises
        ------
        ValueError
            If only the limits of the axis are known, or its model is not fit for control.
        """
        if self.plant is None:
            raise ValueError(
                'plant: expected a model of the axis but found its limits alone; '
                '`fuzzycnc machine identify` finds one from a recording'
            )
        if self.knowledge.not_fit_for_control:
            raise ValueError(
                'plant: expected a model that is fit for control but found one that is not: '
                f'{self.knowledge.not_fit_for_control}'
            )
        return self.plant


@dataclass(frozen=True, kw_only=True)
class MachineData:
    """A whole machine; every part may be left at its default.

    Parameters
    ----------
    name : str
        What it is called.
    axes : mapping of str to AxisData
        Axes by their letters, in the order of the machine.
    path : PathLimits
        Limits along the path.
    loop : ContouringConfig
        Lags of the axes that follow a path: interpolator, position and velocity loop.
    contour_constant : mapping of str to float
        Contour error over normal acceleration [s^2] by the pair of axes that moves, such as XY;
        pairs left out have that of `loop`.
    source : mapping of str to str
        Where a value comes from, by its place in the file such as `axes.X.limits.velocity`; what
        is left out is a default.
    """

    name: str = 'machine'
    axes: Mapping[str, AxisData] = field(default_factory=dict)
    path: PathLimits = PathLimits()
    loop: ContouringConfig = field(default_factory=ContouringConfig)
    contour_constant: Mapping[str, float] = field(default_factory=dict)
    source: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the pairs of axes.

        Raises
        ------
        ValueError
            If a pair is none of two linear axes, or its constant is not positive.
        """
        pairs = [''.join(pair) for pair in combinations(LINEAR_AXES, 2)]
        for pair, value in self.contour_constant.items():
            if pair not in pairs:
                raise ValueError(
                    f'contour_constant: expected pairs of axes among {", ".join(pairs)} but '
                    f'found {pair}'
                )
            if not 1e-9 <= value <= 1.0:
                raise ValueError(
                    f'contour_constant: expected 1e-09 to 1 s^2 for {pair} but found {value}'
                )

    @property
    def machine_constant(self) -> float:
        """Largest contour error over normal acceleration of any pair of axes [s^2]."""
        known = self.contour_constant
        missing = len(known) < len(LINEAR_AXES)
        return max([*known.values(), *([self.loop.contour_constant] if missing else [])])

    def limits(self, name: str) -> tuple[float, float, float]:
        """Return a limit of X, Y and Z; a missing axis has the strictest of the others.

        Parameters
        ----------
        name : {'velocity', 'acceleration', 'jerk'}
            Which limit.

        Returns
        -------
        tuple of float, length 3
            In SI units.
        """
        found = {
            axis: float(getattr(data.limits, name))
            for axis, data in self.axes.items()
            if axis in LINEAR_AXES
        }
        given = [value for value in found.values() if value] or [
            float(getattr(AxisLimits(), name))
        ]
        x, y, z = (found.get(axis, min(given)) for axis in LINEAR_AXES)
        return x, y, z


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


def axis_hash(axis: str, data: AxisData) -> str:
    """Return the SHA-256 of all that a machine file says of an axis, hexadecimal.

    Comments, other axes and the order of entries do not count; what the file takes from a
    LinuxCNC INI file does.
    """
    return sha256('\n'.join(axis_texts({axis: data})).encode()).hexdigest()


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
    sections: dict[str, Config | None] = {
        'limits': data.limits,
        'plant': data.plant,
        'knowledge': data.knowledge,
    }
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
    kinds: dict[str, type[Config]] = {'limits': AxisLimits, 'knowledge': AxisKnowledge}
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
            knowledge=AxisKnowledge(**values['knowledge']),
            controller=entries.get('controller', ''),
            settings=settings,
        )
    except ValueError as error:
        raise ValueError(f'{place}: {error}') from error


def _value(place: str, text: str, default: Any) -> Any:
    """Return a value in the type of its default."""
    if isinstance(default, bool):
        if text not in ('True', 'False'):
            raise ValueError(f'{place}: expected True or False but found {text!r}')
        return text == 'True'
    try:
        return type(default)(text)
    except ValueError:
        raise ValueError(f'{place}: expected a number but found {text!r}') from None

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Options that several commands on thermal models share, and what their words mean."""

from collections.abc import Callable, Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.completion import Complete, one_of, word_or_file
from fuzzycnc_ros.cli.console import words
from fuzzycnc_ros.cli.quantities import in_declared_unit, number_in
from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.units import DECLARED, TIMES

ALL = 'all'
"""Word for every model."""

BUILT_IN_MACHINES = ('mill', 'lathe', 'ballscrew')
"""Machines that come with the package, as machine files; their reader would load numpy."""

DUTIES = ('D0', 'D0b', 'T1', 'T2', 'T3')
"""Duties of the simulated mill; where they are made would load numpy."""

PROGRAM_UNITS = ('mm', 'inch')
"""Units of part programs."""

SENSOR_CHOICES = ('auto', 'clusters', 'all')
"""Ways to choose the sensors of a model."""

OptionalText = Optional[str]  # noqa: UP045 - typer 0.9 does not read the newer form
OptionalNumber = Optional[float]  # noqa: UP045
OptionalWhole = Optional[int]  # noqa: UP045
OptionalPath = Optional[Path]  # noqa: UP045
"""Types of options that need not be given."""


def given(
    text: str,
    *names: str,
    metavar: str | None = None,
    complete: Complete | None = None,
    read: Callable[[str | float], float] | None = None,
) -> Any:
    """Return an option that counts only if it is given, and so shows no default.

    Parameters
    ----------
    text : str
        Its help.
    *names : str
        What it is called, if not as its parameter.
    metavar : str, optional
        What stands for its value.
    complete : callable, optional
        What a shell proposes for its value.
    read : callable, optional
        What makes a number of its text.
    """
    return typer.Option(
        *names,
        metavar=metavar,
        show_default=False,
        autocompletion=complete,
        parser=read,
        help=text,
    )


def choice(
    text: str, words: Sequence[str], *names: str, default: bool = True, others: bool = False
) -> Any:
    """Return an option that takes one of some words and refuses others; help and shells name them.

    Parameters
    ----------
    text : str
        Its help.
    words : sequence of str
        What it takes.
    *names : str
        What it is called, if not as its parameter.
    default : bool
        Whether the help shows its default.
    others : bool
        Whether further words may be right, as those of a machine file, so that none is refused.
    """

    def known(param: typer.CallbackParam, value: Any) -> Any:
        if value not in (None, '') and str(value) not in words:
            wanted = (' or ' if len(words) == 2 else ', ').join(words)
            raise ValueError(f'{param.opts[0]}: expected {wanted} but found {value!r}')
        return value

    return typer.Option(
        *names,
        metavar='|'.join(words),
        show_default=default,
        autocompletion=one_of(words),
        callback=None if others else known,
        help=text,
    )


MachineFile = Annotated[
    OptionalText,
    given(
        f'Machine file, or one that is built in: {", ".join(BUILT_IN_MACHINES)}.',
        metavar='FILE.yaml',
        complete=word_or_file(BUILT_IN_MACHINES, '.yaml'),
    ),
]

Bags = Annotated[
    list[Path], typer.Argument(metavar='BAG...', help='Bags of runs, each from a cold start.')
]

Start = Annotated[
    OptionalNumber,
    given(
        "Time that counts first, from the bag's first sample, which stays the reference; what "
        'lies before only warms up lags. In s unless it has a unit, such as 24h.',
        metavar='TIME',
        read=number_in(TIMES, 'a time'),
    ),
]

End = Annotated[
    OptionalNumber,
    given(
        "Time that counts last, from the bag's first sample; nothing after it is read. In s "
        'unless it has a unit, such as 24h.',
        metavar='TIME',
        read=number_in(TIMES, 'a time'),
    ),
]

DropSensor = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        show_default=False,
        metavar='NAME,...',
        help='Sensors to do without, as if they had not been recorded; repeat it, or put commas '
        'between.',
    ),
]

Interval = Annotated[
    Optional[float],  # noqa: UP045 - typer 0.9 does not read the newer form
    typer.Option(
        metavar='TIME',
        show_default='60 s, or that of the slowest run',
        parser=number_in(TIMES, 'a time'),
        help='Sampling interval of the model, in s unless it has a unit; faster runs are '
        'averaged.',
    ),
]

SensorLimits = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        metavar='SENSOR:LIMIT:VALUE',
        show_default=False,
        help="Limit of a sensor that is not a machine's metal, such as bed:rate_max:0.7; repeat "
        'for more. Limits: range_low, range_high [degC], rate_max [K/s].',
    ),
]

Sensors = Annotated[
    str,
    choice(
        'clusters = one sensor per cluster, all = every sensor that warms up, '
        'auto = all up to 24 sensors, clusters above.',
        SENSOR_CHOICES,
    ),
]

Clusters = Annotated[int, typer.Option(help='Number of clusters.')]

Speed = Annotated[
    bool,
    typer.Option(
        '--speed/--no-speed',
        help='Whether models may read the spindle speed, where all runs carry it.',
    ),
]

Seed = Annotated[int, typer.Option(help='Seed of the clustering.')]

Report = Annotated[OptionalPath, given('Write a page with plots.', metavar='FILE.html')]


def names_of(option: str, texts: list[str], known: Sequence[str]) -> tuple[str, ...]:
    """Return the models that an option names, in the order of those that are known.

    Raises
    ------
    ValueError
        If it names none, or one that is not known.
    """
    names = words(texts)
    unknown = [name for name in names if name not in (ALL, *known)]
    if unknown or not names:
        raise ValueError(
            f'{option}: expected {ALL} or some of {", ".join(known)} but found '
            f'{", ".join(map(repr, unknown)) or "none"}'
        )
    return tuple(name for name in known if ALL in names or name in names)


def node_parameters(option: str, texts: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return parameters by node, given as node.name=value with values as in a parameter file.

    A number may have a unit of the kind that the parameter is declared in.

    Raises
    ------
    ValueError
        If a text has another form or holds no value, or a unit is of another kind.
    """
    import yaml

    from fuzzycnc_ros.registry import COMPONENTS

    found: dict[str, dict[str, Any]] = {}
    for text in texts:
        path, equals, value = text.partition('=')
        node, dot, name = path.partition('.')
        if not (equals and dot and node and name):
            raise ValueError(
                f'{option}: expected NODE.NAME=VALUE such as compensator.offset_max=20um '
                f'but found {text!r}'
            )
        try:
            plain = _number_or_value(yaml.safe_load(value))
        except yaml.YAMLError as error:
            raise ValueError(f'{option} {path}: {value!r} is no value: {error}') from error
        config = COMPONENTS[node].CONFIG if node in COMPONENTS else Config
        declared = next((item for item in fields(config) if item.name == name), None)
        found.setdefault(node, {})[name] = _in_si(path, plain, declared)
    return found


def _in_si(path: str, value: Any, declared: Field[Any] | None) -> Any:
    """Return the value of a parameter, whose numbers may have units."""
    if isinstance(value, list):
        return [_in_si(path, item, declared) for item in value]
    if declared is None or not isinstance(value, str):
        return value
    sample = declared.default
    if isinstance(sample, tuple) and sample:
        sample = sample[0]
    if not isinstance(sample, float) or declared.metadata['unit'] not in DECLARED:
        return value
    return in_declared_unit(path, value, declared.metadata['unit'])


def _number_or_value(value: Any) -> Any:
    """Return 20e-6 as the number that people mean; YAML 1.1 takes it for text."""
    if not isinstance(value, str):
        return value
    try:
        return float(value)
    except ValueError:
        return value

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that record: when a bag is split, and what becomes of its parts."""

from typing import Annotated, Any

from fuzzycnc_ros.bags.shipping import check_no_secret
from fuzzycnc_ros.cli.console import check_at_least
from fuzzycnc_ros.cli.options import OptionalNumber, OptionalText, given
from fuzzycnc_ros.cli.quantities import SIZES, number_in
from fuzzycnc_ros.core.units import TIMES

SplitSize = Annotated[
    OptionalNumber,
    given(
        'Begin a new part of the bag after this size, such as 500MB.',
        metavar='SIZE',
        read=number_in(SIZES, 'a size'),
    ),
]
SplitDuration = Annotated[
    OptionalNumber,
    given(
        'Begin a new part of the bag after this time, in s unless it has a unit, such as 1h.',
        metavar='TIME',
        read=number_in(TIMES, 'a time'),
    ),
]
Budget = Annotated[
    OptionalNumber,
    given(
        'Delete the oldest parts beyond this size of the bag, such as 50GB; with --ship only '
        'those that have arrived.',
        metavar='SIZE',
        read=number_in(SIZES, 'a size'),
    ),
]
FreeMin = Annotated[
    OptionalNumber,
    given(
        'Pause while the disk has less free; 200MB if left out, 0 for never.',
        metavar='SIZE',
        read=number_in(SIZES, 'a size'),
    ),
]
Ship = Annotated[
    OptionalText,
    given(
        'Copy closed parts there, with a check of what arrived: a folder, s3://bucket/mill or '
        'another URL of fsspec.',
        metavar='URL',
    ),
]


def keeping_parameters(
    split_size: float | None,
    split_duration: float | None,
    budget: float | None,
    free_min: float | None,
    ship: str | None,
) -> dict[str, Any]:
    """Return the parameters of the recorder that these options mean; those not given are absent.

    Raises
    ------
    ValueError
        If a number is negative, or there is a budget but nothing splits the bag.
    BagError
        If the place to ship to carries a secret.
    """
    numbers = {
        '--split-size': split_size,
        '--split-duration': split_duration,
        '--budget': budget,
        '--free-min': free_min,
    }
    for option, value in numbers.items():
        check_at_least(option, value, 0.0)
    check_no_secret(ship or '')
    if budget and not (split_size or split_duration):
        raise ValueError(
            '--budget: expected --split-size or --split-duration, too: only parts that are closed '
            'can be deleted'
        )
    found: dict[str, Any] = {
        'split_size': None if split_size is None else round(split_size),
        'split_duration': split_duration,
        'budget': None if budget is None else round(budget),
        'free_min': None if free_min is None else round(free_min),
        'ship': ship,
    }
    return {name: value for name, value in found.items() if value is not None}

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of an axis: a set of models around the one in its machine file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from fuzzycnc_ros.core.config import Config, param


@dataclass(frozen=True, kw_only=True)
class AxisKnowledge(Config):
    """Intervals of what was identified; as it stands, nothing was.

    The model of the axis holds the best values but for its dead time, which is the longest that
    the recording leaves room for.
    """

    known_to: float = param(
        0.0,
        'Hz',
        'Frequency up to which the response is known; 0 where none was measured',
        low=0.0,
        high=1e5,
    )
    gain_low: float = param(1.0, '-', 'Least response at 5 Hz over the model', low=0.01, high=1.0)
    gain_high: float = param(
        1.0, '-', 'Largest response at 5 Hz over the model', low=1.0, high=100.0
    )
    delay_low: float = param(0.0, 's', 'Shortest dead time', low=0.0, high=0.1)
    mode_low: float = param(
        0.0,
        'Hz',
        'Least frequency of the lowest mode; where the model has none, it may lie anywhere above',
        low=0.0,
        high=1e5,
    )
    mode_high: float = param(
        0.0,
        'Hz',
        'Largest frequency of the lowest mode; 0 where it is unknown',
        low=0.0,
        high=1e5,
    )
    damping_low: float = param(0.02, '-', 'Least damping of the mode', low=1e-4, high=1.0)
    unexplained: float = param(
        0.0, '-', 'Share of the acceleration that no model explains', low=0.0, high=1.0
    )
    remainder: str = param(
        '',
        '-',
        'Largest deviation from the model by frequency in Hz, as share of it: 10:0.05 20:0.1',
    )
    not_fit_for_control: str = param(
        '', '-', 'Reason why no controller may use the model; empty where one may'
    )

    def __post_init__(self) -> None:
        """Check the fields.

        Raises
        ------
        ValueError
            If a field is out of its bounds or the remainder cannot be read.
        """
        super().__post_init__()
        _ = self.remainders

    @property
    def remainders(self) -> tuple[tuple[float, float], ...]:
        """Frequency [Hz] and largest deviation from the model [-], from the lowest frequency."""
        found = []
        for text in self.remainder.split():
            frequency, sign, share = text.partition(':')
            try:
                pair = float(frequency), float(share)
            except ValueError:
                pair = 0.0, -1.0
            if not (sign and 0.0 < pair[0] < 1e5 and 0.0 <= pair[1] < 1e6):
                raise ValueError(
                    f'remainder: expected frequencies and shares such as 10:0.05 but found '
                    f'{text!r}'
                )
            found.append(pair)
        return tuple(sorted(found))


def remainder_text(pairs: Iterable[tuple[float, float]]) -> str:
    """Return deviations by frequency as `AxisKnowledge` has them.

    Examples
    --------
    >>> remainder_text([(10.0, 0.05), (20.0, 0.125)])
    '10:0.05 20:0.12'
    """
    return ' '.join(f'{frequency:.4g}:{share:.2g}' for frequency, share in pairs)

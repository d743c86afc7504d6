# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of `deformation_compensator`."""

from dataclasses import dataclass

from fuzzycnc_ros.core.config import param
from fuzzycnc_ros.core.deformation.compensation import CompensationConfig
from fuzzycnc_ros.core.deformation.gain import GAIN_MAX, GAIN_MIN


@dataclass(frozen=True, kw_only=True)
class DeformationCompensatorConfig(CompensationConfig):
    """Parameters of `deformation_compensator`, beside those of the offsets themselves."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    model: str = param(
        '',
        '-',
        'Model file made by fuzzycnc foam train; empty stitches without compensation',
        live=True,
    )
    offsets: str = param(
        '',
        '-',
        'File made by fuzzycnc foam learn: offsets of one track, used for it instead of the '
        "model's; empty for none",
        live=True,
    )
    gain: tuple[float, ...] = param(
        (1.0, 1.0), '-', "Factors of the model's X and Y", low=GAIN_MIN, high=GAIN_MAX, live=True
    )
    on_refused: str = param(
        'zero',
        '-',
        'What becomes of a pattern in which the gate refuses steps: zero = they get no '
        'compensation and it is stitched, stop = it is not',
        choices=('zero', 'stop'),
        live=True,
    )
    corner_angle: float = param(
        0.0873,
        'rad',
        'Change of direction between two primitives beyond which the tool stops there',
        low=0.0,
        high=3.1416,
    )

    def __post_init__(self) -> None:
        """Check every field.

        Raises
        ------
        ValueError
            If one is out of its bounds, or the gain is not one of X and Y.
        """
        super().__post_init__()
        if len(self.gain) != 2:
            raise ValueError(f'gain: expected two factors, X and Y, but found {len(self.gain)}')

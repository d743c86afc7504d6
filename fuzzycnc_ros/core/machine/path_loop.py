# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Contour error of axes that follow a path: interpolator, position and velocity loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

from fuzzycnc_ros.core.config import Config, param


@dataclass(frozen=True, kw_only=True)
class ContouringConfig(Config):
    """The simulated contouring machine; all axes are equal."""

    interpolation_period: float = param(
        1e-3, 's', 'Time between two positions of the interpolator', low=1e-5, high=0.1
    )
    control_steps: int = param(4, '-', 'Control steps in an interpolation period', low=1, high=100)
    filter_samples: int = param(
        8, '-', 'Positions of the interpolator that are averaged', low=1, high=1000
    )
    position_gain: float = param(
        40.0, '1/s', 'Velocity asked for per position error', low=0.1, high=1000.0
    )
    velocity_bandwidth: float = param(
        250.0, 'rad/s', 'Bandwidth of the velocity loop', low=1.0, high=10_000.0
    )
    velocity_max: float = param(
        0.25, 'm/s', 'Largest velocity of an axis and along the path', low=1e-4, high=10.0
    )
    acceleration_max: float = param(
        4.0, 'm/s^2', 'Largest acceleration of an axis', low=1e-3, high=1000.0
    )
    path_acceleration_max: float = param(
        1.5, 'm/s^2', 'Largest change of speed along the path', low=1e-3, high=1000.0
    )
    velocity_min: float = param(
        2e-5, 'm/s', 'Speed along the path that is never undercut', low=1e-9, high=1e-2
    )
    run_out: float = param(0.3, 's', 'Time to come to rest at the end', low=0.0, high=60.0)

    def __post_init__(self) -> None:
        """Check the fields, and that the loops are stable at this control step.

        Raises
        ------
        ValueError
            If a field is out of its bounds or the sampled loops would not settle.
        """
        super().__post_init__()
        gain, damping = self.loop
        # both roots of z^2 - (2 - damping - gain) z + (1 - damping) inside the unit circle
        if not (0.0 < damping < 2.0 and gain < 4.0 - 2.0 * damping):
            raise ValueError(
                f'expected loops that settle but found position_gain {self.position_gain} 1/s and '
                f'velocity_bandwidth {self.velocity_bandwidth} rad/s at a control step of '
                f'{self.control_period} s; raise control_steps'
            )

    @property
    def control_period(self) -> float:
        """Time of a control step [s]."""
        return self.interpolation_period / self.control_steps

    @property
    def loop(self) -> tuple[float, float]:
        """Share of the position error and of the velocity that a control step takes away [-]."""
        damping = self.velocity_bandwidth * self.control_period
        return damping * self.position_gain * self.control_period, damping

    @property
    def delay(self) -> float:
        """Time by which the axes lag behind the interpolator [s]."""
        filtering = 0.5 * (self.filter_samples - 1) * self.interpolation_period
        return 1.0 / self.position_gain + filtering

    @property
    def contour_constant(self) -> float:
        """Contour error per normal acceleration, C = 1/(2 Kv^2) - 1/(Kv w) + T^2/24 [s^2].

        Examples
        --------
        >>> f'{ContouringConfig().contour_constant:.4e}'
        '2.1517e-04'
        """
        gain, window = self.position_gain, self.filter_samples * self.interpolation_period
        loops = 0.5 / (gain * gain) - 1.0 / (gain * self.velocity_bandwidth)
        return loops + window * window / 24.0


def loop_of_constant(constant: float, nominal: ContouringConfig | None = None) -> ContouringConfig:
    """Return a loop with a contour constant, slower or faster throughout than the nominal one.

    Parameters
    ----------
    constant : float
        Contour error over normal acceleration, C [s^2]; positive.
    nominal : ContouringConfig, optional
        Loop whose ratio of gains is kept; the interpolator's filter stays as it is.

    Returns
    -------
    ContouringConfig
        With `contour_constant` equal to C.

    Raises
    ------
    ValueError
        If the interpolator's filter alone leaves more than that.

    Examples
    --------
    >>> f'{loop_of_constant(1e-4).contour_constant:.6e}'
    '1.000000e-04'
    """
    base = nominal or ContouringConfig()
    window = base.filter_samples * base.interpolation_period
    loops = constant - window * window / 24.0
    if not loops > 0.0:
        raise ValueError(
            f'contour_constant: expected more than {window * window / 24.0:.3g} s^2, which the '
            f'interpolator alone leaves, but found {constant:g} s^2'
        )
    factor = sqrt((base.contour_constant - window * window / 24.0) / loops)
    fast = max(1, round(base.control_steps * factor))
    return replace(
        base,
        position_gain=base.position_gain * factor,
        velocity_bandwidth=base.velocity_bandwidth * factor,
        control_steps=fast,
    )

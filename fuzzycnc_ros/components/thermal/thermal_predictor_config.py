# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of `thermal_predictor`."""

from dataclasses import dataclass
from types import MappingProxyType

from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.thermal.domain import DOMAIN_MARGIN, SPEED_MARGIN
from fuzzycnc_ros.core.thermal.run import GAP_MAX, SETTLE_TIME
from fuzzycnc_ros.core.thermal.sensor_watch import PERSISTENCE, TOLERANCE, WATCH_LIMIT


@dataclass(frozen=True, kw_only=True)
class ThermalPredictorConfig(Config):
    """Parameters of `thermal_predictor`."""

    GONE = MappingProxyType(
        {
            'probing': 'none',
            'probe_jump_max': 10e-6,
            'drift_limit': 4.0,
            'adaptation': 0.0,
            'domain_margin': DOMAIN_MARGIN,
            'speed_margin': SPEED_MARGIN,
        }
    )
    INSTEAD = (
        '; what probes correct is learnt now, with learn: true, and how far from its training a '
        'model may be used is fixed'
    )

    model: str = param(
        '',
        '-',
        'Model file made by fuzzycnc train; empty waits for training; another file takes over '
        'within swap_time',
        live=True,
    )
    force: bool = param(
        False,
        '-',
        'Use a model even where it left more than no compensation on held-out samples',
    )
    warm_reference: bool = param(
        False,
        '-',
        'Accept a thermal reference of a warm machine; otherwise its predictions are out of '
        'domain',
        live=True,
    )
    gap_max: float = param(
        GAP_MAX,
        's',
        'Longest gap in the samples, and in what else the model needs, that is bridged',
        low=0.0,
        high=86400.0,
        live=True,
    )
    settle_time: float = param(
        SETTLE_TIME,
        's',
        'Time after which a history that was lost no longer matters',
        low=0.0,
        high=604800.0,
        live=True,
    )
    swap_time: float = param(
        300.0,
        's',
        'Time in which a new model takes over from the one in use',
        low=60.0,
        high=3600.0,
        live=True,
    )
    mate_limit: float = param(
        WATCH_LIMIT, 'K', 'Difference to its mates that is never a fault', low=0.0, high=100.0
    )
    mate_tolerance: float = param(
        TOLERANCE,
        '-',
        'Limit of a sensor that its mates know less well, over what they missed in training',
        low=0.0,
        high=10.0,
    )
    mate_persistence: float = param(
        PERSISTENCE,
        's',
        'Relative excess above the limit, summed over time, at which a sensor is substituted; '
        '0 is never',
        low=0.0,
        high=86400.0,
    )
    learn: bool = param(
        False,
        '-',
        'Learn from displacements what the model leaves; without a model, all of the error',
    )
    learn_axes: tuple[str, ...] = param(
        ('X', 'Y', 'Z'), '-', 'Axes whose error is learnt where there is no model'
    )
    learn_places: tuple[str, ...] = param(
        (),
        '-',
        'Places at which such an axis is probed, in m, as Y:-0.5:0; two teach how the error '
        'slopes along it, a third between them how it bends',
    )
    band_wanted: float = param(
        5e-6,
        'm',
        'Half width of the band beyond which a probe is asked for',
        low=1e-9,
        high=1e-2,
        live=True,
    )
    probe_interval_min: float = param(
        0.0,
        's',
        'Time after a probe of a channel in which further ones are ignored; where displacement '
        'is a continuous stream, the interval of probing',
        low=0.0,
        high=864000.0,
    )
    probe_noise: float = param(
        0.7e-6,
        'm',
        'Least standard deviation of a probe',
        low=1e-9,
        high=1e-3,
    )
    correction_time: float = param(
        300.0,
        's',
        'Time in which the correction by a probe comes into force',
        low=60.0,
        high=3600.0,
        live=True,
    )

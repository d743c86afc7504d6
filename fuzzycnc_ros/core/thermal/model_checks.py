# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the parts of a thermal model must fulfil together, whether trained or read from a file."""

from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.core.thermal.drivers import SPINDLE_SPEED

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.model import ThermalModel


def check_parts(model: 'ThermalModel') -> None:
    """Refuse parts that contradict each other.

    Raises
    ------
    ValueError
        The message names the part.
    """
    inputs, channels = len(model.inputs), len(model.channel)
    if not inputs or len(set(model.inputs)) != inputs:
        raise ValueError(f'inputs: expected each sensor once, but found {model.inputs}')
    if not channels or len(set(model.channel)) != channels:
        raise ValueError(f'channel: expected each channel once, but found {model.channel}')
    for name, found in (
        ('axis', len(model.axis)),
        ('default', len(model.default)),
        ('residual_deviation', len(model.band.deviation)),
    ):
        if found != channels:
            raise ValueError(f'{name}: expected one per channel ({channels}), but found {found}')
    if model.selection.chosen != model.inputs:
        raise ValueError(
            f'selection: expected the inputs {", ".join(model.inputs)} as chosen sensors, but '
            f'found {", ".join(model.selection.chosen)}'
        )
    if model.drivers not in ((), (SPINDLE_SPEED,)):
        raise ValueError(
            f'drivers: expected none or {SPINDLE_SPEED}, but found {", ".join(model.drivers)}'
        )
    if model.domain.drive.shape != (len(model.drivers),):
        raise ValueError(
            f'domain: expected {len(model.drivers)} drivers, but found {len(model.domain.drive)}'
        )
    if model.watch is not None and model.watch.input != model.inputs:
        raise ValueError(
            f'watch: expected the inputs {", ".join(model.inputs)}, but found '
            f'{", ".join(model.watch.input)}'
        )
    if model.cold_start is not None and model.cold_start.pattern.shape != (inputs,):
        raise ValueError(
            f'cold_start: expected {inputs} inputs, but found {model.cold_start.pattern.shape}'
        )
    if model.domain.mean.shape != (inputs,):
        raise ValueError(f'domain: expected {inputs} inputs, but found {model.domain.mean.shape}')
    for name, candidate in model.candidates.items():
        shape = (candidate.recursion.channels, candidate.recursion.inputs)
        width = inputs + len(model.drivers)
        if shape != (channels, width):
            raise ValueError(
                f'candidate {name!r}: expected {channels} channels and {width} inputs, but '
                f'found {shape[0]} and {shape[1]}'
            )
    for name in model.default:
        if name not in model.candidates:
            raise ValueError(
                f'default: expected one of {", ".join(model.candidates)}, but found {name!r}'
            )
        if model.candidates[name].problems:
            raise ValueError(
                f'default: expected a reliable candidate, but found {name!r}: '
                f'{"; ".join(model.candidates[name].problems)}'
            )


def check_output(model: 'ThermalModel') -> None:
    """Refuse numbers that are finite one by one, but of which no finite prediction follows.

    Raises
    ------
    ValueError
        If an error or a deviation amid the training is not finite.
    """
    sample = np.concatenate([model.domain.mean, model.domain.drive])
    stream = model.start()
    with np.errstate(all='ignore'):
        values = [stream.step(sample) for _ in range(3)]
        deviation = model.standard_deviation(sample)
    if not (np.isfinite(values).all() and np.isfinite(deviation).all()):
        raise ValueError(
            f'default: expected finite errors and deviations amid the training, but found '
            f'{values[-1]} and {deviation}; train the model anew'
        )

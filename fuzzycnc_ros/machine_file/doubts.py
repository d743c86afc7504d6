# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Impossible or unlikely combinations in machine data whose values are each within bounds."""

from __future__ import annotations

from collections.abc import Iterator

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import LINEAR_AXES, AxisData, MachineData

_FAR = 2.0
"""Factor between two figures for the same thing from which on they contradict each other."""


def machine_doubts(machine: MachineData) -> list[str]:
    """Return sentences on what does not fit together; empty if all does."""
    found = [*_path_doubts(machine)]
    for name, axis in machine.axes.items():
        found += _axis_doubts(name, axis)
    return found


def _path_doubts(machine: MachineData) -> Iterator[str]:
    known = [axis for axis in machine.axes if axis in LINEAR_AXES]
    fastest = sum(value**2 for value in machine.limits('velocity')) ** 0.5
    if known and machine.path.velocity > fastest * (1.0 + 1e-9):
        yield (
            f'path.velocity: {1e3 * machine.path.velocity:g} mm/s is more than all axes together '
            f'reach, {1e3 * fastest:g} mm/s'
        )
    if machine.path.feed > machine.path.velocity:
        yield 'path.feed: is above path.velocity, which bounds it'
    loop = machine.loop.contour_constant
    if any(place.startswith('loop.') for place in machine.source):
        for pair, value in machine.contour_constant.items():
            if not 1.0 / _FAR <= value / loop <= _FAR:
                yield (
                    f'contour_constant.{pair}: {value:.3g} s² is {value / loop:.2g} times what '
                    f'the gains of loop give, {loop:.3g} s²; the constant is used'
                )


def _axis_doubts(name: str, axis: AxisData) -> Iterator[str]:
    place, limits, plant = f'axes.{name}', axis.limits, axis.plant
    velocity, acceleration, _ = limits.positioning
    if velocity > limits.velocity or acceleration > limits.acceleration:
        yield f'{place}.limits: the way to a position is faster than the limits of the axis'
    if plant is None:
        return
    if axis.knowledge.not_fit_for_control:
        yield f'{place}: not fit for control: {axis.knowledge.not_fit_for_control}'
    if isinstance(plant, BallscrewAxisConfig):
        rise = plant.force_max / plant.mass
        viscous = 0.5 * (plant.viscous_forward + plant.viscous_backward)
        full = plant.force_max / viscous
        friction = max(plant.coulomb_forward, plant.coulomb_backward) / plant.force_max
        if acceleration > rise:
            yield (
                f'{place}.limits.positioning_acceleration: {acceleration:g} m/s² is more than '
                f'the drive can give the mass, {rise:.3g} m/s²'
            )
    else:
        full, friction = plant.gain, plant.breakaway
    if velocity > full:
        yield (
            f'{place}.limits.velocity: {1e3 * velocity:g} mm/s is more than full duty drives, '
            f'{1e3 * full:.4g} mm/s'
        )
    if friction > limits.friction:
        yield (
            f'{place}.limits.friction: {100 * limits.friction:g} % of full duty is less than the '
            f'friction of the plant, {100 * friction:.3g} %'
        )
    if plant.count == 0.0 and plant.noise == 0.0:
        yield f'{place}.plant.count: neither counts nor noise; a real sensor has one of them'

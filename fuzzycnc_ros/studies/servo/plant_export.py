# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated axes as C99: drive, mechanics and sensor, equal to those in Python to the last bit."""

from __future__ import annotations

from math import pi
from typing import Any

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.machine.machine_data import PlantConfig
from fuzzycnc_ros.core.servo.constants import Constant
from fuzzycnc_ros.simulation.servo.axes import (
    DutyDelay,
    ModalSwing,
    drive_keep,
    substep_shares,
)
from fuzzycnc_ros.studies.servo.c_text import ExportOrigin, number, portable_numbers, rendered


def hal_plant(plant: PlantConfig, origin: ExportOrigin) -> str:
    """Return an axis as a component of LinuxCNC's HAL, the source that halcompile takes.

    Raises
    ------
    ValueError
        If the name is none of C.
    """
    return rendered('plant.comp', _values(plant), origin)


def _values(plant: PlantConfig) -> dict[str, Any]:
    """Return what the templates need of an axis."""
    periodic = plant.sensor == 'encoder' and plant.periodic_error != 0.0
    swings: tuple[float, ...] = ()
    if isinstance(plant, LatheAxisConfig):
        model, own = 'lags', _lags(plant)
    else:
        model, own = 'mass', _mass(plant)
        if plant.mode:
            swings = ModalSwing(plant).numbers
    return {
        'model': model,
        'constants': [
            *_common(plant),
            *own,
            *(_periodic(plant) if periodic else ()),
        ],
        'periodic': periodic,
        'swings': [number(one) for one in swings],
        'noise': number(plant.noise),
        **portable_numbers(),
    }


def _common(plant: PlantConfig) -> list[Constant]:
    delay = DutyDelay(plant.delay, plant.period)
    return [
        Constant('DUTY_MAX', plant.duty_max, '-', 'Largest magnitude of duty'),
        Constant('DIRECTION', plant.direction, '-', 'Sign of the velocity of a positive duty'),
        Constant('DELAY_PART', delay.part, '-', 'Part of a period that the dead time ends in'),
        Constant('BACKLASH', plant.backlash, 'm', 'Way that the screw turns freely'),
        Constant('COUNT', plant.count, 'm', 'One count of the sensor; 0 for no counts'),
        Constant('PITCH_ERROR', plant.pitch_error, '-', 'Error of the lead per way'),
        Constant('HELD', delay.periods, '', 'Duties that are kept for the dead time'),
        Constant('ENCODER', plant.sensor == 'encoder', '', 'Encoder on the screw, or a grating'),
    ]


def _periodic(plant: PlantConfig) -> list[Constant]:
    return [
        Constant('PERIODIC_ERROR', plant.periodic_error, 'm', 'Error once per turn of the screw'),
        Constant('TURN', 2.0 * pi / plant.screw_lead, 'rad/m', 'Turn of the screw per way'),
    ]


def _lags(plant: LatheAxisConfig) -> list[Constant]:
    amplify, build, keep, sense = substep_shares(plant)
    step = 0.5 * plant.period / plant.substeps
    return [
        Constant('GAIN', plant.gain, 'm/s', 'Steady velocity at full duty'),
        Constant('COULOMB', plant.coulomb, '-', 'Friction in motion, as duty'),
        Constant('BREAKAWAY', plant.breakaway, '-', 'Friction at the onset of motion'),
        Constant('STRIBECK_VELOCITY', plant.stribeck_velocity, 'm/s', 'Over which it falls'),
        Constant('HALF_STEP', step, 's', 'Half a substep'),
        Constant('AMPLIFY', amplify, '-', 'Share of its way that the amplifier goes in one'),
        Constant('BUILD', build, '-', 'Share of its way that the torque goes'),
        Constant('KEEP', keep, '-', 'Share of its deviation that the velocity keeps'),
        Constant('SENSE', sense, '-', 'Share of its way that the sensor goes'),
        Constant('SUBSTEPS', plant.substeps, '', 'Steps of the simulation per period'),
    ]


def _mass(plant: BallscrewAxisConfig) -> list[Constant]:
    keep = drive_keep(plant) if plant.drive_lag else 0.0
    return [
        Constant('PERIOD', plant.period, 's', 'Control period'),
        Constant('MASS', plant.mass, 'kg', 'Moved mass, motor included'),
        Constant('FORCE_MAX', plant.force_max, 'N', 'Force at full duty'),
        Constant('OFFSET', plant.offset, 'N', 'Steady force against positive motion'),
        Constant('VISCOUS_FORWARD', plant.viscous_forward, 'N s/m', 'Viscous friction, forward'),
        Constant('VISCOUS_BACKWARD', plant.viscous_backward, 'N s/m', 'The same, backward'),
        Constant('COULOMB_FORWARD', plant.coulomb_forward, 'N', 'Coulomb friction, forward'),
        Constant('COULOMB_BACKWARD', plant.coulomb_backward, 'N', 'The same, backward'),
        Constant('BREAKAWAY_RATIO', plant.breakaway_ratio, '-', 'Friction at rest over Coulomb'),
        Constant('STRIBECK_VELOCITY', plant.stribeck_velocity, 'm/s', 'Over which it falls'),
        Constant('DRIVE_LAG', plant.drive_lag, 's', 'Time constant of the force; 0 for none'),
        Constant('DRIVE_KEEP', keep, '-', 'Share of its deviation that the force keeps'),
    ]

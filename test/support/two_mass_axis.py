# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Axes as real ones are and no model here: elastic, with backlash, dead time, cogging."""

from dataclasses import dataclass
from math import exp, pi, sin, sqrt

import numpy as np

from fuzzycnc_ros.core.identify.axis_fit import AxisRecording
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.simulation.servo.axes import AxisPlant, DutyDelay


@dataclass(frozen=True, kw_only=True)
class TwoMassConfig:
    """A motor and a slide with a spring between them."""

    motor: float = 60.0  # kg, as moved mass
    slide: float = 40.0
    resonance: float = 145.0  # Hz, of the free pair
    spring_damping: float = 0.05
    force: float = 400.0  # N at full duty
    viscous: float = 180.0  # N s/m
    coulomb: float = 20.0  # N
    breakaway: float = 30.0
    stribeck: float = 5e-3  # m/s
    backlash: float = 5e-6
    delay: float = 1e-3
    count: float = 1e-6
    noise: float = 0.0
    cogging: float = 0.0  # N
    pitch: float = 0.024  # m
    direction: float = 1.0
    gain: float = 1.0
    load: float = 0.0  # duty
    load_time: float = 0.0
    period: float = 1e-3
    substeps: int = 40
    seed: int = 0


class TwoMassAxis(AxisPlant):
    """The slide is what counts; the motor's encoder is what is read."""

    duty_max = 1.0

    def __init__(self, config):
        self.config, self.period = config, config.period
        self._delay = DutyDelay(config.delay, config.period)
        self._x = self._y = self._v = self._w = 0.0
        reduced = config.motor * config.slide / (config.motor + config.slide)
        self._stiff = reduced * (2.0 * pi * config.resonance) ** 2
        self._damp = 2.0 * config.spring_damping * sqrt(self._stiff * reduced)
        self._draw, self._step = np.random.default_rng(config.seed), 0
        self._read()

    @property
    def position(self):
        return self._y

    @property
    def velocity(self):
        return self._w

    def measure(self):
        return self._reading

    def drive(self, duty):
        c = self.config
        force = c.direction * c.gain * c.force * self._delay.of(self._cut(duty))
        force -= c.force * c.load * (self._step * self.period >= c.load_time)
        step, play = self.period / c.substeps, 0.5 * c.backlash
        x, y, v, w = self._x, self._y, self._v, self._w
        for _ in range(c.substeps):
            twist = x - y
            gap = twist - play if twist > play else twist + play if twist < -play else 0.0
            spring = self._stiff * gap + (self._damp * (v - w) if gap else 0.0)
            v += step * (force - spring + c.cogging * sin(2.0 * pi * x / c.pitch)) / c.motor
            free = w + step * (spring - c.viscous * w) / c.slide
            ratio = w / c.stribeck
            rub = step * (c.coulomb + (c.breakaway - c.coulomb) * exp(-ratio * ratio)) / c.slide
            w = free - rub if free > rub else free + rub if free < -rub else 0.0
            x, y = x + step * v, y + step * w
        self._x, self._y, self._v, self._w = x, y, v, w
        self._step += 1
        self._read()

    def linear(self):
        c = self.config
        mass = c.motor + c.slide
        return LinearAxis.chain(c.force / c.viscous, {}, mass / c.viscous, period=c.period)

    def _read(self):
        c = self.config
        noisy = self._x + c.noise * self._draw.standard_normal()
        self._reading = round(noisy / c.count) * c.count


UNSEEN = {
    'two masses, 145 Hz': TwoMassConfig(),
    'belt, 60 Hz, 2 ms': TwoMassConfig(
        motor=4.0, slide=8.0, resonance=60.0, force=90.0, viscous=60.0, coulomb=5.0,
        breakaway=6.0, backlash=0.0, delay=2e-3, count=2.5e-6,
    ),
    'linear motor, cogging': TwoMassConfig(
        motor=18.0, slide=2.0, resonance=320.0, force=300.0, viscous=30.0, coulomb=2.0,
        breakaway=2.5, backlash=0.0, delay=2.5e-4, count=1e-7, cogging=4.0,
    ),
}  # fmt: skip


def operated(plant, acceleration, seconds=4.0, seed=0, width=25.0):
    """Record an axis that a weak proportional-derivative loop moves about."""
    draw = np.random.default_rng(seed)
    rows, target, speed, last = [], 0.0, 0.0, plant.measure()
    for step in range(round(seconds / plant.period)):
        if step % 700 == 0:
            target = draw.uniform(-0.1, 0.1) * (0.1 if draw.random() < 0.3 else 1.0)
        place = plant.measure()
        speed, last = 0.9 * speed + 0.1 * (place - last) / plant.period, place
        pull = float(np.clip(width**2 / acceleration * (target - place), -0.6, 0.6))
        duty = float(np.clip(pull - 1.4 * width / acceleration * speed, -1.0, 1.0))
        rows.append((duty, place, target))
        plant.drive(duty)
    duty, place, target = np.array(rows).T
    return AxisRecording(duty, place, plant.period, target)

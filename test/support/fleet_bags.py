# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Small bags of machines that warm up, and work that ends its process."""

import os
import signal
from pathlib import Path

import numpy as np

from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.runtime.records import SECOND, Displacement, Temperatures
from fuzzycnc_ros.studies.published_bag import PublishedBag

SAMPLES, SENSORS = 300, ('front', 'rear', 'bed')
FIRST_DAY, DAY = 1_767_600_000 * SECOND, 86_400 * SECOND


def warm_up(seed: int, drift: float = 0.0, samples: int = SAMPLES) -> ThermalRun:
    """Return a run of a machine that warms up and cools down; `drift` it has beside that [m]."""
    rng = np.random.default_rng(seed)
    time = 60.0 * np.arange(samples)
    half = time[-1] / 2.0
    heat = np.where(time < half, 1 - np.exp(-time / 1800), np.exp(-(time - half) / 1800))
    heat *= rng.uniform(0.9, 1.1)
    noise = rng.standard_normal((samples, len(SENSORS) + 2))
    return ThermalRun(
        name=str(seed),
        time=time,
        sensor=SENSORS,
        temperature=20.0 + np.outer(heat, (8.0, 5.0, 3.0)) + 0.05 * noise[:, :-2],
        channel=('y', 'z'),
        axis=('Y', 'Z'),
        displacement=np.outer(heat, (12e-6, 6e-6)) + drift * heat[:, None] + 1e-7 * noise[:, -2:],
    )


def write_bag(run: ThermalRun, path: Path, begin: int, machine: str) -> None:
    """Write a run into a bag that begins at a time [ns]."""
    with PublishedBag(path, machine=machine) as bag:
        for time, temperature, displacement in zip(
            run.time, run.temperature, run.displacement, strict=True
        ):
            stamp = begin + round(time * SECOND)
            known = np.isfinite(temperature)
            bag(
                'displacement',
                Displacement(
                    stamp=stamp,
                    frame_id=f'{machine}/workpiece',
                    axis=run.axis,
                    channel=run.channel,
                    displacement=displacement,
                    standard_deviation=np.full(len(displacement), 1e-7),
                    includes_compensation=False,
                ),
            )
            bag(
                'temperatures',
                Temperatures(
                    stamp=stamp,
                    frame_id=f'{machine}/machine',
                    sensor=run.sensor,
                    temperature=np.where(known, temperature, 0.0),
                    status=np.where(known, 0, 1).astype(np.uint8),
                    readings=1,
                ),
            )


def doubled_or_killed(piece: tuple[int, str]) -> int:
    """Return twice a number; a word kills this process, a path does so the first time."""
    number, fate = piece
    if fate == 'killed' or (fate and not Path(fate).exists()):
        if fate != 'killed':
            Path(fate).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number

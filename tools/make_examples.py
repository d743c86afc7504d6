#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Write the recordings and part programs of `examples/` anew, from the simulated machines.

Usage: tools/make_examples.py [--check]

`examples/README.md` says what each file is.  Figures are rounded as a logger would, so that other
versions of numpy give the same files.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from fuzzycnc_ros.core.feedrate.path.curves import butterfly  # noqa: E402
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig  # noqa: E402
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig  # noqa: E402
from fuzzycnc_ros.core.servo.pid_cascade import PidController  # noqa: E402
from fuzzycnc_ros.core.thermal.run import ThermalRun  # noqa: E402
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes  # noqa: E402
from fuzzycnc_ros.simulation.servo.axes import LatheAxis  # noqa: E402
from fuzzycnc_ros.simulation.servo.positioning import position  # noqa: E402
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples  # noqa: E402
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet  # noqa: E402
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack  # noqa: E402
from fuzzycnc_ros.simulation.thermal.duties import record_runs  # noqa: E402

RPM = np.pi / 30.0
DAYS = {'monday': 'T1', 'tuesday': 'D0b', 'wednesday': 'T2'}
"""Which duty of the simulated mill each day has."""

SENSORS = np.linspace(2, 74, 12).astype(int)
"""Twelve of the mill's 76 sensors: what a shop would glue on."""


def table(header: Sequence[str], rows: Iterable[Sequence[str]], sign: str = ',') -> str:
    """Return a text of columns."""
    return ''.join(sign.join(row) + '\n' for row in (header, *rows))


def recording(run: ThermalRun) -> str:
    """Return a run of the mill: seconds, degC, rpm and um, a row a minute."""
    names = [f't{number}' for number in range(1, len(SENSORS) + 1)]
    assert run.spindle_speed is not None
    rows = (
        [
            f'{run.time[k]:.0f}',
            *(f'{value:.2f}' for value in run.temperature[k, SENSORS]),
            f'{run.spindle_speed[k] / RPM:.0f}',
            *(f'{1e6 * value:.1f}' for value in run.displacement[k]),
        ]
        for k in range(len(run.time))
    )
    return table(['t', *names, 'rpm', 'y', 'z'], rows)


def export(run: ThermalRun) -> str:
    """Return a run as a German spreadsheet exports it: dates, decimal commas, semicolons."""
    start = datetime(2026, 3, 2, 6, 30)
    header = [
        'Zeit',
        *(f'T{number}' for number in range(1, len(SENSORS) + 1)),
        'Y [mm]',
        'Störung',
    ]
    rows = []
    for k, time in enumerate(run.time):
        values = [f'{value:.2f}' for value in run.temperature[k, SENSORS]]
        values.append(f'{1e3 * run.displacement[k, 0]:.4f}')
        stamp = start + timedelta(seconds=float(time))
        rows.append([f'{stamp:%d.%m.%Y %H:%M:%S}', *(v.replace('.', ',') for v in values), ''])
    return table(header, rows, ';')


def foam() -> str:
    """Return 265 samples of drift on the simulated sheet."""
    header = ['direction_deg', 'depth_mm', 'type', 'step_mm', 'thickness_mm', 's_x_mm', 's_y_mm']
    x, s = foam_samples(0)
    rows = zip(x.tolist(), s.tolist(), strict=True)
    return table(header, ([*(f'{v:g}' for v in a), *(f'{v:.4f}' for v in b)] for a, b in rows))


def stitched() -> str:
    """Return a parallelogram on the simulated sheet, where its stitches came to lie."""
    track = FoamTrack.parallelogram(np.radians(45.0))
    sheet = FoamSheet(0.015, (0.15, 0.1))
    found = sheet.stitch(track.points, 0.006, rng=np.random.default_rng(1))
    rows = ([f'{v:.3f}' for v in row] for row in 1e3 * np.hstack([track.points, found]))
    return table(['x_mm', 'y_mm', 'stitched_x_mm', 'stitched_y_mm'], rows)


def quilt() -> str:
    """Return the same parallelogram as a part program."""
    track = FoamTrack.parallelogram(np.radians(45.0))
    (x, y), *others = (1e3 * track.points[list(track.corners)]).tolist()
    lines = ['(a parallelogram on a sheet of 150 x 100 mm)', 'G21 G90', 'G0 Z5']
    lines += [f'G0 X{x:.3f} Y{y:.3f}', 'G1 Z-1 F300']
    lines += [f'G1 X{a:.3f} Y{b:.3f} F1200' for a, b in others]
    return '\n'.join([*lines, 'G0 Z5', 'M30', ''])


def part() -> str:
    """Return ten lines with corners and an arc."""
    return """(part)
G21 G90 G17 G64 P0.02
G0 X0 Y0 Z0
G1 X8 F1500
Y6
G3 X5 Y9 I-3 J0
G1 X0
X-3 Y5
Y1
X0 Y0
M2
"""


def butterfly_program() -> str:
    """Return the butterfly of the interpolator literature as 2000 lines in 0.01 um."""
    (x, y), *rest = (1e3 * butterfly(0.875).point(np.linspace(0.0, 1.0, 2001))).tolist()
    lines = [f'G1 X{a:.5f} Y{b:.5f}' for a, b in rest]
    return '\n'.join(['G21 G90 G17', f'G0 X{x:.5f} Y{y:.5f}', 'F12000', *lines, 'M2', ''])


def moves() -> str:
    """Return four moves of the lathe axis under a PID, with pauses between."""
    rows, start = [], 1.0
    for seed, target in enumerate((-0.19, -0.05, 0.05, 0.19)):
        axis = LatheAxis(LatheAxisConfig(seed=seed))
        run = position(PidController(axis.config.linear()), axis, target, 1.0)
        columns = zip(run.time, run.reference, run.measured, run.duty, strict=True)
        rows += [
            [f'{start + t:.3f}', f'{1e3 * r:g}', f'{1e3 * p:.6f}', f'{u:.6f}']
            for t, r, p, u in columns
        ]
        start += 2.0
    return table(['t', 'reference', 'position', 'duty'], rows)


def circle() -> str:
    """Return two seconds of a circle of 20 mm that gets faster, commanded and actual."""
    machine = ContouringConfig()
    time = machine.interpolation_period * np.arange(round(2.0 / machine.interpolation_period))
    angle = 2.5 * time + 1.25 * time**2
    commanded = 0.02 * np.column_stack([np.cos(angle) - 1.0, np.sin(angle)])
    actual = np.vstack([commanded[:1], ContouringAxes(commanded[0], machine).follow(commanded)])
    rows = (
        [f'{t:.4f}', *(f'{1e3 * v:.4f}' for v in (*x, *y))]
        for t, x, y in zip(time, commanded, actual, strict=False)
    )
    return table(['t', 'xc', 'yc', 'xa', 'ya'], rows)


def files() -> Iterator[tuple[str, bytes]]:
    """Yield the name and the content of each file."""
    runs = record_runs(list(DAYS.values()))
    for day, duty in DAYS.items():
        yield f'{day}.csv', recording(runs[duty]).encode()
    yield 'Export.csv', export(runs['T1']).encode('cp1252')
    made = {
        'samples.csv': foam,
        'stitched.csv': stitched,
        'quilt.ngc': quilt,
        'part.ngc': part,
        'butterfly.ngc': butterfly_program,
        'moves.csv': moves,
        'circle.csv': circle,
    }
    for name, make in made.items():
        yield name, make().encode()


def main() -> int:
    """Write the files, or with --check say which of them are not what would be written."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('--check', action='store_true')
    check = parser.parse_args().check
    stale = []
    for name, content in files():
        path = ROOT / 'examples' / name
        if not path.exists() or path.read_bytes() != content:
            stale.append(name)
            if not check:
                path.write_bytes(content)
    if stale:
        print(f'{"out of date" if check else "written"}: {", ".join(stale)}')
    return int(check and bool(stale))


if __name__ == '__main__':
    sys.exit(main())

#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Draw the pictures of README and docs from runs of the simulated machines: `make pictures`.

They are SVG without scripts, whose text and axes follow the reader's light or dark theme; a
photograph is PNG.
"""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import cv2  # noqa: E402
from matplotlib import colormaps  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.collections import LineCollection  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from fuzzycnc_ros import feedrate, soft  # noqa: E402
from fuzzycnc_ros.core.deformation.samples import RecordedPath, samples_of_paths  # noqa: E402
from fuzzycnc_ros.core.deformation.stitch_design import PlacedRun, run_path  # noqa: E402
from fuzzycnc_ros.core.deformation.stitch_path import LINE  # noqa: E402
from fuzzycnc_ros.core.deformation.trial_lines import trial_plan, trial_runs  # noqa: E402
from fuzzycnc_ros.core.feedrate.path.curves import butterfly  # noqa: E402
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig  # noqa: E402
from fuzzycnc_ros.core.servo.axis_control import make_controller  # noqa: E402
from fuzzycnc_ros.core.thermal.band import WIDTH  # noqa: E402
from fuzzycnc_ros.core.thermal.fit import train_model  # noqa: E402
from fuzzycnc_ros.simulation.motion.contouring import identify_contour_constant  # noqa: E402
from fuzzycnc_ros.simulation.servo.axes import LatheAxis  # noqa: E402
from fuzzycnc_ros.simulation.servo.positioning import position  # noqa: E402
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples  # noqa: E402
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet  # noqa: E402
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack  # noqa: E402
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES  # noqa: E402
from fuzzycnc_ros.studies.page.drawing import (  # noqa: E402
    AFTER,
    ANOTHER,
    BEFORE,
    FAINT,
    INK,
    MUTED,
    PALETTE,
    THEME,
    plot_style,
)
from fuzzycnc_ros.studies.shift.learnt_days import joined, learn_days  # noqa: E402
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration, run_shift  # noqa: E402
from fuzzycnc_ros.studies.soft.design_files import read_design  # noqa: E402
from fuzzycnc_ros.studies.soft.design_page import design_chart  # noqa: E402
from fuzzycnc_ros.studies.soft.rendered_photo import Camera, rendered_photo  # noqa: E402
from fuzzycnc_ros.studies.soft.sheet_marks import marks_around  # noqa: E402

LIGHT, DARK = (
    ' '.join(f'--{name}: {colours[number]};' for name, colours in PALETTE.items())
    for number in range(2)
)
STYLE = f"""<style>
svg {{ {LIGHT} }}
@media (prefers-color-scheme: dark) {{ svg {{ {DARK} }} }}
text {{ font-family: system-ui, sans-serif !important; }}
MOTION</style>"""

TAG, METADATA = re.compile(r'<[^>]*>'), re.compile(r'<metadata>.*?</metadata>', re.S)

DRAWN = """@media (prefers-reduced-motion: no-preference) {
  #p-before path, #p-after path { stroke-dasharray: 1; animation: draw 9s linear infinite; }
  #p-said { animation: say 9s linear infinite; }
}
@keyframes draw {
  0%, 25%, 80%, 100% { stroke-dashoffset: 0; }
  25.1% { stroke-dashoffset: 1; }
}
@keyframes say { 0%, 25% { opacity: 1; } 25.1%, 80% { opacity: 0; } 86%, 100% { opacity: 1; } }
"""
"""The whole picture first, for a glance; then the curves are drawn in five seconds."""


def drawing(width: float, height: float) -> tuple[Any, Any]:
    """Return a transparent figure of a size [in] and its axes."""
    figure = Figure(figsize=(width, height), layout='constrained')
    figure.patch.set_alpha(0.0)
    return figure, figure.subplots()


def inline_svg(figure: Any) -> str:
    """Return a figure as an SVG element without size; colours with a meaning are CSS variables."""
    stream = StringIO()
    with warnings.catch_warnings():
        # The page's fonts show the text; matplotlib only measures it by its own.
        warnings.filterwarnings('ignore', 'Glyph .* missing from font')
        figure.savefig(stream, format='svg', metadata={'Date': None, 'Creator': None})
    text = stream.getvalue()
    head, body = text[text.index('<svg') :].split('>', 1)
    found = re.sub(r' (?:width|height)="[^"]*"', '', head) + '>' + METADATA.sub('', body)
    for colour, variable in THEME.items():
        found = found.replace(colour, f'var({variable})')
    # Text keeps its decimals: it is read.
    found = TAG.sub(lambda tag: re.sub(r'(\d\.\d\d)\d+', r'\1', tag[0]), found)
    return re.sub(r'(\bid="|url\(#|xlink:href="#)', r'\g<1>p-', found).strip()


def svg(figure: Any, motion: str = '') -> str:
    """Return a figure as a file of its own."""
    width, height = (round(72 * size) for size in figure.get_size_inches())
    head, _, body = inline_svg(figure).partition('>')
    body = re.sub(r'(<g id="p-(?:before|after)">\s*<path )', r'\1pathLength="1" ', body)
    # Names of clipped areas are hashes of what differs in its last digits from run to run.
    for number, name in enumerate(dict.fromkeys(re.findall(r'url\(#([^)]+)\)', body)), 1):
        body = body.replace(name, f'clip-{number}')
    style = STYLE.replace('MOTION', motion)
    return f'{head} width="{width}" height="{height}">\n{style}{body}\n'


def _say(
    axes: Axes, text: str, at: tuple[float, float], offset: int, side: str, colour: str
) -> None:
    """Write at a time and a share of the height, some points above."""
    axes.annotate(
        text,
        at,
        (0, offset),
        xycoords=('data', 'axes fraction'),
        textcoords='offset points',
        ha='center',
        va=side,
        color=colour,
        size=11,
        weight='bold',
    )


def learnt() -> str:
    """Return three days of the mill: its error, what probes have taught of it, and the probes."""
    days = learn_days()
    whole = joined(days)
    hours = whole.time / 3600.0
    figure = Figure(figsize=(8.0, 4.6), layout='constrained')
    figure.patch.set_alpha(0.0)
    panels = figure.subplots(len(MILL_AXES), 1, sharex=True)
    ends = np.cumsum([day.time[-1] for day in days]) / 3600.0
    begins = [0.0, *ends[:-1]]
    for c, (axis, axes) in enumerate(zip(MILL_AXES, panels, strict=True)):
        center, half = 1e6 * whole.predicted[:, c], 1e6 * WIDTH * whole.deviation[:, c]
        error = 1e6 * whole.error[:, c]
        axes.fill_between(
            hours,
            center - half,
            center + half,
            color=FAINT,
            alpha=0.35,
            linewidth=0.0,
            label='its band',
        )
        axes.plot(hours, error, color=BEFORE, linewidth=2.2, label='error')
        axes.plot(hours, center, color=AFTER, linewidth=1.6, label='learnt')
        axes.plot(
            hours,
            1e6 * whole.probed[:, c],
            'o',
            color=INK,
            markersize=5.0,
            label='probe, one an hour',
        )
        left = error + 1e6 * whole.applied[:, c]
        axes.plot(hours, left, color=ANOTHER, linewidth=1.6, label='with compensation')
        low, high = np.nanmin(error), np.nanmax(error)
        room = high - low
        axes.set_ylim(low - 0.55 * room, high + 0.3 * room)
        axes.set_ylabel(f'error of {axis} [µm]')
        for begin, end, day in zip(begins, ends, days, strict=True):
            if begin:
                axes.axvline(begin, color=MUTED, linewidth=0.8, linestyle=(0, (1, 2)))
            found = day.figures()[axis]
            said = f'{found["uncompensated_rms_um"]:.1f} → {found["applied_rms_um"]:.1f} µm rms'
            _say(axes, said, (0.5 * (begin + end), 0.0), 4, 'bottom', AFTER)
    for number, (begin, end) in enumerate(zip(begins, ends, strict=True), 1):
        _say(panels[0], f'day {number}', (0.5 * (begin + end), 1.0), -2, 'top', INK)
    panels[-1].set_xlim(0.0, ends[-1])
    panels[-1].set_xlabel(
        'time in operation [h], each day from cold; rms: without compensation → with'
    )
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper left', ncol=5)
    return svg(figure)


def drift() -> str:
    """Return the error of the mill on a duty that its model has not seen, before and after."""
    calibration = record_calibration()
    model = train_model(calibration.runs)
    (run,) = run_shift(model.to_json(), calibration, ('T2',))
    at = run.channel.index('Y')
    hours = (run.time - run.time[0]) / 3600.0
    before, after = 1e6 * run.measured[:, at], 1e6 * run.residual()[:, at]
    figure, axes = drawing(8.0, 2.7)
    for name, colour, values in (('before', BEFORE, before), ('after', AFTER, after)):
        (line,) = axes.plot(hours, values, color=colour, linewidth=2.2)
        line.set_gid(name)
    axes.set(
        xlabel='time since the machine was switched on [h]', ylabel='error of the Y axis [µm]'
    )
    axes.set_xlim(0.0, hours[-1])
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.06 * (high - low), high)
    worst, left = abs(before).max(), abs(after).max()
    top = np.argmax(abs(before))
    said = [
        axes.annotate(
            f'without: {worst:.0f} µm',
            (hours[top], before[top]),
            (-70, -2),
            textcoords='offset points',
            ha='right',
            va='top' if before[top] > 0 else 'bottom',
            color=BEFORE,
            size=13,
            weight='bold',
        ),
        axes.annotate(
            f'with fuzzycnc: {left:.1f} µm at most',
            (0.98 * hours[-1], after.max() if before[top] > 0 else after.min()),
            (0, 6 if before[top] > 0 else -6),
            textcoords='offset points',
            ha='right',
            va='bottom' if before[top] > 0 else 'top',
            color=AFTER,
            size=13,
            weight='bold',
        ),
    ]
    for text in said:
        text.set_gid('said')
    return svg(figure, DRAWN)


def feeds() -> str:
    """Return the butterfly, coloured by the feed that keeps 0.05 mm."""
    curve = butterfly(0.875)
    constant = identify_contour_constant()
    limits = feedrate.MotionLimits(path_velocity=0.2, path_acceleration=1.5)
    motion = feedrate.schedule(curve, tolerance=50e-6, machine_constant=constant, limits=limits)
    samples = motion.sample(20e-3)
    place = 1e3 * samples.position
    speed = 6e4 * np.linalg.norm(samples.velocity, axis=1)
    figure, axes = drawing(5.6, 4.2)
    parts = list(np.stack([place[:-1], place[1:]], axis=1))
    light = ListedColormap(colormaps['plasma'](np.linspace(0.25, 1.0, 64)))  # legible on black
    lines = LineCollection(parts, array=speed[:-1], cmap=light, linewidths=2.6)
    axes.add_collection(lines)
    axes.autoscale_view()
    axes.set_aspect('equal')
    axes.set(xlabel='X [mm]', ylabel='Y [mm]')
    bar = figure.colorbar(lines, ax=axes, label='feed [mm/min]', shrink=0.9)
    bar.outline.set_visible(False)
    return svg(figure)


def servo() -> str:
    """Return the error of the lathe axis on the way to -50 mm."""
    figure, axes = drawing(7.2, 3.2)
    for name, colour, choice in (
        ('as published', BEFORE, 'variable_universe_paper'),
        ('PID', MUTED, 'pid'),
        ('variable universe with observer', AFTER, 'variable_universe'),
    ):
        plant = LatheAxis(LatheAxisConfig())
        run = position(make_controller(choice, plant.config.linear()), plant, -50e-3, 1.5)
        away = 1e6 * np.abs(run.error)
        axes.semilogy(run.time, np.maximum(away, 0.1), color=colour, label=name)
    axes.yaxis.set_major_formatter('{x:g}')
    axes.axhline(2.0, color=INK, linewidth=0.8, linestyle='--')
    axes.annotate('2 µm', (1.5, 2.0), (-2, 3), textcoords='offset points', ha='right', color=INK)
    axes.set(xlabel='time [s]', ylabel='distance to the target [µm]', xlim=(0.0, 1.5))
    axes.legend(loc='upper right', bbox_to_anchor=(1.0, 0.9))
    return svg(figure)


def sheet() -> str:
    """Return a parallelogram stitched on the simulated sheet, before and after."""
    track = FoamTrack.parallelogram(np.radians(45.0))
    foam = FoamSheet(0.015, (0.15, 0.1))
    model = soft.train(*foam_samples(0), random_state=0)
    path = soft.StitchPath(track.points, depth=6e-3, step=3e-3)
    found = soft.compensate(path, model, soft.SheetMaterial(0.015, (0.15, 0.1)))
    figure, axes = drawing(5.6, 3.6)
    axes.plot(*(1e3 * track.points.T), color=INK, linewidth=0.8, linestyle='--', label='asked for')
    for name, colour, points in (
        ('stitched as it is', BEFORE, track.points),
        ('compensated', AFTER, found.commanded),
    ):
        stitched = 1e3 * foam.stitch(points, 6e-3, rng=np.random.default_rng(1))
        axes.plot(*stitched.T, color=colour, linewidth=1.8, label=name)
    axes.set_aspect('equal')
    axes.set(xlabel='X [mm]', ylabel='Y [mm]')
    axes.legend(loc='upper left')
    return svg(figure)


AREA = (0.2, 0.12)
QUILT = soft.SheetMaterial(15e-3, AREA)
DEPTH, STEP, MARGIN = 6e-3, 3e-3, 16e-3
"""Sheet and foot of the tutorial on straight patterns [m]."""


def _stitched_trial() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the runs of the trial as planned and as stitched [m]."""
    rng = np.random.default_rng(0)
    foam = FoamSheet(QUILT.thickness, AREA).scattered(rng)
    runs = trial_runs(trial_plan(8, STEP), AREA, MARGIN)
    return [(run, foam.stitch(run, DEPTH, rng=rng)) for run in runs]


def trial() -> bytes:
    """Return a photograph of the trial on the simulated sheet."""
    runs = [stitched for _, stitched in _stitched_trial()]
    camera = Camera(pixel=0.24e-3, noise=1.0)
    photo = rendered_photo(runs, marks_around(AREA), AREA, camera, np.random.default_rng(0))
    photo = photo // 16 * 17  # 16 shades: a sixth of the file
    return bytes(cv2.imencode('.png', photo)[1].tobytes())


def design() -> str:
    """Return the quilt of the tutorial: planned, as it would be stitched, and commanded."""
    recorded = []
    for plan, stitched in _stitched_trial():
        steps = len(plan) - 1
        step = float(np.median(np.hypot(*np.diff(plan, axis=0).T)))
        recorded.append(
            RecordedPath(
                path_id='trial',
                material=QUILT,
                nominal=plan,
                offset=np.zeros_like(plan),
                stitched=stitched,
                primitive=np.zeros(steps, np.int64),
                kind=np.full(steps, float(LINE)),
                turn=np.zeros(steps),
                depth=np.full(steps, DEPTH),
                step=np.full(steps, step),
            )
        )
    samples = samples_of_paths(recorded)
    model = soft.train(samples.x, samples.s)
    page = (ROOT / 'docs' / 'tutorials' / 'straight-patterns.md').read_text(encoding='utf-8')
    with TemporaryDirectory() as folder:
        quilt = Path(folder) / 'quilt.svg'
        quilt.write_text(page.split('```xml\n')[1].split('```')[0], encoding='utf-8')
        source = read_design(quilt, STEP).design
    middle = 0.5 * (source.points.min(axis=0) + source.points.max(axis=0))
    runs = []
    for run in source.runs():
        points = source.points[run] + 0.5 * np.array(AREA) - middle
        path = run_path(points, DEPTH, STEP)
        assert path is not None
        found = soft.compensate(path, model, QUILT)
        runs.append(PlacedRun(points, found.commanded, found.offset))
    (panel,) = design_chart(runs).panels
    curves = panel.series
    low, high = (edge(np.concatenate([(one.x, one.y) for one in curves], 1), axis=1)
                 for edge in (np.nanmin, np.nanmax))  # fmt: skip
    width, height = high - low + [10.0, 15.0]
    figure, axes = drawing(width / 25.4, height / 25.4)
    axes.set_position((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    for one in curves:
        axes.plot(one.x, one.y, color=one.colour, linewidth=one.width, label=one.name)
    axes.set_xlim(low[0] - 5.0, low[0] - 5.0 + width)
    axes.set_ylim(low[1] - 10.0, low[1] - 10.0 + height)
    axes.legend(loc='lower left', ncols=3, fontsize=7.0, borderpad=0.2)
    return svg(figure)


PICTURES: dict[str, Callable[[], str | bytes]] = {
    'learnt': learnt,
    'drift': drift,
    'feedrate': feeds,
    'servo': servo,
    'soft': sheet,
    'soft_trial': trial,
    'soft_design': design,
}


def main() -> int:
    """Write the pictures, all or those that are named."""
    names = sys.argv[1:] or list(PICTURES)
    unknown = set(names) - set(PICTURES)
    if unknown:
        raise SystemExit(f'expected names of {", ".join(PICTURES)} but found {", ".join(unknown)}')
    for name in names:
        with plot_style():
            drawn = PICTURES[name]()
        ending, content = ('svg', drawn.encode()) if isinstance(drawn, str) else ('png', drawn)
        path = ROOT / 'docs' / 'figures' / f'{name}.{ending}'
        path.write_bytes(content)
        print(f'{path.relative_to(ROOT)}: {len(content) / 1e3:.0f} kB')
    return 0


if __name__ == '__main__':
    sys.exit(main())

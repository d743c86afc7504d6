# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Photographs of stitches, drawn: with slant, lens, shadow, blur and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.studies.requirement import require
from fuzzycnc_ros.studies.soft.sheet_marks import Mark, mark_cells

_FINE = 0.05e-3  # grid of the drawing [m]
_EDGE = 10e-3  # of the table around the sheet [m]
_CLOTH, _TABLE, _THREAD, _HOLE_SHADE = 205, 120, 70, 25
_THREAD_WIDTH, _HOLE_RADIUS, _TUCK = 0.42e-3, 0.18e-3, 0.2e-3


@dataclass(frozen=True)
class Camera:
    """Camera settings of a photograph.

    Parameters
    ----------
    pixel : float
        Length of a pixel on the sheet [m].
    slant : float
        How much shorter the far side looks, as a share.
    turn : float
        Angle by which the sheet lies askew [rad].
    bend : float
        Radial distortion of the lens at a corner, as a share.
    blur : float
        Standard deviation of the blur [pixel].
    noise : float
        Standard deviation of the noise [shades of 256].
    shadow : float
        Share of the light that a shadow takes.
    exposure : float
        Share of the light that a good photograph takes.
    """

    pixel: float = 0.1e-3
    slant: float = 0.06
    turn: float = 0.03
    bend: float = -0.02
    blur: float = 0.8
    noise: float = 4.0
    shadow: float = 0.35
    exposure: float = 1.0


def rendered_photo(
    runs: Sequence[Array],
    marks: Sequence[Mark],
    size: tuple[float, float],
    camera: Camera,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return a photograph of a sheet in shades of grey, shape (rows, columns).

    Parameters
    ----------
    runs : sequence of ndarray, shape (k, 2)
        Where the stitches of each run lie [m].
    marks : sequence of Mark
        Marks on the sheet.
    size : tuple of float
        The sheet from the origin [m].
    camera : Camera
        How it is taken.
    rng : Generator
        Draws the cloth, the shadow and the noise.
    """
    cv2 = require('cv2')
    flat = _drawn(runs, marks, size, rng)
    rows, columns = (round((length + 2.0 * _EDGE) / camera.pixel) for length in size[::-1])
    # Where each pixel of the photograph looks: lens, then turn and slant about the middle.
    across, down = np.meshgrid(np.arange(columns), np.arange(rows))
    middle, scale = 0.5 * np.array([columns, rows]), 0.5 * np.hypot(columns, rows)
    u, v = (across - middle[0]) / scale, (down - middle[1]) / scale
    for _ in range(4):  # the distortion is known from the sheet to the photograph
        factor = 1.0 + camera.bend * (u * u + v * v)
        u, v = (across - middle[0]) / scale / factor, (down - middle[1]) / scale / factor
    depth = 1.0 + camera.slant * v
    u, v = u / depth, v / depth
    sine, cosine = np.sin(camera.turn), np.cos(camera.turn)
    x = (cosine * u + sine * v) * scale * camera.pixel + 0.5 * size[0]
    y = (cosine * v - sine * u) * scale * camera.pixel + 0.5 * size[1]
    sharp = cv2.GaussianBlur(flat, (0, 0), 0.4 * camera.pixel / _FINE)
    photo = cv2.remap(
        sharp,
        ((x + _EDGE) / _FINE).astype(np.float32),
        ((y + _EDGE) / _FINE).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.float32)
    light = camera.exposure * (1.0 + 0.15 * (across / columns - 0.5) - 0.1 * (down / rows - 0.5))
    edge = np.tanh(8.0 * (across / columns - rng.uniform(0.4, 0.7) + 0.3 * (down / rows - 0.5)))
    light = light * (1.0 - camera.shadow * 0.5 * (1.0 + edge))
    photo = cv2.GaussianBlur(photo * light.astype(np.float32), (0, 0), max(camera.blur, 1e-3))
    photo = photo + rng.normal(0.0, camera.noise, photo.shape)
    return np.asarray(np.clip(np.round(photo), 0, 255), np.uint8)


def _drawn(
    runs: Sequence[Array],
    marks: Sequence[Mark],
    size: tuple[float, float],
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return the sheet from above on a fine grid, a table around it."""
    cv2 = require('cv2')
    columns, rows = (round((length + 2.0 * _EDGE) / _FINE) for length in size)
    weave = cv2.resize(
        rng.normal(0.0, 7.0, (rows // 8, columns // 8)).astype(np.float32), (columns, rows)
    )
    image = np.clip(_CLOTH + weave, 0, 255).astype(np.uint8)
    edge = round(_EDGE / _FINE)
    for part in (image[:edge], image[-edge:], image[:, :edge], image[:, -edge:]):
        part[:] = _TABLE

    def pixel(point: Array) -> tuple[int, int]:
        x, y = (point[0] + _EDGE) / _FINE, (size[1] - point[1] + _EDGE) / _FINE
        return round(16 * x - 8), round(16 * y - 8)  # from the middle of a pixel

    for mark in marks:
        left, top = ((value + 8) // 16 for value in pixel(mark.corners()[0]))
        side = round(mark.size / _FINE)
        cells = cv2.resize(255.0 * mark_cells(mark), (side, side), interpolation=cv2.INTER_NEAREST)
        rim = side // 8
        image[top - rim : top + side + rim, left - rim : left + side + rim] = 255
        image[top : top + side, left : left + side] = cells
    width = round(_THREAD_WIDTH / _FINE)
    for run in runs:
        for first, last in pairwise(run):
            way = last - first
            length = float(np.hypot(*way))
            if length <= 2.0 * _TUCK:
                continue
            tuck = way * _TUCK / length
            ends = pixel(first + tuck), pixel(last - tuck)
            cv2.line(image, *ends, _THREAD, width, cv2.LINE_AA, 4)
            cv2.line(image, *ends, _THREAD + 50, max(width // 4, 1), cv2.LINE_AA, 4)
        for point in run:
            radius = round(16 * _HOLE_RADIUS / _FINE)
            cv2.circle(image, pixel(point), radius, _HOLE_SHADE, -1, cv2.LINE_AA, 4)
    return image

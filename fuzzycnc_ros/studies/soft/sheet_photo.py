# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Stitches measured on a photograph: by marks of known places, each stitch beside its plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.training import robust_deviation
from fuzzycnc_ros.studies.requirement import require
from fuzzycnc_ros.studies.soft.sheet_marks import LEAST, Mark, dictionary

THREAD = 0.45e-3
"""Width of a thread that is looked for [m]."""
HOLE = 0.4e-3
"""Length of the gap between two stitches [m]."""
REACH = 12e-3
"""Farthest place of a stitch from its plan [m]."""
PIXELS_MAX = 120_000_000
"""Largest photograph, and largest sheet of it [pixels]."""

SCORE = 0.3
"""Least likeness of a stitch, a correlation, to be taken for one."""
STRAY = 6.0
"""Distance from the neighbours, in robust standard deviations, that is an outlier."""
STRAY_MIN = 0.4e-3
"""Least such distance [m]."""
MARKS_OFF = 0.1e-3
"""Largest RMS error of the marks' places [m]."""

_WINDOW = 1.8e-3  # half the side of what is compared around a stitch [m]
_NEAR = 0.8e-3  # reach of the second look [m]
_CANDIDATES = 80
_BENT, _MOVED = 0.12, 0.5  # by which displacements bend and change, as shares of the stitch
_NOISE = 0.1e-3  # by which a stitch is off by itself [m]
_UNLIKE, _UNSEEN = 12.0, 7.0  # cost of a likeness of 0, and of a stitch that is not seen
_COURSES, _RIVALS = 100, 4
_STEADY = 9.0  # largest cost of a bend
_START = 1.5e-3  # how far the first stitch of a run is off, before the sheet is dragged [m]
_LIGHTER, _DARKER, _LIKE_THREAD = 0, 1, 150
_GRAINS = 25.0  # light beside which the noise of a photograph is small, as a multiple of it [-]
_GLARE = 2.5e-3  # what is wider is no thread [m]


@dataclass(frozen=True, eq=False)
class SheetView:
    """Camera model of a sheet: a homography, and the first radial distortion of its lens.

    Attributes
    ----------
    homography : ndarray, shape (3, 3)
        Points of the sheet [mm] to pixels without distortion.
    middle : ndarray, shape (2,)
        Middle of the image [pixel].
    scale : float
        Half of its diagonal [pixel].
    bend : float
        Radial distortion at a corner of the image, as a share of the distance.
    marks : int
        Marks that were found.
    residual : float
        What their corners are off their places, root mean square [m].
    pixel : float
        Length of a pixel on the sheet [m].
    """

    homography: Array
    middle: Array
    scale: float
    bend: float
    marks: int
    residual: float
    pixel: float

    def pixels(self, points: Array) -> Array:
        """Return where points of the sheet [m] are seen, shape (n, 2) [pixel]."""
        return _seen(self.homography, self.bend, self.middle, self.scale, 1e3 * points)


@dataclass(frozen=True, eq=False)
class MeasuredRuns:
    """Stitches of a photograph.

    Attributes
    ----------
    runs : list of ndarray, shape (k, 2)
        Where the stitches of each run lie [m]; of those that were not found, where their
        neighbours lead one to expect them.
    found : list of ndarray of bool, shape (k,)
        Whether each was found.
    view : SheetView
        How the camera saw the sheet.
    """

    runs: list[Array]
    found: list[NDArray[np.bool_]]
    view: SheetView

    def lost(self) -> list[str]:
        """Return the stitches that were not found, by name."""
        return [
            f'run {run + 1}: stitch {int(place) + 1}'
            for run, found in enumerate(self.found)
            for place in np.flatnonzero(~found)
        ]


def read_photo(path: Path) -> NDArray[np.uint8]:
    """Read a photograph in shades of grey, shape (rows, columns).

    Raises
    ------
    ValueError
        If it is none, or too large.
    """
    cv2 = require('cv2')
    if not path.is_file():
        raise ValueError(f'{path}: expected a photograph but found no file')
    content = np.frombuffer(path.read_bytes(), np.uint8)
    try:
        image = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    except cv2.error:
        image = None
    if image is None:
        raise ValueError(f'{path}: expected a photograph (JPEG, PNG, TIFF) but it cannot be read')
    if image.size > PIXELS_MAX:
        raise ValueError(
            f'{path}: expected at most {PIXELS_MAX // 10**6} million pixels but found '
            f'{image.size // 10**6}'
        )
    return np.asarray(image, np.uint8)


def sheet_view(image: NDArray[np.uint8], marks: Sequence[Mark]) -> SheetView:
    """Return how the camera saw the sheet, from its marks.

    Raises
    ------
    ValueError
        If fewer than three of the marks are seen.
    """
    cv2 = require('cv2')
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary(), settings).detectMarkers(image)
    known = {mark.number: mark for mark in marks}
    seen: dict[int, Array] = {}
    for number, place in zip(
        [] if numbers is None else numbers.ravel().tolist(), corners, strict=True
    ):
        if number in known:
            seen[number] = place.reshape(4, 2).astype(float)
    if len(seen) < LEAST:
        raise ValueError(
            f'expected {LEAST} marks or more of {", ".join(map(str, sorted(known)))} in the '
            f'photograph but found {", ".join(map(str, sorted(seen))) or "none"}; photograph the '
            'whole sheet, sharp and without glare'
        )
    places = 1e3 * np.concatenate([known[number].corners() for number in seen])
    pixels = np.concatenate(list(seen.values()))
    rows, columns = image.shape
    middle, scale = 0.5 * np.array([columns, rows], float), 0.5 * float(np.hypot(columns, rows))
    first, _ = cv2.findHomography(places, pixels)
    lens = len(seen) > LEAST + 1  # fewer marks tell no lens from a slanted sheet

    def off(values: Array) -> Array:
        matrix = np.append(values[:8], 1.0).reshape(3, 3)
        return np.asarray(
            (_seen(matrix, values[8] if lens else 0.0, middle, scale, places) - pixels).ravel()
        )

    start = np.append((first / first[2, 2]).ravel()[:8], 0.0)
    fit = least_squares(off, start, x_scale=np.maximum(np.abs(start), 1e-6), loss='soft_l1')
    homography = np.append(fit.x[:8], 1.0).reshape(3, 3)
    bend = float(fit.x[8]) if lens else 0.0
    centre = places.mean(axis=0)
    steps = _seen(homography, bend, middle, scale, centre + np.array([[0, 0], [1, 0], [0, 1]]))
    pixel = 1e-3 / float(np.sqrt(abs(np.linalg.det(steps[1:] - steps[0]))))
    residual = pixel * float(np.sqrt(2.0 * np.mean(off(fit.x) ** 2)))
    return SheetView(homography, middle, scale, bend, len(seen), residual, pixel)


def _seen(homography: Array, bend: float, middle: Array, scale: float, points: Array) -> Array:
    """Return where points of the sheet [mm] are seen [pixel]."""
    whole = np.column_stack([points, np.ones(len(points))]) @ homography.T
    flat = whole[:, :2] / whole[:, 2:] - middle
    apart = (flat**2).sum(axis=1, keepdims=True) / scale**2
    return np.asarray(middle + flat * (1.0 + bend * apart))


def measure_runs(
    image: NDArray[np.uint8],
    view: SheetView,
    marks: Sequence[Mark],
    planned: Sequence[Array],
    size: tuple[float, float],
) -> MeasuredRuns:
    """Return where the stitches of each run lie on a sheet.

    Around each planned stitch the photograph is compared with what its neighbours make of it:
    two stitches that meet, or the end of a thread.  Of all likenesses the row is taken whose
    displacements go on most steadily along the run; a second look has the directions of the first.

    Parameters
    ----------
    image : ndarray of uint8, shape (rows, columns)
        The photograph.
    view : SheetView
        How the camera saw the sheet.
    marks : sequence of Mark
        Marks on it, which are no stitches.
    planned : sequence of ndarray, shape (k, 2)
        Where the stitches of each run were commanded [m].
    size : tuple of float
        The sheet from the origin [m].

    Raises
    ------
    ValueError
        If the sheet has more pixels than can be measured.
    """
    grid = float(np.clip(0.8 * view.pixel, 0.04e-3, 0.2e-3))
    way = sum(float(np.hypot(*np.diff(points, axis=0).T).sum()) for points in planned)
    flat = _flat_thread(image, view, marks, size, grid, way * THREAD / (size[0] * size[1]))
    looks = []
    count = sum(map(len, planned))
    for needle in (_DARKER, _LIGHTER):
        holes = _holes(flat, grid, count, needle)
        first = [_matched(flat, holes, points, REACH, grid, size, needle) for points in planned]
        ways = [
            [_cleaned(*seen, way)[0] for way in _courses(points, *seen, _START)[:_RIVALS]]
            for points, seen in zip(planned, first, strict=True)
        ]
        runs, founds, likeness = [], [], []
        for points, rivals in zip(planned, ways, strict=True):
            tried = [_again(flat, holes, points + places, grid, size, needle) for places in rivals]
            best = max(tried, key=lambda look: look[2])
            for _ in range(_RIVALS):
                others = [
                    _again(flat, holes, other, grid, size, needle)
                    for other in _miscounted(points, best[0])
                ]
                better = max(others, key=lambda look: look[2])
                if better[2] <= best[2]:
                    break
                best = better
            runs.append(best[0])
            founds.append(best[1])
            likeness.append(best[2])
        looks.append((float(np.mean(likeness)), runs, founds))
    # Where the needle went in, one thread sinks into a dark hole and another shows the cloth.
    _, runs, founds = max(looks, key=lambda look: look[0])
    return MeasuredRuns(runs, founds, view)


def _again(
    flat: NDArray[np.float32],
    holes: NDArray[np.float32],
    places: Array,
    grid: float,
    size: tuple[float, float],
    needle: int,
) -> tuple[Array, NDArray[np.bool_], float]:
    """Return stitches found close to places, with what they look like there."""
    seen = _matched(flat, holes, places, _NEAR, grid, size, needle)
    shift, found, likeness = _cleaned(*seen, _courses(places, *seen, _NEAR)[0])
    return places + shift, found, likeness


def _miscounted(planned: Array, places: Array) -> list[Array]:
    """Return the places if one stitch was passed over, or one was counted that is none."""
    way = np.hypot(*np.diff(places, axis=0).T) / np.maximum(
        np.hypot(*np.diff(planned, axis=0).T), 1e-6
    )
    wide, narrow = int(way.argmax()), int(way.argmin())
    passed = np.insert(places, wide + 1, 0.5 * (places[wide] + places[wide + 1]), axis=0)[:-1]
    added = np.delete(places, narrow + 1, axis=0)
    return [passed, np.concatenate([added, [2.0 * added[-1] - added[-2]]])]


def _flat_thread(
    image: NDArray[np.uint8],
    view: SheetView,
    marks: Sequence[Mark],
    size: tuple[float, float],
    grid: float,
    share: float,
) -> NDArray[np.float32]:
    """Return how much of a thread, which covers a share of the sheet, is at each place of it."""
    cv2 = require('cv2')
    columns, rows = (round(length / grid) + 1 for length in size)
    if columns * rows > PIXELS_MAX:
        raise ValueError(
            f'--size: expected a sheet of at most {PIXELS_MAX // 10**6} million pixels of '
            f'{1e3 * grid:.2f} mm but found {columns * rows // 10**6}'
        )
    places = np.empty((rows, columns, 2), np.float32)
    x = np.arange(columns) * grid
    for row in range(rows):
        y = np.full(columns, size[1] - row * grid)
        places[row] = view.pixels(np.column_stack([x, y]))
    flat = cv2.remap(image, places, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    width = 2 * round(0.5 * _GLARE / grid) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    # In a dark photograph, noise is as large a share of the light as a thread is.
    grain = float(np.median(cv2.absdiff(flat, cv2.medianBlur(flat, 3))))
    found = []
    for dark in (True, False):
        kind = cv2.MORPH_CLOSE if dark else cv2.MORPH_OPEN
        around = cv2.blur(cv2.morphologyEx(flat, kind, kernel), (width, width))
        around = np.maximum(around.astype(np.float32), 1.0)
        light = np.hypot(around, _GRAINS * grain)
        part = np.maximum((around - flat) / light * (1.0 if dark else -1.0), 0.0)
        for mark in marks:
            left, right = (mark.middle[0] + side * mark.size for side in (-0.7, 0.7))
            low, high = (size[1] - mark.middle[1] + side * mark.size for side in (-0.7, 0.7))
            window = [max(round(place / grid), 0) for place in (low, high, left, right)]
            part[window[0] : window[1], window[2] : window[3]] = 0.0
        found.append(part)
    # The other polarity sees the noise of the cloth alone.
    rare = 1.0 - float(np.clip(0.3 * share, 1e-5, 0.1))
    contrast = [float(np.quantile(part, rare)) for part in found]
    thread = found[int(np.argmax(contrast))] / max(*contrast, 1e-6)
    return np.asarray(np.minimum(thread, 1.5), np.float32)


def _matched(
    flat: NDArray[np.float32],
    holes: NDArray[np.float32],
    points: Array,
    reach: float,
    grid: float,
    size: tuple[float, float],
    needle: int,
) -> tuple[Array, Array]:
    """Return displacements of the likeliest places, shape (k, candidates, 2) [m], and likeness."""
    cv2 = require('cv2')
    half, far = round(_WINDOW / grid), round(reach / grid)
    rows, columns = flat.shape
    shift = np.zeros((len(points), _CANDIDATES, 2))
    score = np.full((len(points), _CANDIDATES), -1.0)
    for number, point in enumerate(points):
        likeness = _likeness(points, number, half, grid, needle)
        column, row = round(point[0] / grid), round((size[1] - point[1]) / grid)
        left, top = max(column - far - half, 0), max(row - far - half, 0)
        part = flat[
            top : min(row + far + half + 1, rows), left : min(column + far + half + 1, columns)
        ]
        if min(part.shape) < 2 * half + 1:
            continue
        found = cv2.matchTemplate(part, likeness, cv2.TM_CCOEFF_NORMED)
        rim = (
            slice(top + half, top + half + found.shape[0]),
            slice(left + half, left + half + found.shape[1]),
        )
        # A thread is alike all along: the hole tells where on it the stitch is.
        found = 0.5 * np.where(np.isfinite(found), found, -1.0) + 0.5 * holes[rim]
        found = found.astype(np.float32)
        peaks = (found == cv2.dilate(found, np.ones((5, 5), np.uint8))) & (found > 0.0)
        places = np.argwhere(peaks)
        best = places[np.argsort(-found[peaks])[:_CANDIDATES]]
        for rank, (down, across) in enumerate(best.tolist()):
            dy, dx = _between(found, down, across)
            x = (left + half + across + dx) * grid
            y = size[1] - (top + half + down + dy) * grid
            away = np.array([x, y]) - point
            if np.hypot(*away) <= reach:
                shift[number, rank], score[number, rank] = away, found[down, across]
    return shift, score


def _holes(flat: NDArray[np.float32], grid: float, count: int, needle: int) -> NDArray[np.float32]:
    """Return how much each place looks like a hole in a thread, from 0 to 1.

    A thread bends the image across itself alone.  A dark hole bends it the same way along the
    thread too, and a gap the other way.
    """
    cv2 = require('cv2')
    smooth = cv2.GaussianBlur(flat, (0, 0), 0.5 * HOLE / grid)
    xx, yy, xy = (
        cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3) for order in ((2, 0), (0, 2), (1, 1))
    )
    half, apart = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    along, across = half + apart, half - apart
    bent = np.where(across < 0.0, -along if needle == _DARKER else np.minimum(along, -across), 0.0)
    bent = np.maximum(bent, 0.0).astype(np.float32)
    side = 2 * round(HOLE / grid) + 1
    peaks = bent[bent == cv2.dilate(bent, np.ones((side, side), np.uint8))]
    usual = float(np.median(np.sort(peaks)[-count:])) if len(peaks) else 0.0
    return np.asarray(np.minimum(bent / max(usual, 1e-9), 1.0))


def _likeness(
    points: Array, number: int, half: int, grid: float, needle: int
) -> NDArray[np.float32]:
    """Return what a stitch and its neighbours look like, with it in the middle."""
    cv2 = require('cv2')
    finer = 4
    side = finer * (2 * half + 1)
    image = np.zeros((side, side), np.uint8)
    middle = 0.5 * (side - 1)
    for other in (number - 1, number + 1):
        if not 0 <= other < len(points):
            continue
        way = (points[other] - points[number]) / grid
        length = float(np.hypot(*way))
        hole = 0.5 * HOLE / grid
        if length < 2.0 * hole:
            continue
        ends = [way * hole / length, way * (1.0 - hole / length)]
        pixels = [tuple(round(16 * (middle + finer * c)) for c in (x, -y)) for x, y in ends]
        width = max(round(finer * THREAD / grid), 1)
        cv2.line(image, pixels[0], pixels[1], _LIKE_THREAD, width, cv2.LINE_AA, 4)
    centre, radius = (round(16 * middle),) * 2, round(16 * finer * 0.5 * HOLE / grid)
    cv2.circle(image, centre, radius, 255 * needle, -1, cv2.LINE_AA, 4)
    small = cv2.resize(image, (2 * half + 1, 2 * half + 1), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small.astype(np.float32) / 255.0, (0, 0), 1.0))


def _between(found: Any, down: int, across: int) -> tuple[float, float]:
    """Return where between pixels a peak lies, from the parabolas through its neighbours."""
    result = []
    for axis, place in ((0, down), (1, across)):
        if not 0 < place < found.shape[axis] - 1:
            result.append(0.0)
            continue
        row = (
            found[place - 1 : place + 2, across]
            if axis == 0
            else found[down, place - 1 : place + 2]
        )
        low, mid, high = (float(value) for value in row)
        bend = low - 2.0 * mid + high
        result.append(float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0)
    return result[0], result[1]


def _courses(points: Array, shift: Array, score: Array, start: float) -> list[NDArray[np.intp]]:
    """Return which likeness each stitch has, -1 for none, where displacements go on steadily.

    The best comes first; others end elsewhere.
    """
    count = len(points)
    cost, last, speed = np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2))
    course: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
    for number in range(count):
        some = np.flatnonzero(score[number] > 0.0)
        step = np.hypot(*(points[number] - points[max(number - 1, 0)])) if number else 0.0
        if number:
            bent = ((shift[number, some] - (last + speed)[:, np.newaxis]) ** 2).sum(axis=-1)
            moved = ((shift[number, some] - last[:, np.newaxis]) ** 2).sum(axis=-1)
            bent = np.minimum(bent / (_BENT * step + _NOISE) ** 2, _STEADY)
            drawn = bent + moved / (_MOVED * step + _NOISE) ** 2
        else:
            off = (shift[0, some] ** 2).sum(axis=-1)
            drawn = off[np.newaxis] / start**2
        total = cost[:, np.newaxis] + drawn + _UNLIKE * (1.0 - score[number, some])
        # A stitch that is not seen goes on as the last ones did.
        total = np.column_stack([total, cost + _UNSEEN])
        kept = np.argsort(total, axis=None, kind='stable')[:_COURSES]
        before, chosen = np.unravel_index(kept, total.shape)
        unseen = chosen == len(some)
        which = np.append(some, 0)[chosen]
        here = np.where(unseen[:, np.newaxis], (last + speed)[before], shift[number, which])
        speed = here - last[before] if number else np.zeros_like(here)
        cost, last = total.ravel()[kept], here
        course.append((before, np.where(unseen, -1, which)))
    ways: list[NDArray[np.intp]] = []
    ends: list[Array] = []
    for rank in range(len(cost)):
        if any(np.hypot(*(last[rank] - end)) < _NEAR for end in ends):
            continue
        ends.append(last[rank])
        place, picked = rank, np.empty(count, np.intp)
        for number in range(count - 1, -1, -1):
            before, which = course[number]
            picked[number] = which[place]
            place = int(before[place])
        ways.append(picked)
    return ways


def _cleaned(
    shift: Array, score: Array, picked: NDArray[np.intp]
) -> tuple[Array, NDArray[np.bool_], float]:
    """Return displacements without strays, which stitches were found, and their likeness."""
    count = len(picked)
    rows = np.arange(count), np.maximum(picked, 0)
    score = np.where((picked < 0)[:, np.newaxis], 0.0, score)
    places, found = shift[rows], score[rows] >= SCORE
    for _ in range(3):
        if found.sum() < 3:
            return np.zeros_like(places), np.zeros(count, bool), 0.0
        expected = _expected(places, found)
        off = np.hypot(*(places - expected).T)
        limit = max(STRAY * robust_deviation(off[found]), STRAY_MIN)
        now = (score[rows] >= SCORE) & (off <= limit)
        if (now == found).all():
            break
        found = now
    expected = _expected(places, found)
    likeness = float(np.mean(score[rows]))
    return np.where(found[:, np.newaxis], places, expected), found, likeness


def _expected(places: Array, found: NDArray[np.bool_]) -> Array:
    """Return what the neighbours of each stitch say of its displacement: local lines."""
    number = np.arange(len(places), dtype=float)
    known = np.flatnonzero(found)
    result = np.empty_like(places)
    for at in range(len(places)):
        others = known[known != at]
        near = others[np.argsort(np.abs(others - at), kind='stable')[:4]]
        if len(near) < 3:
            result[at] = np.median(places[near], axis=0) if len(near) else 0.0
            continue
        # The median of the lines through two of them: one stray cannot bend it.
        lines = [
            places[i]
            + (places[j] - places[i]) * (number[at] - number[i]) / (number[j] - number[i])
            for k, i in enumerate(near)
            for j in near[k + 1 :]
        ]
        result[at] = np.median(lines, axis=0)
    return result

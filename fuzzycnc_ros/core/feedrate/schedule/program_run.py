# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One run of a part program: from its blocks to their feeds and to the time that it takes.

Everything is pulled through in parts, so that memory is bounded by how far the scheduler and the
limits look ahead; rules that link the whole path hold a run as a whole.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from math import inf, isnan, nan, pi
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.blocks import Block
from fuzzycnc_ros.core.feedrate.gcode.segments import ArcSegment, LineSegment, Segment
from fuzzycnc_ros.core.feedrate.path.nodes import (
    NodePlan,
    near_neighbours,
    own_curvature,
    with_nodes,
)
from fuzzycnc_ros.core.feedrate.path.reference_path import PathBuilder, ReferencePath
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
from fuzzycnc_ros.core.feedrate.schedule.scheduler import Scheduler

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.path.reference_path import ReferencePath

GROUP = 1024
"""Blocks that share a feed at most: so many are held back."""

_CORE, _EDGE, _BLEND = range(3)


class _BlockFeeds:
    """The feed of each block of a run, from parts of its path.

    A block gets the smallest feed of its pieces.  Blends with its neighbours count only where
    they make up half of it or more: elsewhere the controller slows down for them by itself.  So
    it does where only a neighbour asks for less, near the ends of a block.

    Parameters
    ----------
    plan : NodePlan
        How far neighbours count.
    step : float
        Neighbouring blocks share the lowest of their feeds where the highest is no more than
        this share above it [-].
    own : callable
        Told the index of a block; returns the curvature that it has by itself all along [1/m],
        infinite where that varies.
    """

    def __init__(self, plan: NodePlan, step: float, own: Callable[[int], float]) -> None:
        self._plan = plan
        self._step = 1.0 + step
        self._own = own
        self._open: tuple[int, list[Array]] | None = None
        self._next = 0  # index of the next block to be settled
        self._group = 0  # blocks that share a feed so far, from `_low` to `_high`
        self._low, self._high = inf, -inf
        self._last = nan

    def take(self, path: ReferencePath, feed: Array) -> list[float]:
        """Take the feeds of a part's pieces, (m,) [m/s]; return those of the next blocks."""
        first = np.flatnonzero(np.diff(path.owner, prepend=-1))
        index = path.owner[first]
        sums = self._sums(path, feed, first)
        if self._open is not None:
            if self._open[0] == index[0]:
                before = self._open[1]
                for total, own, merge in zip(
                    sums, before, (np.minimum, np.add, np.maximum, np.maximum), strict=True
                ):
                    total[:, 0] = merge(total[:, 0], own)
            else:
                index = np.append(self._open[0], index)
                sums = [
                    np.column_stack([own, total])
                    for own, total in zip(self._open[1], sums, strict=True)
                ]
        self._open = int(index[-1]), [total[:, -1].copy() for total in sums]
        return self._settle(index[:-1], self._feeds(index[:-1], [one[:, :-1] for one in sums]))

    def finish(self, count: int) -> list[float]:
        """Return the feeds of the remaining ones of `count` blocks."""
        found: list[float] = []
        if self._open is not None:
            index = np.array([self._open[0]])
            sums = [total[:, np.newaxis] for total in self._open[1]]
            found += self._settle(index, self._feeds(index, sums))
            self._open = None
        rest = count - self._next
        if rest and isnan(self._last):  # all of them are too short: they keep their own feeds
            return [nan] * rest
        if rest:  # too short for pieces of their own
            found += self._settle(np.array([count - 1]), np.array([self._last]))
        return found + self._merged()

    def _sums(self, path: ReferencePath, feed: Array, first: NDArray[np.intp]) -> list[Array]:
        """Return least feed, length, largest curvature and feed by kind of piece and block."""
        bend = own_curvature(path.geometry).max(axis=1)
        own = np.array([self._own(index) for index in path.owner[first].tolist()])
        count = np.diff(np.append(first, len(path.owner)))
        near = near_neighbours(path, np.repeat(own, count), bend, self._plan)
        length = np.diff(path.geometry.node)
        kind = np.where(path.blend & ~_within_blocks(path), _BLEND, np.where(near, _EDGE, _CORE))
        chosen = kind == np.arange(3)[:, np.newaxis]
        return [
            np.minimum.reduceat(np.where(chosen, feed, inf), first, axis=1),
            np.add.reduceat(np.where(chosen, length, 0.0), first, axis=1),
            np.maximum.reduceat(np.where(chosen, bend, 0.0), first, axis=1),
            np.maximum.reduceat(np.where(chosen, feed, 0.0), first, axis=1),
        ]

    def _feeds(self, index: NDArray[np.intp], sums: list[Array]) -> Array:
        """Return the feed of each block, shape (k,) [m/s]."""
        feed, length, bend, top = sums
        plain = np.minimum(feed[_CORE], feed[_EDGE])
        # A block that is all near its neighbours, and bends alike all along: what is lower
        # somewhere is so because of them.
        alike = np.array([self._own(at) < inf for at in index.tolist()], dtype=bool)
        found = np.where(alike & (length[_EDGE] > 0.0), top[_EDGE], plain)
        found = np.where(length[_CORE] > 0.0, feed[_CORE], found)
        for row in np.flatnonzero(bend[_EDGE] > 1.001 * bend[_CORE]).tolist():
            if self._own(int(index[row])) == inf:  # sharpest at its ends, by itself
                found[row] = plain[row]
        blended = length[_BLEND] >= 0.5 * length.sum(axis=0)
        return np.asarray(np.where(blended, np.minimum(plain, feed[_BLEND]), found))

    def _settle(self, index: NDArray[np.intp], feeds: Array) -> list[float]:
        """Return the feeds that are final with those of some blocks, which rise in index."""
        final: list[float] = []
        for at, feed in zip(index.tolist(), feeds.tolist(), strict=True):
            while self._next <= at:  # blocks too short for pieces of their own go with the next
                low, high = min(self._low, feed), max(self._high, feed)
                if self._group == GROUP or (self._group and high > self._step * low):
                    final += self._merged()
                    low = high = feed
                self._low, self._high = low, high
                self._group += 1
                self._next += 1
            self._last = feed
        return final

    def _merged(self) -> list[float]:
        found = [self._low] * self._group
        self._group, self._low, self._high = 0, inf, -inf
        return found


def _within_blocks(path: ReferencePath) -> NDArray[np.bool_]:
    """Return the pieces, (m,), that have one block from blend to blend, or as far as one goes.

    A blend is half of the block before it and half of the one behind: that of a corner within a
    curve is a bend of its own block.
    """
    first = np.flatnonzero(np.diff(path.blend, prepend=~path.blend[:1]))
    end = np.append(first[1:], len(path.blend))
    return np.repeat(path.owner[first] == path.owner[end - 1], end - first)


def stream_ratio(scheduler: Scheduler, parts: Iterable[SampledPath]) -> Iterator[Array]:
    """Return the ratios of an open path part by part, the same as of the whole path.

    Points leave as soon as all that their feed depends on has arrived; no more than the reach of
    the scheduler to both sides, and one part, is kept.

    Parameters
    ----------
    scheduler : Scheduler
        Scheduler whose reach is finite.
    parts : iterable of SampledPath
        Successive parts of the path, whose arc length goes on increasing from one to the next.

    Yields
    ------
    ndarray
        Ratios of the next points, as `Scheduler.ratio` gives them; altogether one for each point.

    Raises
    ------
    ValueError
        If the scheduler needs the whole path, or the arc lengths of the parts do not follow each
        other.
    """
    scheduler.check_streamable()
    reach = scheduler.reach
    kept: SampledPath | None = None
    done = 0  # points of `kept` whose ratios have left
    for part in parts:
        kept = part if kept is None else _joined(kept, part)
        ready = reach.ready(kept.arc_length)
        if ready <= done:
            continue
        yield scheduler.bounded_ratio(kept)[done:ready]
        first = reach.first_needed(kept.arc_length, ready)
        kept, done = _from_point(kept, first), ready - first
    if kept is not None:
        yield scheduler.bounded_ratio(kept)[done:]


def _from_point(path: SampledPath, first: int) -> SampledPath:
    """Return the path from a point on."""
    return SampledPath(
        path.arc_length[first:],
        path.curvature[first:],
        reversal=path.reversal[first:],
        programmed=None if path.programmed is None else path.programmed[first:],
    )


def _joined(path: SampledPath, part: SampledPath) -> SampledPath:
    """Return a path and the part after it as one."""
    return SampledPath(
        np.concatenate([path.arc_length, part.arc_length]),
        np.concatenate([path.curvature, part.curvature]),
        reversal=np.concatenate([path.reversal, part.reversal]),
        programmed=None
        if path.programmed is None or part.programmed is None
        else np.concatenate([path.programmed, part.programmed]),
    )


_CHUNK = 2048
"""Blocks that are taken at a time."""

_TURN = 2.0 * pi
"""Angle of an arc that counts as a block: arcs of many turns have as many pieces [rad]."""

QUIET = 1000
"""Blocks without motion after which a run is taken to be over."""


@dataclass(frozen=True, eq=False)
class ScheduledPath:
    """A stretch of a run with its feeds, m pieces.

    Attributes
    ----------
    path : ReferencePath
        The stretch.
    feed, programmed : ndarray, shape (m, 2)
        Feeds asked for at both ends of each piece, before the limits of the motion: of the
        words that the program gets, and of its own ones [m/s].
    first : bool
        A run begins with it.
    """

    path: ReferencePath
    feed: Array
    programmed: Array
    first: bool


Observer = Callable[[ScheduledPath], None]
"""Told of every stretch when its feeds are settled, in order."""


class BlockReader:
    """Blocks one by one, of which the next two may be looked at."""

    def __init__(self, blocks: Iterable[Block]) -> None:
        self._blocks = iter(blocks)
        self._next: Block | None = next(self._blocks, None)
        self._after: Block | None = next(self._blocks, None)

    @property
    def next(self) -> Block | None:
        """The next block, None after the last one."""
        return self._next

    @property
    def lone_line(self) -> LineSegment | None:
        """The line of the next block if it is a run of its own, None if not or not for sure."""
        segment = None if self._next is None else self._next.segment
        if not isinstance(segment, LineSegment) or not segment.schedulable:
            return None
        after = None if self._after is None else self._after.segment
        over = self._after is None or (after is not None and after.run != segment.run)
        return segment if over else None

    def take(self) -> Block:
        """Return the next block and go on."""
        block = self._next
        assert block is not None
        self._next, self._after = self._after, next(self._blocks, None)
        return block


class ProgramRun:
    """A run that is being scheduled.

    Parameters
    ----------
    settings : ProgramSettings
        How.
    source : BlockReader
        Where its blocks come from; the next one begins the run.
    observe : callable
        Told of every stretch when its feeds are settled.
    """

    def __init__(self, settings: ProgramSettings, source: BlockReader, observe: Observer) -> None:
        self._settings = settings
        self._source = source
        self._observe = observe
        self._plan = NodePlan.of(settings.scheduler)
        self._feeds = _BlockFeeds(self._plan, settings.feed_step, self._own)
        self._pending: deque[tuple[Block, int | None]] = deque()
        self._moves = 0  # segments taken
        self._bends: dict[int, float] = {}  # curvature of those that are no lines
        self._feed: deque[float] = deque()  # of the segments from `_base` on
        self._base = 0
        self._waiting: deque[ReferencePath] = deque()
        self._begun = False
        self._blend: float | None = None  # of its corners, once the first segment has come

    @property
    def corners(self) -> float:
        """Corner rounding of the path [m]."""
        return self._settings.blend if self._blend is None else self._blend

    def schedule(self) -> Iterator[tuple[Block, float | None]]:
        """Yield the blocks of the run, each with its feed [m/s], None where it has none."""
        settings = self._settings
        for path, ratio in self._rated():
            wanted = settings.wanted(np.minimum(ratio[:-1], ratio[1:]), settings.bound(path.feed))
            tangent = np.abs(path.geometry.derivative(1)).max(axis=1)
            feed = np.minimum(wanted, settings.reachable(tangent))
            self._feed.extend(self._feeds.take(path, feed))
            self._waiting.append(path)
            yield from self._release()
        self._feed.extend(self._feeds.finish(self._moves))
        yield from self._release()

    def _own(self, index: int) -> float:
        """Return the curvature that a segment has all along, infinite where it varies [1/m]."""
        return self._bends.get(index, 0.0)

    def _chunks(self) -> Iterator[tuple[list[Segment], bool]]:
        """Yield the segments of the run, and whether more come; its blocks become pending."""
        settings, run, quiet, taken = self._settings, None, 0, 0
        chunk: list[Segment] = []
        while (block := self._source.next) is not None and quiet < QUIET:
            segment = block.segment
            if segment is not None:
                rounding = settings.rounding(block.rounding)
                if run is None:
                    run, self._blend = segment.run, rounding
                if segment.run != run or rounding != self._blend:
                    break
            quiet = 0 if segment is not None else quiet + 1
            self._source.take()
            if segment is None or not segment.schedulable:
                self._pending.append((block, None))
            else:
                self._pending.append((block, self._moves))
                if isinstance(segment, ArcSegment):
                    self._bends[self._moves] = float(segment.curvatures(1).max())
                    taken += max(int(abs(segment.sweep) / _TURN) - 1, 0)
                elif not isinstance(segment, LineSegment):
                    self._bends[self._moves] = inf
                self._moves += 1
                chunk.append(segment)
            taken += 1
            if taken >= _CHUNK:
                yield chunk, True
                chunk, taken = [], 0
        yield chunk, False

    def _paths(self) -> Iterator[ReferencePath]:
        """Yield the reference path of the run in parts, with nodes for the scheduler."""
        builder: PathBuilder | None = None
        for chunk, more in self._chunks():
            if builder is None:
                builder = PathBuilder(blend=self.corners)
            parts = [builder.push(chunk)]
            if not more and builder.moved:  # not where the run is shorter than rounding
                parts.append(builder.finish())
            found = [part for part in parts if part is not None]
            if found:
                yield with_nodes(ReferencePath.join(found), self._plan)

    def _rated(self) -> Iterator[tuple[ReferencePath, Array]]:
        """Yield the parts of the path with the scheduler's ratios at their nodes."""
        arrived: deque[ReferencePath] = deque()

        def samples() -> Iterator[SampledPath]:
            first = 0
            for path in self._paths():
                arrived.append(path)
                node = path.place + path.geometry.node[first:]
                curvature = np.minimum(path.curvature[first:], self._settings.sharpest)
                bound = self._settings.bound(path.feed)
                # At a node between two feeds the larger one: it may be come from there.
                programmed = np.maximum(np.append(bound[0], bound), np.append(bound, bound[-1]))
                yield SampledPath(node, curvature, programmed=programmed[first:])
                first = 1  # the others begin with the last node of the one before

        scheduler = self._settings.scheduler
        if scheduler.reach.bounded:
            ratios = stream_ratio(scheduler, samples())
        else:
            whole = list(samples())
            ratios = iter([scheduler.bounded_ratio(_whole(whole))] if whole else [])
        known = np.empty(0)
        for ratio in ratios:
            known = np.append(known, ratio)
            while arrived and len(known) >= len(arrived[0].curvature):
                path = arrived.popleft()
                size = len(path.curvature)
                yield path, known[:size]
                known = known[size - 1 :]

    def _release(self) -> Iterator[tuple[Block, float | None]]:
        """Tell of the stretches and yield the blocks whose feeds are final."""
        final = self._base + len(self._feed)
        while self._waiting and self._waiting[0].owner[-1] < final:
            self._settle(self._waiting.popleft())
        if self._waiting:
            final = min(final, int(self._waiting[0].owner[0]))
        while self._pending:
            block, index = self._pending[0]
            if index is not None and index >= final:
                break
            self._pending.popleft()
            if index is None:
                yield block, None
                continue
            while self._base < index:
                self._feed.popleft()
                self._base += 1
            self._bends.pop(index, None)
            feed = self._feed[0]
            yield block, None if isnan(feed) else feed

    def _settle(self, path: ReferencePath) -> None:
        """Tell of a stretch whose blocks have their feeds: a block has one, all along."""
        low, high = int(path.owner[0]) - self._base, int(path.owner[-1]) - self._base
        chosen = np.array(list(islice(self._feed, low, high + 1)))[path.owner - path.owner[0]]
        feed = np.column_stack([chosen, chosen])
        programmed = np.column_stack([path.feed, path.feed])
        self._observe(ScheduledPath(path, feed, programmed, not self._begun))
        self._begun = True


def _whole(parts: list[SampledPath]) -> SampledPath:
    """Return the parts of a path as one."""
    return SampledPath(
        np.concatenate([part.arc_length for part in parts]),
        np.concatenate([part.curvature for part in parts]),
        programmed=np.concatenate([part.programmed for part in parts]),
    )

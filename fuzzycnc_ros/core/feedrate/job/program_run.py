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
from math import inf

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.job.program_feeds import BlockFeeds
from fuzzycnc_ros.core.feedrate.job.settings import ProgramSettings
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.program.blocks import Block
from fuzzycnc_ros.core.feedrate.program.segments import ArcSegment, LineSegment, Segment
from fuzzycnc_ros.core.feedrate.reference.nodes import NodePlan, with_nodes
from fuzzycnc_ros.core.feedrate.reference.reference_path import PathBuilder, ReferencePath
from fuzzycnc_ros.core.feedrate.schedulers.streaming import stream_ratio

CHUNK = 2048
"""Blocks that are taken at a time."""

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


class Source:
    """Blocks one by one, of which the next may be looked at."""

    def __init__(self, blocks: Iterable[Block]) -> None:
        self._blocks = iter(blocks)
        self._next: Block | None = next(self._blocks, None)

    @property
    def next(self) -> Block | None:
        """The next block, None after the last one."""
        return self._next

    def take(self) -> Block:
        """Return the next block and go on."""
        block = self._next
        assert block is not None
        self._next = next(self._blocks, None)
        return block


class ProgramRun:
    """A run that is being scheduled.

    Parameters
    ----------
    settings : ProgramSettings
        How.
    source : Source
        Where its blocks come from; the next one begins the run.
    observe : callable
        Told of every stretch when its feeds are settled.
    """

    def __init__(self, settings: ProgramSettings, source: Source, observe: Observer) -> None:
        self._settings = settings
        self._source = source
        self._observe = observe
        self._plan = NodePlan.of(settings.scheduler)
        self._feeds = BlockFeeds(self._plan, settings.feed_step, self._own)
        self._pending: deque[tuple[Block, int | None]] = deque()
        self._moves = 0  # segments taken
        self._bends: dict[int, float] = {}  # curvature of those that are no lines
        self._feed: deque[float] = deque()  # of the segments from `_base` on
        self._base = 0
        self._waiting: deque[ReferencePath] = deque()
        self._begun = False

    def schedule(self) -> Iterator[tuple[Block, float | None]]:
        """Yield the blocks of the run, each with its feed [m/s], None where it has none."""
        settings = self._settings
        for path, ratio in self._rated():
            wanted = settings.wanted(np.minimum(ratio[:-1], ratio[1:]), settings.bound(path.feed))
            feed = np.minimum(wanted, settings.reachable(path.geometry))
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
        run, quiet, taken = None, 0, 0
        chunk: list[Segment] = []
        while (block := self._source.next) is not None and quiet < QUIET:
            segment = block.segment
            if segment is not None:
                run = segment.run if run is None else run
                if segment.run != run:
                    break
            quiet = 0 if segment is not None else quiet + 1
            self._source.take()
            if segment is None or not segment.schedulable:
                self._pending.append((block, None))
            else:
                self._pending.append((block, self._moves))
                if isinstance(segment, ArcSegment):
                    self._bends[self._moves] = float(segment.curvatures(1).max())
                elif not isinstance(segment, LineSegment):
                    self._bends[self._moves] = inf
                self._moves += 1
                chunk.append(segment)
            taken += 1
            if taken == CHUNK:
                yield chunk, True
                chunk, taken = [], 0
        yield chunk, False

    def _paths(self) -> Iterator[ReferencePath]:
        """Yield the reference path of the run in parts, with nodes for the scheduler."""
        builder = PathBuilder(blend=self._settings.blend)
        for chunk, more in self._chunks():
            parts = [builder.push(chunk)]
            if not more:
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
        reach = scheduler.reach
        if np.isfinite([reach.length_behind, reach.length_ahead]).all():
            ratios = stream_ratio(scheduler, samples())
        else:
            whole = list(samples())
            ratios = iter([scheduler.bounded_ratio(_joined(whole))] if whole else [])
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
            yield block, self._feed[0]

    def _settle(self, path: ReferencePath) -> None:
        """Tell of a stretch whose blocks have their feeds: a block has one, all along."""
        low, high = int(path.owner[0]) - self._base, int(path.owner[-1]) - self._base
        chosen = np.array(list(islice(self._feed, low, high + 1)))[path.owner - path.owner[0]]
        feed = np.column_stack([chosen, chosen])
        programmed = np.column_stack([path.feed, path.feed])
        self._observe(ScheduledPath(path, feed, programmed, not self._begun))
        self._begun = True


def _joined(parts: list[SampledPath]) -> SampledPath:
    """Return the parts of a path as one."""
    return SampledPath(
        np.concatenate([part.arc_length for part in parts]),
        np.concatenate([part.curvature for part in parts]),
        programmed=np.concatenate([part.programmed for part in parts]),
    )

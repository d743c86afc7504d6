# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The jobs that a simulated machine gives itself, at times of a duty or one after the other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from fuzzycnc_ros.components.machine.path_programme import Programme
from fuzzycnc_ros.components.motion.tool_paths import curve_tool_path, program_tool_path
from fuzzycnc_ros.core.feedrate.path.curves import CURVES, SHEET_SCALES
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.records import ToolPath, nanoseconds

PATH, PROGRAM, MOVE = 'path', 'program', 'move'
ENGAGE = 0.1
"""Time from unclamping the axes to what they are to do [s]: a controller has taken them over."""
SETTLE = 0.25
"""Time from the end of a job to clamping the axes [s]: they have arrived."""
_SYNTAX = 'SECONDS:path:butterfly, SECONDS:program or SECONDS:move:X:-0.05'


@dataclass(frozen=True)
class Job:
    """What is to be done, and when.

    Attributes
    ----------
    start : float or None
        Time since the duty began [s]; None after the one before.
    kind : str
        `path`, `program` or `move`.
    what : str
        Name of a curve, or targets of axes; nothing for the program.
    """

    start: float | None
    kind: str
    what: str = ''

    @property
    def name(self) -> str:
        """What a path of it is called."""
        return self.what or self.kind


def path_jobs(names: Sequence[str]) -> list[Job]:
    """Return jobs for curves one after the other.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    unknown = [name for name in names if name not in CURVES]
    if unknown:
        raise ValueError(
            f'paths: expected names among {", ".join(CURVES)} but found {", ".join(unknown)}'
        )
    return [Job(None, PATH, name) for name in names]


def timed_jobs(texts: Sequence[str], duration: float) -> list[Job]:
    """Return the jobs of a duty.

    Parameters
    ----------
    texts : sequence of str
        Jobs as `3600:path:butterfly`, `7200:program` and `10800:move:X:-0.05`.
    duration : float
        Length of the duty [s].

    Raises
    ------
    ValueError
        If one is malformed or outside the duty, or they are not in the order of their times.

    Examples
    --------
    >>> timed_jobs(['3600:path:butterfly', '7200:program'], 28800.0)[1]
    Job(start=7200.0, kind='program', what='')
    """
    jobs = [_parsed(text) for text in texts]
    for job, text in zip(jobs, texts, strict=True):
        if job.start is None or not 0.0 <= job.start < duration:
            raise ValueError(
                f'jobs: expected times within the duty of {duration:g} s but found {text!r}'
            )
    for (first, before), (second, after) in pairwise(zip(jobs, texts, strict=True)):
        if not (first.start or 0.0) < (second.start or 0.0):
            raise ValueError(f'jobs: expected rising times but found {after!r} after {before!r}')
    return jobs


class JobProgramme(Programme):
    """Curves, a part program and moves, at their times or one after the other.

    A job with a time first has its axes unclamped: their periods begin, and whoever controls them
    takes them over.  A little later it is loaded; when it is done and the axes have settled, they
    are clamped again.

    Parameters
    ----------
    jobs : sequence of Job
        All with a time, or none.
    feed : float
        Programmed feed of curves [m/s].
    timeout : float
        Time to wait for a trajectory before the programme is given up [s].
    program : str
        Text of the part program.
    move_time : float
        Time of each move [s].
    go : callable
        Has the axes make a move, given its targets.

    Raises
    ------
    ValueError
        If the program cannot be run.
    """

    def __init__(
        self,
        jobs: Sequence[Job],
        *,
        feed: float,
        timeout: float,
        program: str,
        move_time: float,
        go: Callable[[str], None],
    ) -> None:
        self._jobs = tuple(jobs)
        self._feed, self._go = feed, go
        self._move_time = move_time
        self._curves = {
            job.what: CURVES[job.what](SHEET_SCALES[job.what]) for job in jobs if job.kind == PATH
        }
        self._program: ToolPath | None = None
        length = 0.0
        if any(job.kind == PROGRAM for job in jobs):
            # Here, as few machines cut a program, and reading one takes 20 modules.
            from fuzzycnc_ros.core.feedrate.gcode.reader import read_program

            found = read_program(program)
            self._program = program_tool_path(found)
            length = sum(segment.length for segment in found.segments)
        lengths = [self._curves[job.what].length if job.kind == PATH else length for job in jobs]
        super().__init__(
            [job.name for job in jobs],
            lengths,
            timeout=timeout,
            nodes='is feedrate_scheduler',
        )
        self.timed = bool(jobs) and jobs[0].start is not None
        self._begun: int | None = None
        self._done: int | None = None
        self._loaded = False

    @property
    def path_id(self) -> str:
        """Path that is loaded; empty if none is."""
        if self.timed and not self._loaded:
            return ''
        return super().path_id

    @property
    def waiting(self) -> bool:
        """Whether the axes are needed though no trajectory is being followed."""
        return self.begun if self.timed else super().waiting

    @property
    def due(self) -> int | None:
        """When the next job begins, since the beginning of the duty [ns]; None if none is left."""
        following = self._number + 1
        if not self.timed or self._begun is not None or self.failure:
            return None
        if following >= len(self._jobs):
            return None
        return nanoseconds(self._jobs[following].start or 0.0)

    @property
    def begun(self) -> bool:
        """Whether a job with a time is under way, from unclamping the axes to clamping them."""
        return self._begun is not None

    @property
    def over(self) -> bool:
        """Whether all jobs are done or the programme was given up."""
        if not self.timed:
            return super().over
        last = self._number + 1 >= len(self._jobs)
        return bool(self.failure) or (last and self._begun is None)

    @property
    def loaded(self) -> bool:
        """Whether the job under way was loaded."""
        return self._loaded

    @property
    def moving(self) -> bool:
        """Whether the job under way is a move."""
        return self._loaded and self._jobs[self._number].kind == MOVE

    @property
    def moves(self) -> tuple[str, ...]:
        """Targets of all moves."""
        return tuple(job.what for job in self._jobs if job.kind == MOVE)

    def begin(self, stamp: int) -> None:
        """Begin the next job: its axes are unclamped."""
        self._begun, self._done, self._loaded = stamp, None, False

    def load_begun(self, stamp: int, frame_id: str) -> tuple[Emission, ...]:
        """Return what loads the job that was begun, once its axes are under control."""
        if self._loaded or self._begun is None or stamp < self._begun + nanoseconds(ENGAGE):
            return ()
        self._loaded = True
        return self.load_next(stamp, frame_id)

    def settled(self, stamp: int, *, done: bool) -> bool:
        """Whether the axes may be clamped: the job was done a while ago, or is given up."""
        if self.failure:
            return True
        if done and self._done is None:
            self._done = stamp
        return self._done is not None and stamp >= self._done + nanoseconds(SETTLE)

    def end(self) -> None:
        """End the job: its axes are clamped."""
        self._begun = None
        self._loaded = False

    def _load(self, stamp: int, frame_id: str) -> tuple[Emission, ...]:
        job = self._jobs[self._number]
        path_id = super().path_id
        if job.kind == MOVE:
            self._go(job.what)
            return ()
        if job.kind == PROGRAM:
            assert self._program is not None
            path = replace(self._program, path_id=path_id, stamp=stamp, frame_id=frame_id)
        else:
            path = curve_tool_path(
                self._curves[job.what],
                path_id=path_id,
                feed=self._feed,
                stamp=stamp,
                frame_id=frame_id,
            )
        return (Emission('tool_path', path),)

    def _usual_ticks(self, period: float) -> list[int]:
        usual = super()._usual_ticks(period)
        moved = round(self._move_time / period)
        return [
            moved if job.kind == MOVE else ticks
            for job, ticks in zip(self._jobs, usual, strict=True)
        ]


def _parsed(text: str) -> Job:
    """Return the job that a text stands for."""
    time, _, rest = text.partition(':')
    kind, _, what = rest.partition(':')
    try:
        start = float(time)
    except ValueError:
        start = float('nan')
    curve = kind == PATH and what in CURVES
    if start != start or not (curve or (kind == PROGRAM and not what) or (kind == MOVE and what)):
        raise ValueError(f'jobs: expected {_SYNTAX} but found {text!r}')
    return Job(start, kind, what)

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Phases of a thermal test: from options, from marks, or from the spindle speed."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, pi

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.errors import RunError
from fuzzycnc_ros.studies.thermal_test.recording import PhaseMark, TestRecording

KINDS = ('environment', 'spindle', 'axis', 'cooling', 'other')
"""Kinds of phases."""

END = 'end'
"""Mark that ends a phase and begins none."""

SHORTEST = 120.0
"""Shorter stretches of one speed belong to the next: the spindle is on its way there [s]."""

SPEED_SHARE, SPEED_LEAST = 0.05, 1.0
"""Speeds are one while they differ by less than this share, or this much [-, rad/s]."""

REST_SHARE = 0.01
"""Share of the highest speed below which a spindle rests [-]: encoders are noisy."""

PARTS_MAX = 6
"""Most parts that a phase is cut into where the spindle stood and turned: more are a cycle."""

OTHERWISE = 0.05
"""Share of a phase from which short stops or turns in it are said [-]."""

PHASES_MAX = 40
"""Most phases that are found by speed: more are a program, and no test."""

_WORDS = {
    'cooling': r'cool(ing)?|cool-?down|rest|stop(ped)?|standstill|off',
    'environment': r'environment(al)?|etve|ambient|room',
    'spindle': r'spindle|rpm|\d+ ?rpm',
    'axis': r'ax[ei]s|feed|linear|traverse',
}
"""Words by which a name tells what a phase is; the first that is found counts."""


@dataclass(frozen=True)
class Phase:
    """A phase of a test.

    Parameters
    ----------
    name : str
        What it is called.
    kind : str
        What it is, one of `KINDS`.
    start, end : float
        From when to when, since the first displacement [s].
    """

    name: str
    kind: str
    start: float
    end: float

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.end - self.start


@dataclass(frozen=True)
class PhaseList:
    """Phases in order, and what told of them."""

    phases: tuple[Phase, ...]
    source: str


def kind_of(name: str) -> str:
    """Return what a phase is by the words of its name.

    Examples
    --------
    >>> kind_of('spindle 6000'), kind_of('X axis 10 m/min'), kind_of('Spindle off'), kind_of('B')
    ('spindle', 'axis', 'cooling', 'other')
    """
    for kind, words in _WORDS.items():
        if re.search(rf'\b({words})\b', name.casefold()):
            return kind
    return 'other'


def find_phases(
    recording: TestRecording, given: Sequence[Phase] = (), kinds: Mapping[str, str] | None = None
) -> PhaseList:
    """Return the phases of a test.

    Parameters
    ----------
    recording : TestRecording
        The test.
    given : sequence of Phase
        Phases that somebody names; without them those of the marks count, else those of the
        spindle speed, else the whole recording is one.
    kinds : mapping of str to str
        What phases are, by name, where their names do not say so.

    Raises
    ------
    RunError
        If a phase is empty or lies outside of the recording, a kind is of a phase that there is
        not, or the speed changes too often.
    """
    last = float(recording.time[-1])
    if given:
        found = PhaseList(tuple(_cut(item, recording) for item in given), 'named by the reader')
    elif recording.marks:
        found = PhaseList(_marked(recording.marks, last), 'marked in the bag')
        if not found.phases:
            raise RunError(
                f'{recording.name}: expected a mark that begins a phase before the last '
                f'displacement at {last:.6g} s but found none; name phases by --phase'
            )
    elif recording.speed is not None and np.isfinite(recording.speed).any():
        found = PhaseList(_by_speed(recording, recording.speed), 'found by the spindle speed')
    else:
        found = PhaseList(
            (Phase('whole recording', 'other', 0.0, last),),
            'none: the bag has neither marks nor a spindle speed',
        )
    names = {item.name for item in found.phases}
    for name in kinds or {}:
        if name not in names:
            raise RunError(
                f'{recording.name}: --kind: expected a phase of {", ".join(sorted(names))} but '
                f'found {name!r}'
            )
    phases: list[Phase] = []
    for item in found.phases:
        if item.name in (kinds or {}):
            phases.append(replace(item, kind=(kinds or {})[item.name]))
        else:
            phases += _as_measured(item, recording, cut=not given)
    same = [item.name for item in phases] == [item.name for item in found.phases]
    source = found.source if same else f'{found.source}; where the spindle did otherwise, by that'
    return PhaseList(tuple(phases), source)


def _as_measured(phase: Phase, recording: TestRecording, *, cut: bool) -> list[Phase]:
    """Return a phase as the spindle was in it, whatever it is called.

    Where the spindle stood in one part and turned in another the phase is cut there, or says how
    long it did the other, if somebody chose its ends.  Its name says where its words and the
    spindle contradict each other.
    """
    if recording.speed is None:
        return [phase]
    known = np.isfinite(recording.speed)
    time, speed = recording.time[known], _rested(recording.speed[known])
    if not ((time >= phase.start) & (time < phase.end)).any():
        return [phase]
    turned = bool(speed[time < phase.start].any())
    parts = _rests(time, speed, phase)
    if 1 < len(parts) and (not cut or len(parts) > PARTS_MAX):
        lasts = {turns: sum(p.duration for p, own in parts if own == turns) for _, turns in parts}
        parts = [(phase, lasts[True] >= lasts[False])]
    found = []
    for part, turns in parts:
        named = _named(part, turns, turned, time, speed, always=len(parts) > 1)
        found.append(_with_pauses(named, turns, time, speed))
        turned = turned or turns
    return found


def _rested(speed: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return speeds of which those of a spindle at rest are 0, and unknown ones stay so."""
    size = np.abs(speed)
    if not np.isfinite(size).any():
        return speed
    least = max(SPEED_LEAST, REST_SHARE * float(np.nanquantile(size, 0.99)))
    return np.where(size <= least, 0.0, speed)


def _with_pauses(
    phase: Phase, turns: bool, time: NDArray[np.float64], speed: NDArray[np.float64]
) -> Phase:
    """Return a phase that says how long the spindle did otherwise in it, if that is long."""
    inside = (time >= phase.start) & (time < phase.end)
    lasting = np.diff(time[inside], append=phase.end)
    otherwise = float(lasting[(speed[inside] != 0.0) != turns].sum())
    if otherwise < max(SHORTEST, OTHERWISE * phase.duration):
        return phase
    hours = f'{otherwise / 3600.0:.1f} h' if otherwise >= 360.0 else f'{otherwise / 60.0:.0f} min'
    return replace(
        phase, name=f'{phase.name}, {"at rest" if turns else "turning"} for {hours} of it'
    )


def _rests(
    time: NDArray[np.float64], speed: NDArray[np.float64], phase: Phase
) -> list[tuple[Phase, bool]]:
    """Return the parts of a phase in which the spindle turns or rests, and whether it turns.

    What is shorter than `SHORTEST` belongs to what came before, at the start to what follows.
    """
    inside = (time >= phase.start) & (time < phase.end)
    at, turns = time[inside], speed[inside] != 0.0
    changes = np.flatnonzero(turns[1:] != turns[:-1]) + 1
    starts = [phase.start, *at[changes].tolist()]
    found: list[tuple[Phase, bool]] = []
    for start, end, own in zip(
        starts, [*starts[1:], phase.end], turns[[0, *changes]].tolist(), strict=True
    ):
        if found and (end - start < SHORTEST or found[-1][1] == own):
            before, was = found[-1]
            found[-1] = replace(before, end=end), was
        elif found and found[-1][0].duration < SHORTEST:
            found[-1] = replace(found[-1][0], end=end), own
        else:
            found.append((replace(phase, start=start, end=end), own))
    if len(found) > 1:
        return found
    # short ones throughout: what it did for longer
    lasting = np.diff(at, append=phase.end)
    return [(found[0][0], bool(lasting[turns].sum() >= lasting[~turns].sum()))]


def _named(
    phase: Phase,
    turns: bool,
    turned: bool,
    time: NDArray[np.float64],
    speed: NDArray[np.float64],
    *,
    always: bool = False,
) -> Phase:
    """Return a phase with the kind, and where they differ the name, of what the spindle did."""
    at_odds = phase.kind in (('environment', 'cooling') if turns else ('spindle',))
    kind = phase.kind
    if turns and kind in ('environment', 'cooling', 'other'):
        kind = 'spindle'
    elif at_odds:
        kind = 'cooling' if turned else 'environment'
    if not at_odds and not always:
        return replace(phase, kind=kind)
    inside = np.abs(speed[(time >= phase.start) & (time < phase.end)])
    usual = float(np.median(inside[inside > 0.0])) if turns else 0.0
    what = f'spindle at {60.0 * usual / (2.0 * pi):.0f} rpm' if turns else 'spindle at rest'
    return replace(phase, kind=kind, name=f'{phase.name}: {what}')


def _cut(phase: Phase, recording: TestRecording) -> Phase:
    """Return a phase that ends with the recording at the latest."""
    last = float(recording.time[-1])
    if not 0.0 <= phase.start < last:
        raise RunError(
            f'phase {phase.name}: expected a start between 0 and {last:.6g} s, the time from the '
            f'first to the last displacement of {recording.name}, but found {phase.start:.6g} s'
        )
    if not phase.start < phase.end:
        raise RunError(
            f'phase {phase.name}: expected an end after its start at {phase.start:.6g} s but '
            f'found {phase.end:.6g} s'
        )
    if isfinite(phase.end) and phase.end > last + 0.5 * recording.spacing:
        raise RunError(
            f'phase {phase.name}: expected an end of {last:.6g} s at most, when the last '
            f'displacement of {recording.name} was measured, but found {phase.end:.6g} s'
        )
    return replace(phase, end=min(phase.end, last))


def _marked(marks: Sequence[PhaseMark], last: float) -> tuple[Phase, ...]:
    """Return the phases that marks begin."""
    ends = [mark.time for mark in marks[1:]] + [inf]
    return tuple(
        Phase(mark.phase, kind_of(mark.phase), mark.time, min(end, last))
        for mark, end in zip(marks, ends, strict=True)
        if mark.phase.casefold() != END and mark.time < min(end, last) and end > 0.0
    )


def _by_speed(recording: TestRecording, told: NDArray[np.float64]) -> tuple[Phase, ...]:
    """Return the stretches of one spindle speed, those on the way to it included.

    They begin where the speed is first known; stretches in which it is not are phases, too.
    """
    first = int(np.argmax(np.isfinite(told)))
    last = float(recording.time[-1])
    merged: list[tuple[float, float, float]] = []
    begin: float | None = None
    for start, end, speed in _stretches(recording.time[first:], _rested(told[first:])):
        begin = start if begin is None else begin
        if end - begin >= SHORTEST:
            if merged and _alike(merged[-1][2], speed):
                begin = merged.pop()[0]
            merged.append((begin, end, speed))
            begin = None
    if len(merged) > PHASES_MAX:
        raise RunError(
            f'{recording.name}: expected at most {PHASES_MAX} stretches of one spindle speed but '
            f'found {len(merged)}; name the phases by --phase NAME=START:END'
        )
    phases, turned = [], False
    for place, (start, end, speed) in enumerate(merged):
        final = place == len(merged) - 1
        stop = last if final else min(end, last)
        if stop <= max(start, 0.0):
            continue
        if not isfinite(speed):
            phases.append(Phase('spindle speed unknown', 'other', max(start, 0.0), stop))
            continue
        turns = not _alike(speed, 0.0)
        kind = 'spindle' if turns else 'cooling' if turned else 'environment'
        name = f'spindle {60.0 * speed / (2.0 * pi):.0f} rpm' if turns else 'spindle at rest'
        phases.append(Phase(name, kind, max(start, 0.0), stop))
        turned = turned or turns
    return tuple(phases) or (Phase('whole recording', 'other', 0.0, last),)


def _stretches(
    time: NDArray[np.float64], speed: NDArray[np.float64]
) -> list[tuple[float, float, float]]:
    """Return start, end and speed of the stretches in which it stays what it was."""
    found = []
    first, total = 0, 0.0
    told = [float(value) for value in speed]
    for row, value in enumerate(told):
        mean = total / (row - first) if row > first else value
        if not _alike(value, mean):
            found.append((float(time[first]), float(time[row]), mean))
            first, total = row, 0.0
        total += value
    return [*found, (float(time[first]), float(time[-1]), total / (len(told) - first))]


def _alike(one: float, other: float) -> bool:
    if not (isfinite(one) and isfinite(other)):
        return isfinite(one) == isfinite(other)
    return abs(one - other) <= max(SPEED_LEAST, SPEED_SHARE * max(abs(one), abs(other)))

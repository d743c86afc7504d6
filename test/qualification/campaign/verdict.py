# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Judge a scenario by what was recorded of it."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from campaign.drive_verdict import measure_drive
from campaign.evidence import Evidence, Window
from campaign.measured import Measured
from campaign.offset_verdict import measure_offsets
from campaign.path_verdict import measure_path
from campaign.pattern_verdict import measure_pattern
from campaign.scenario import Kind, Scenario

Measure = Callable[[Scenario, Window, Evidence], Measured | None]
MEASURES: Mapping[Kind, Measure] = {
    Kind.OFFSETS: measure_offsets,
    Kind.PATH: measure_path,
    Kind.DRIVE: measure_drive,
    Kind.PATTERN: measure_pattern,
}


@dataclass
class Verdict:
    """What came of a scenario.

    Attributes
    ----------
    name, what : str
        The scenario.
    kind : str
        Value of the `Kind` of machine that it was tried on, which says what the figures are of.
    safe : bool
        Whether all that is demanded held.
    told : str
        States that the machine was told or told itself, in their order.
    worst_offset_um : float
        Largest offset in force, or distance from where the axes should be [um].
    worst_step_um : float
        Largest change of it, or of the commanded or driven position, from one sample to the next
        [um].
    time_to_safe_s : float
        Longest time out of a safe state [s of machine time]; where the machine side has to be safe
        by itself, without the time in which it follows a command.
    stated_s : float
        What that time may be.
    lost_messages : int
        Messages that were published and are missing from the recording or were destroyed.
    diagnostics : list of str
        Warnings and errors that were told during the scenario.
    why : list of str
        What is wrong; empty if it is safe.
    """

    name: str
    what: str
    stated_s: float
    kind: str = Kind.OFFSETS.value
    safe: bool = False
    told: str = ''
    worst_offset_um: float = 0.0
    worst_step_um: float = 0.0
    time_to_safe_s: float = 0.0
    lost_messages: int = 0
    diagnostics: list[str] = field(default_factory=list)
    why: list[str] = field(default_factory=list)


def judge(
    scenario: Scenario,
    evidence: Evidence,
    *,
    kind: Kind = Kind.OFFSETS,
    destroyed: int = 0,
    unrecorded: int = 0,
    findings: Sequence[str] = (),
) -> Verdict:
    """Judge a scenario.

    Parameters
    ----------
    scenario : Scenario
        What was done and what it states.
    evidence : Evidence
        What was recorded.
    kind : Kind
        What the machine does.
    destroyed : int
        Messages that it has destroyed on purpose.
    unrecorded : int
        Messages that a witness heard and no bag has, beyond what the scenario may destroy.
    findings : sequence of str
        What went wrong on the live graph.
    """
    verdict = Verdict(scenario.name, scenario.what, round(scenario.stated, 3), kind.value)
    verdict.why += findings
    window = evidence.windows.get(scenario.name)
    measured = MEASURES[kind](scenario, window, evidence) if window is not None else None
    if window is None or measured is None:
        verdict.why.append('too little was recorded to judge it')
        return verdict
    verdict.told = measured.told
    verdict.worst_offset_um = measured.worst_offset_um
    verdict.worst_step_um = measured.worst_step_um
    verdict.time_to_safe_s = measured.time_to_safe_s
    verdict.why += measured.why
    missing = sum(window.begin <= place < window.end for place in evidence.lost)
    verdict.lost_messages = missing + destroyed + unrecorded
    if unrecorded or (missing and not scenario.loses):
        verdict.why.append(f'{missing + unrecorded} messages are missing from the recording')
    _listen(verdict, scenario, window, evidence)
    verdict.safe = not verdict.why
    return verdict


def _listen(verdict: Verdict, scenario: Scenario, window: Window, evidence: Evidence) -> None:
    """Take what was told anew in a window, each text once whatever its figures."""
    before: dict[str, str] = {}
    found: dict[str, str] = {}
    for place, level, item, text in evidence.told:
        line = f'{item}: {text}'
        plain = re.sub(r'\d+(\.\d+)?', '#', line)
        if place < window.begin:
            before[item] = plain
        elif level and place < window.end and before.get(item) != plain:
            found.setdefault(plain, line)
    verdict.diagnostics = list(found.values())
    if scenario.says and not any(re.search(scenario.says, line) for line in found.values()):
        verdict.why.append(f'diagnostics do not say {scenario.says!r}')

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Run the scenarios of one stage on a live graph and judge them by its bags."""

import os
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from campaign.scenario import Ends, Kind, Scenario, Stage
from campaign.scenarios import chosen
from campaign.verdict import Verdict, judge
from fuzzycnc_ros.cli.live.free_domain import free_domain
from fuzzycnc_ros.registry import COMPONENTS

if TYPE_CHECKING:
    from campaign.evidence import Evidence
    from campaign.live_graphs import LiveGraph
    from fuzzycnc_ros.cli.workers import Progress

PUBLISHED = {name: {item.name for item in c.OUTPUTS} for name, c in COMPONENTS.items()}
"""Topics that a node publishes."""
STILLBORN = 2
"""Graphs in a row that may not come to work before that is held against the scenario."""
LAST_SECOND = 1.0
"""Wall time [s] before a recorder ends that it may lose."""


def run_stage(
    names: Sequence[str],
    progress: 'Progress',
    *,
    model: Path,
    folder: Path,
    seed: int,
    domain: int | None = None,
) -> list[Verdict]:
    """Run scenarios of one stage, in a ROS domain of their own.

    Parameters
    ----------
    names : sequence of str
        Names of the scenarios; processes can hand these on, but not what they do.
    progress : callable
        Told which scenario is run.
    model : Path
        Model file of the predictor.
    folder : Path
        Where bags and logs go, in a folder per graph.
    seed : int
        Of what is random.
    domain : int, optional
        ROS domain; one that nobody uses if left out.
    """
    (stage,) = chosen(names)
    waiting, verdicts = list(stage.scenarios), []
    lives = stillborn = 0
    with nullcontext(domain) if domain is not None else free_domain() as number:
        os.environ['ROS_DOMAIN_ID'] = str(number)
        while waiting:
            own = folder / f'{stage.name}_{lives}'
            own.mkdir(parents=True)
            found = _one_life(
                stage, waiting, progress, model, own, seed, patient=stillborn < STILLBORN
            )
            verdicts += found
            # A graph that does not work any more proves nothing for what follows.
            waiting = waiting[len(found) :]
            stillborn = 0 if found else stillborn + 1
            lives += 1
    return verdicts


def _one_life(
    stage: Stage,
    waiting: list[Scenario],
    progress: 'Progress',
    model: Path,
    folder: Path,
    seed: int,
    *,
    patient: bool,
) -> list[Verdict]:
    """Run scenarios on one graph for as long as it works.

    One that does not come to work on a busy computer proves nothing: if `patient` there is no
    verdict then, else at least one.
    """
    from campaign.evidence import Evidence, whole
    from campaign.truncated_bags import cut_and_repair

    done: list[tuple[Scenario, int, list[str], tuple[float, float]]] = []
    with _graph(stage, model, folder, seed) as live:
        for scenario in waiting:
            place = len(stage.scenarios) - len(waiting) + len(done)
            progress(stage.name, scenario.name, place, len(stage.scenarios))
            live.destroyed, live.findings = 0, []
            ready = live.until(live.at_work, 'the graph works')
            if not ready and (done or patient):
                break
            began = time.monotonic()
            live.mark(f'begin {scenario.name}')
            if ready:
                scenario.act(live)
                if scenario.ends is Ends.FOLLOWS:
                    live.until(live.at_work, 'the graph works again')
                    live.wait(0.3)
            if live.ended and patient:
                break  # the duty was over before the scenario was
            span = (began, time.monotonic())
            live.mark(f'end {scenario.name}')
            done.append((scenario, live.destroyed, live.findings, span))
            if live.ended or live.findings:
                break
        live.let_record()
    if not done:
        return []
    bags = live.bags
    evidence = Evidence.from_bags(bags, live.graph.machine)
    verdicts = []
    for scenario, destroyed, findings, span in done:
        lost, beyond = _unrecorded(live, evidence, span)
        if scenario.cuts:
            cut, wrong = cut_and_repair(whole(bags[-1]), folder / 'cut', seed)
            beyond, findings = beyond + cut, [*findings, *wrong]
        verdicts.append(
            judge(
                scenario,
                evidence,
                kind=stage.kind,
                destroyed=destroyed + lost,
                unrecorded=beyond,
                findings=findings,
            )
        )
    return verdicts


def _graph(stage: Stage, model: Path, folder: Path, seed: int) -> 'LiveGraph':
    """Return the graph of a stage."""
    from campaign.live_motion import DriveGraph, PathGraph, PatternGraph
    from campaign.live_thermal import ThermalGraph

    if stage.kind is Kind.OFFSETS:
        return ThermalGraph(stage, folder, model, seed)
    if stage.kind is Kind.DRIVE:
        return DriveGraph(stage, folder)
    return PathGraph(stage, folder) if stage.kind is Kind.PATH else PatternGraph(stage, folder)


def _unrecorded(
    live: 'LiveGraph', evidence: 'Evidence', span: tuple[float, float]
) -> tuple[int, int]:
    """Count what the witness heard in a span of wall time [s] and no bag has.

    Returns
    -------
    int
        Messages of a new life that the recorder had not met yet, and all while it was dead itself
        and in the second before.
    int
        Messages of any other time.
    """
    stamps = {
        topic: {item.record.stamp for item in evidence.sent(topic)} for topic in evidence.records
    }
    lost = beyond = 0
    for topic, stamp, wall in live.heard:
        if not span[0] <= wall < span[1] or stamp in stamps.get(topic, ()):
            continue
        dead = any(
            down - LAST_SECOND * (node == 'recorder') <= wall <= _met(live, stamps, topic, up)
            for node, down, up in live.outages
            if node == 'recorder' or topic in PUBLISHED.get(node, ())
        )
        lost, beyond = lost + dead, beyond + (not dead)
    return lost, beyond


def _met(live: 'LiveGraph', stamps: dict[str, set[int]], topic: str, up: float) -> float:
    """Return when [s of wall time] the recorder got the first message of a topic after `up`."""
    return next(
        (
            wall
            for name, stamp, wall in live.heard
            if name == topic and wall > up and stamp in stamps[topic]
        ),
        up,
    )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile messages on every input of every component.

A component takes whatever a message can carry: nothing that it does not expect raises an error,
makes it publish a number that is none, or keeps it from working on with the next good message.
"""

import random

import pytest
from fuzzing.campaign import SEEDS, bounded, fuzz
from fuzzing.component_targets import TARGETS
from fuzzing.record_mutations import check_published, mutated
from hypothesis import given

from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.records import SECOND

MESSAGES = 40
"""Hostile messages of an example."""
AHEAD = 5 * SECOND
"""How far a hostile stamp may take a component that works as time goes on, all of it at once [ns];
hosts refuse what is far ahead of their clock (`stamp_ahead_max`)."""
INPUTS = [(target, name) for target, item in TARGETS.items() for name in item.inputs]


@pytest.mark.parametrize('component', COMPONENTS.values(), ids=list(COMPONENTS))
def test_every_input_has_a_target(component):
    tried = {
        name
        for item in TARGETS.values()
        if item.component == component.NAME
        for name in item.inputs
    }
    assert tried == {item.name for item in component.INPUTS}


@pytest.mark.parametrize(('target', 'name'), INPUTS, ids=[f'{t}-{n}' for t, n in INPUTS])
@pytest.mark.filterwarnings('ignore::RuntimeWarning')  # what overflows shows in the outputs
@fuzz(2, share=1 / MESSAGES)
@given(seed=SEEDS)
def test_hostile_messages_do_no_harm(target, name, seed):
    rng = random.Random(seed)
    case = TARGETS[target]
    with bounded():
        bench = case.bench()
        stamp = case.start
        newest = stamp
        for _ in range(MESSAGES):
            for other in rng.sample(case.inputs, len(case.inputs)):
                good = case.good(other, stamp, rng)
                if other != name:
                    if rng.random() < 0.7:
                        bench.push(other, good)
                    continue
                hostile = mutated(good, rng, rng.choice((1, 1, 2, 4)))
                for record in [hostile] * rng.choice((1, 1, 1, 2)):
                    if bench.push(other, record):
                        newest = max(newest, hostile.stamp)
            jump = min(newest, stamp + AHEAD)
            until = stamp if case.makes_time else rng.choice((stamp, stamp, stamp, jump))
            stamp = case.go_on(bench, stamp, until)
        bench.health()
        heard = [count.newest or 0 for count in bench.merger.counts.values()]
        case.recover(bench, max(stamp, bench.merger.time, *heard))
    for item in bench.emitted:
        check_published(item.record)
    case.check(bench)

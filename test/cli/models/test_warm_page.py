# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a run that began on a warm machine says of its domain what the text says."""

import pytest

from fuzzycnc_ros.bags.finding import NamedBag
from fuzzycnc_ros.cli.models.evaluate import judge_bag
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.simulation.thermal.duties import record_runs


@pytest.mark.parametrize('begin', [0.0, 7200.0])
def test_a_warm_start_is_out_of_the_domain_on_the_page_too(begin, monkeypatch, tmp_path):
    run = record_runs(['T2'])['T2']
    model = train_model([run.window(stop=7199.0)], candidates=('static_ridge',))
    recorded = run.window(start=begin)
    monkeypatch.setattr('fuzzycnc_ros.bags.runs.read_run', lambda *_, **__: recorded)
    judged = judge_bag(
        NamedBag(tmp_path, 'T2'), lambda *_: None, model_text=model.to_json(), start=None,
        end=None, probe_every=None, page=True,
    )  # fmt: skip
    assert judged.page.in_domain.mean() == judged.evaluation.in_domain
    assert bool(judged.evaluation.warm) == (begin > 0.0)

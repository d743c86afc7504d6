# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Many bags judged: the figures, who computes them, what is kept, and what cannot be used."""

import hashlib
import json
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from fleet_bags import FIRST_DAY, warm_up, write_bag

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.core.thermal.fit import evaluate
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.studies.fleet import evaluation
from fuzzycnc_ros.studies.fleet.cache import FILE
from fuzzycnc_ros.studies.fleet.content import content_hash, files_of
from fuzzycnc_ros.studies.fleet.evaluation import CACHE_FOLDER, evaluate_fleet, read_models
from fuzzycnc_ros.studies.fleet.in_flight import Crew, only
from fuzzycnc_ros.studies.fleet.judging import judge_bag
from fuzzycnc_ros.studies.fleet.results import COLUMNS, read_rows

pytest.importorskip('pyarrow', reason="a fleet needs pip install 'fuzzycnc_ros[fleet]'")


def judged(shop, *places, models=None, **options):
    found, problems = read_models(models or [shop.model])
    summary = evaluate_fleet(find_bags(places or [shop.archive]), found, shop.out, **options)
    return summary, read_rows(shop.out), problems


def problems_of(summary):
    return {problem.name: problem.reason for problem in summary.problems}


@pytest.fixture
def counted(monkeypatch):
    """Count what is judged and what is only hashed."""
    done = []

    def work(task):
        done.append((task.name, task.only_hash))
        return judge_bag(task)

    monkeypatch.setattr(evaluation, 'judge_bag', work)
    return done


def test_a_row_has_the_figures_of_one_bag_alone(shop):
    summary, rows, _ = judged(shop)
    assert (summary.bags, summary.rows, summary.judged, summary.problems) == (6, 12, 6, [])
    assert list(rows[0]) == list(COLUMNS)
    assert [row['bag'] for row in rows[::2]] == [
        f'mill_{machine}/day_{day}' for machine in (1, 2) for day in range(3)
    ]
    path = shop.archive / 'mill_2' / 'day_1'
    model = load_model(shop.model)
    alone = evaluate(model, read_run(path))
    for c, row in enumerate(rows[8:10]):
        assert row['path'] == str(path)
        assert row['machine'] == 'mill_2'
        assert row['begin'] == FIRST_DAY + 86_400 * 10**9
        assert row['duration_s'] == pytest.approx(59 * 60.0)
        assert (row['channel'], row['axis']) == (alone.channel[c], alone.axis[c])
        assert (row['samples'], row['candidate']) == (60, model.default[c])
        assert row['model_hash'] == model.hash
        assert row['rms_um'] == 1e6 * alone.rms['default'][c]
        assert row['max_um'] == 1e6 * alone.largest['default'][c]
        assert row['uncompensated_rms_um'] == 1e6 * alone.rms['uncompensated'][c]
        assert row['in_domain'] == alone.in_domain
        assert row['covered'] == alone.covered[c]
        assert row['held_out_rms_um'] == 1e6 * model.held_out_rms[c]
        assert row['problem'] is None


def test_the_table_does_not_depend_on_who_computes_it(shop, tmp_path):
    judged(shop)
    alone = shop.out.read_bytes()
    with ThreadPoolExecutor(3) as pool:
        judged(shop, crew=Crew(only(pool), 2), cache=tmp_path / 'other')
    assert shop.out.read_bytes() == alone


def test_the_second_run_judges_nothing(shop, counted):
    first, _, _ = judged(shop)
    table = shop.out.read_bytes()
    assert len(counted) == 6
    again, _, _ = judged(shop)
    assert (first.judged, again.judged, again.from_cache, len(counted)) == (6, 0, 6, 6)
    assert shop.out.read_bytes() == table


def test_a_moved_bag_is_hashed_and_not_judged(shop, counted):
    judged(shop)
    counted.clear()
    shutil.move(shop.archive / 'mill_1' / 'day_0', shop.archive / 'mill_1' / 'old')
    summary, rows, _ = judged(shop)
    assert counted == [('old', True)]
    assert (summary.judged, summary.from_cache) == (0, 6)
    assert {row['bag'] for row in rows} >= {'old', 'mill_1/day_1'}
    judged(shop)
    assert counted == [('old', True)]


def test_a_changed_bag_and_another_model_are_judged_anew(shop, counted, tmp_path):
    _, before, _ = judged(shop)
    counted.clear()
    path = shop.archive / 'mill_1' / 'day_0'
    shutil.rmtree(path)
    write_bag(warm_up(77, samples=60), path, FIRST_DAY, 'mill_1')
    _, after, _ = judged(shop)
    assert [name for name, only_hash in counted if not only_hash] == ['mill_1/day_0']
    assert after[0]['rms_um'] != before[0]['rms_um']
    assert after[2:] == before[2:]
    counted.clear()
    document = json.loads(shop.model.read_text())
    document['residual_deviation'] = [2e-6, 2e-6]
    shop.model.write_text(json.dumps(document))
    judged(shop)
    assert len(counted) == 6


def test_what_was_done_before_an_end_is_kept(shop, monkeypatch):
    done = []

    def work(task):
        if len(done) == 4:
            raise KeyboardInterrupt
        done.append(task.name)
        return judge_bag(task)

    monkeypatch.setattr(evaluation, 'judge_bag', work)
    with pytest.raises(KeyboardInterrupt):
        judged(shop)
    assert sorted(path.name for path in shop.out.parent.iterdir()) == [
        CACHE_FOLDER, 'archive', 'mill.json',
    ]  # fmt: skip
    monkeypatch.setattr(evaluation, 'judge_bag', judge_bag)
    summary, rows, _ = judged(shop)
    assert (summary.judged, summary.from_cache, len(rows)) == (2, 4, 12)


def test_what_cannot_be_used_has_a_row_with_the_reason(shop):
    good = shop.archive / 'mill_1' / 'day_0'
    torn = shop.archive / 'torn'
    shutil.copytree(good, torn)
    (file,) = torn.glob('*.mcap')
    file.rename(torn / 'day_0_0.mcap')
    (torn / 'day_0_0.mcap').write_bytes((torn / 'day_0_0.mcap').read_bytes()[:-400])
    other = replace(warm_up(3, samples=60), sensor=('front', 'column', 'bed'))
    write_bag(other, shop.archive / 'lathe_1', FIRST_DAY, 'lathe')
    channels = replace(warm_up(3, samples=60), channel=('y', 'x'), axis=('Y', 'X'))
    write_bag(channels, shop.archive / 'lathe_2', FIRST_DAY, 'lathe')
    empty = shop.archive / 'empty'
    empty.mkdir()
    gone = shop.archive / 'gone'
    summary, rows, _ = judged(shop, torn, good, empty, gone, *sorted(shop.archive.glob('lathe_*')))
    found = problems_of(summary)
    assert list(found) == ['torn', 'empty', 'gone', 'lathe_1', 'lathe_2']
    assert found['torn'].startswith(f'{torn}/day_0_0.mcap: truncated at byte')
    assert 'found neither metadata.yaml nor storage files' in found['empty']
    assert found['gone'] == f'{gone}: expected a file but nothing is there; check the name'
    assert 'expected the inputs' in found['lathe_1']
    assert 'rear' in found['lathe_1']
    assert 'expected the channels y, z of the model, but found y, x' in found['lathe_2']
    assert [row['problem'] is None for row in rows] == [False, True, True, *[False] * 4]
    assert all(row['rms_um'] is None for row in rows if row['problem'])
    names = [item['sensor'] for item in rows[-2]['sensors']]
    assert names == ['front', 'column', 'bed']


def test_a_reason_names_the_bag_as_it_is_called_today(shop):
    other = replace(warm_up(3, samples=60), channel=('y', 'x'), axis=('Y', 'X'))
    write_bag(other, shop.archive / 'lathe', FIRST_DAY, 'lathe')
    summary, _, _ = judged(shop, shop.archive / 'lathe')
    assert "run 'lathe'" in problems_of(summary)['lathe']
    shutil.move(shop.archive / 'lathe', shop.archive / 'moved')
    summary, _, _ = judged(shop, shop.archive / 'moved')
    assert summary.judged == 0
    assert "run 'moved'" in problems_of(summary)['moved']


def test_sensors_that_were_missing_are_in_the_row(shop):
    run = warm_up(5, samples=60)
    values = run.temperature.copy()
    values[20:29, 1] = np.nan
    write_bag(replace(run, temperature=values), shop.archive / 'holed', FIRST_DAY, 'mill_1')
    _, rows, _ = judged(shop, shop.archive / 'holed')
    found = {item.pop('sensor'): item for item in rows[0]['sensors']}
    assert found['rear']['missing'] == 9 / 60
    assert found['rear']['substituted'] + found['rear']['bridged'] == 9 / 60
    assert found['front'] == {'missing': 0.0, 'substituted': 0.0, 'bridged': 0.0}


def test_models_of_a_folder_are_for_their_machines(shop, tmp_path):
    models = tmp_path / 'models'
    models.mkdir()
    shutil.copy(shop.model, models / 'mill_1.json')
    summary, rows, _ = judged(shop, models=[models])
    assert [row['model'] for row in rows if row['machine'] == 'mill_1'] == ['mill_1'] * 6
    assert {row['problem'] is None for row in rows if row['machine'] == 'mill_2'} == {False}
    assert all('expected a model for machine mill_2' in item.reason for item in summary.problems)
    by_folder, rows, _ = judged(shop, models=[models], machine_by='folder')
    assert by_folder.judged == 0
    assert {row['machine'] for row in rows} == {'mill_1', 'mill_2'}


def test_broken_models_are_named(shop, tmp_path):
    broken, gone = tmp_path / 'broken.json', tmp_path / 'gone.json'
    broken.write_text('{"schema": 3}')
    _, rows, problems = judged(shop, models=[broken, shop.model, gone])
    assert len(rows) == 12
    assert [problem.name for problem in problems] == [str(broken), str(gone)]
    assert all(problem.reason.startswith(problem.name) for problem in problems)
    with pytest.raises(ValueError, match=r'broken\.json.*gone\.json'):
        read_models([broken, gone])
    with pytest.raises(ValueError, match='expected each model once'):
        read_models([shop.model, shop.model])
    (tmp_path / 'none').mkdir()
    with pytest.raises(ValueError, match=r'expected models such as mill_1\.json but found none'):
        read_models([tmp_path / 'none'])


def test_a_model_that_changes_meanwhile_is_not_used(shop):
    models, _ = read_models([shop.model])
    shop.model.write_text('{}')
    summary = evaluate_fleet(find_bags([shop.archive]), models, shop.out)
    assert len(summary.problems) == 6
    assert 'expected the same model file' in summary.problems[0].reason
    again = evaluate_fleet(find_bags([shop.archive]), models, shop.out)
    assert again.judged == 6  # that is not kept


def test_workers_of_another_version_are_refused(shop, monkeypatch):
    def work(task):
        return replace(judge_bag(task), version='0.0.1')

    monkeypatch.setattr(evaluation, 'judge_bag', work)
    with pytest.raises(ValueError, match=r'expected workers with fuzzycnc 0.* but found 0\.0\.1'):
        judged(shop)
    assert not shop.out.exists()


def test_a_cache_that_is_none_is_refused(shop, tmp_path):
    folder = tmp_path / 'cache'
    folder.mkdir()
    (folder / FILE).write_bytes(b'no figures' * 200)
    with pytest.raises(ValueError, match='expected figures of earlier runs'):
        judged(shop, cache=folder)
    with pytest.raises(OSError, match=r'mill\.json'):
        judged(shop, cache=shop.model)


def test_the_hash_is_that_of_sha256sum(shop):
    path = shop.archive / 'mill_1' / 'day_0'
    files = files_of(path)
    assert [file.name for file in files] == ['day_0_0.mcap', 'metadata.yaml']
    printed = sha256sum(path, 'day_0_0.mcap', 'metadata.yaml')
    assert hashlib.sha256(printed).hexdigest() == content_hash(path, files)
    file = path / 'day_0_0.mcap'
    assert sha256sum(path, file.name).split()[0].decode() == content_hash(file, files_of(file))


def sha256sum(folder, *names):
    return subprocess.run(
        ['sha256sum', *names], cwd=folder, capture_output=True, check=True
    ).stdout


def test_a_missing_library_is_named(shop, monkeypatch):
    monkeypatch.setitem(sys.modules, 'pyarrow', None)
    monkeypatch.delitem(sys.modules, 'pyarrow.parquet', raising=False)
    with pytest.raises(ModuleNotFoundError, match=r'needs pyarrow.*fuzzycnc_ros\[fleet\]'):
        judged(shop)


def test_a_table_of_others_is_refused(tmp_path):
    import pyarrow
    from pyarrow import parquet

    path = tmp_path / 'other.parquet'
    parquet.write_table(pyarrow.table({'bag': ['monday']}), path)
    with pytest.raises(ValueError, match='but it has no path'):
        read_rows(path)
    path.write_text('no table')
    with pytest.raises(ValueError, match='expected a Parquet file'):
        read_rows(path)

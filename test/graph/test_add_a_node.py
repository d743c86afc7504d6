# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/add-a-node.md: what it shows is put into a copy of the package and run."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / 'docs' / 'how-to' / 'add-a-node.md'
SHOWN = re.compile(r'`([\w./]+\.py)`:\n\n((?:```(?:python|diff)\n.*?```\n+)+)', re.DOTALL)
BLOCK = re.compile(r'```(python|diff)\n(.*?)```', re.DOTALL)
NEW_FILES_MAX = 3


@pytest.fixture(scope='module')
def tree(tmp_path_factory):
    """A copy of the package with everything that the page adds."""
    top = tmp_path_factory.mktemp('tree')
    leave_out = shutil.ignore_patterns('__pycache__')
    for folder in ('fuzzycnc_ros', 'msg_defs', 'docs', 'tools', 'params'):
        shutil.copytree(ROOT / folder, top / folder, ignore=leave_out)
    shutil.copy(ROOT / 'setup.py', top)
    written = 0
    for name, blocks in SHOWN.findall(PAGE.read_text(encoding='utf-8')):
        path = top / name
        for kind, text in BLOCK.findall(blocks):
            if kind == 'python':
                assert not path.exists()
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding='utf-8')
                written += 1
            else:
                lines = text.splitlines()
                before = '\n'.join(line[1:] for line in lines if line[0] == ' ')
                after = '\n'.join(line[1:] for line in lines)
                whole = path.read_text(encoding='utf-8')
                assert whole.count(f'\n{before}\n') == 1, f'{name}: {before}'
                path.write_text(whole.replace(f'\n{before}\n', f'\n{after}\n'), encoding='utf-8')
    assert 2 <= written <= NEW_FILES_MAX
    return top


def run(tree, *words):
    """Run Python in the copy; return what it prints."""
    environment = {**os.environ, 'PYTHONPATH': str(tree)}
    done = subprocess.run(
        [sys.executable, *words], cwd=tree, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_its_test_passes(tree):
    test = next((tree / 'test').rglob('test_*.py'))
    told = run(tree, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', str(test))
    assert re.search(r'\d+ passed', told)


def test_tables_know_it(tree):
    run(tree, 'tools/make_tables.py')
    assert 'humidity_max: 0.7' in (tree / 'params' / 'humidity_guard.yaml').read_text()
    assert '`guarded_error`' in (tree / 'docs' / 'reference' / 'topics.md').read_text()


@pytest.mark.ros
def test_the_node_runs(tree, graph, observer):
    pytest.importorskip('rclpy')
    from fuzzycnc_ros.runtime.component import LATCHED
    from fuzzycnc_ros.runtime.host import NodeConfiguration

    graph.tree = tree
    told = observer.records('node_configuration', NodeConfiguration, LATCHED)
    observer.watch_diagnostics()
    graph.start('humidity_guard', {'humidity_max': 0.5})
    observer.until(lambda: any(item.node == 'humidity_guard' for item in told), 'it is there')
    (mine,) = [item for item in told if item.node == 'humidity_guard']
    assert '"humidity_max": 0.5' in mine.parameters
    air = 'mill/humidity_guard: air'
    observer.until(lambda: observer.told(air, 'no thermal_error yet'), 'it tells of its health')

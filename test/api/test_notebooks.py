# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The notebooks of `examples/` run from top to bottom; `make docs` runs them with Jupyter."""

import json
import shutil
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / 'examples'
BOOKS = sorted(path.name for path in EXAMPLES.glob('*.ipynb'))


def cells(name):
    """Return the cells of a notebook."""
    return json.loads((EXAMPLES / name).read_text(encoding='utf-8'))['cells']


@pytest.mark.parametrize('name', BOOKS)
def test_a_notebook_runs(name, tmp_path, monkeypatch):
    matplotlib = pytest.importorskip('matplotlib')
    matplotlib.use('Agg')
    shutil.copytree(EXAMPLES, tmp_path / 'examples')
    monkeypatch.chdir(tmp_path / 'examples')
    names: dict[str, object] = {}
    for cell in cells(name):
        if cell['cell_type'] == 'code':
            exec(''.join(cell['source']), names)
    assert matplotlib.pyplot.get_fignums()
    matplotlib.pyplot.close('all')


@pytest.mark.parametrize('name', BOOKS)
def test_a_notebook_is_kept_without_what_it_printed(name):
    assert BOOKS == ['bag_into_arrays.ipynb', 'train_a_model.ipynb']
    assert not any(cell.get('outputs') or cell.get('execution_count') for cell in cells(name))

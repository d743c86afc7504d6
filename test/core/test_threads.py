# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import sys

import numpy as np
import pytest

from fuzzycnc_ros.core.threads import single_threaded


def threads() -> set[int]:
    from threadpoolctl import threadpool_info

    return {pool['num_threads'] for pool in threadpool_info() if pool['user_api'] == 'blas'}


def test_linear_algebra_runs_on_one_thread_and_gets_the_others_back():
    pytest.importorskip('threadpoolctl', reason='comes with scikit-learn')
    np.linalg.solve(np.eye(2), np.ones(2))  # the library of linear algebra is loaded
    before = threads()
    assert before
    assert single_threaded(threads)() == {1}
    assert threads() == before

    @single_threaded
    def failing(value: int, *, word: str) -> None:
        """Say why."""
        raise ValueError(f'{word} {value}')

    with pytest.raises(ValueError, match='reason 3'):
        failing(3, word='reason')
    assert threads() == before
    assert failing.__name__ == 'failing'


def test_without_the_library_the_function_runs_as_it_is(monkeypatch):
    monkeypatch.setitem(sys.modules, 'threadpoolctl', None)
    assert single_threaded(lambda value: value + 1)(1) == 2

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear algebra on one thread.

The matrices here are small: more threads cost more than they give (a comparison of all models took
398 s instead of 25 s on two busy cores), and they round differently, so that a training would
depend on the number of cores.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import wraps
from typing import Any, ParamSpec, TypeVar

_Parameters = ParamSpec('_Parameters')
Result = TypeVar('Result')


def single_threaded(function: Callable[_Parameters, Result]) -> Callable[_Parameters, Result]:
    """Return a function that runs with one thread of linear algebra.

    Without threadpoolctl, which comes with scikit-learn, the number of threads stays as the
    environment has it (`OMP_NUM_THREADS`).
    """

    @wraps(function)
    def limited(*args: _Parameters.args, **kwargs: _Parameters.kwargs) -> Result:
        with _one_thread():
            return function(*args, **kwargs)

    return limited


def _one_thread() -> AbstractContextManager[Any]:
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        return nullcontext()
    limits: AbstractContextManager[Any] = threadpool_limits(limits=1)
    return limits

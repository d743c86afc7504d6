# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Processor and libraries that a process computes with, as words that a recording keeps.

Sums, products and elementary functions are rounded otherwise by other instructions: numpy and the
C library choose theirs by what the processor has, BLAS by the processor's make.
"""

import ctypes
import hashlib
import math
import platform
from collections.abc import Collection
from functools import cache
from importlib import import_module, metadata

import numpy as np

_LIBRARIES = ('numpy=', 'scipy=', 'libc=')
_CORE_NAMES = tuple(
    f'{prefix}openblas_get_corename{suffix}' for prefix in ('scipy_', '') for suffix in ('64_', '')
)


@cache
def arithmetic() -> str:
    """Return what this process computes with, in words: instructions, BLAS kernel, libraries.

    Examples
    --------
    >>> 'numpy=' in arithmetic()
    True
    """
    words = [
        platform.machine(),
        *_features(),
        f'kernel={_kernel()}',
        f'functions={_functions()}',
        f'numpy={np.__version__}',
        f'scipy={_version_of_scipy()}',
        f'libc={_version_of_libc()}',
    ]
    return ' '.join(words)


def apart(recorded: Collection[str], here: str) -> str:
    """Say how what a recording was computed with differs from what computes `here`.

    Parameters
    ----------
    recorded : collection of str
        What each of its processes computed with; empty where it does not say.
    here : str
        What this process computes with.

    Returns
    -------
    str
        Empty if all are alike.

    Examples
    --------
    >>> apart(['x86_64 AVX2 numpy=2.1'], 'x86_64 AVX2 numpy=2.2')
    'with other libraries (numpy=2.1, here numpy=2.2)'
    >>> apart(['x86_64 AVX2', 'x86_64'], 'x86_64')
    'on another kind of processor (AVX2, here nothing of it)'
    """
    own = here.split()
    words = [word for text in recorded for word in text.split()]
    theirs = list(dict.fromkeys(word for word in words if word not in own))
    ours = [word for word in own if any(word not in text.split() for text in recorded)]
    if not theirs and not ours:
        return ''
    # Elementary functions are those of the C library.
    other = any(word.startswith('libc=') for word in theirs)
    known = (*_LIBRARIES, 'functions=') if other else _LIBRARIES
    libraries = [w for w in (*theirs, *ours) if w.startswith(known)]
    what = 'with other libraries'
    if len(libraries) < len(theirs) + len(ours):
        what = 'on another kind of processor'
        theirs, ours = ([w for w in some if w not in libraries] for some in (theirs, ours))
    there = ' '.join(theirs) or 'nothing of it'
    return f'{what} ({there}, here {" ".join(ours) or "nothing of it"})'


def _features() -> list[str]:
    """Return the instructions that numpy uses here; none where it does not say."""
    for name in ('numpy._core', 'numpy.core'):
        try:
            module = import_module(f'{name}._multiarray_umath')
        except ImportError:
            continue
        return [key for key, used in getattr(module, '__cpu_features__', {}).items() if used]
    return []


def _functions() -> str:
    """Return a hash of what elementary functions of the C library give.

    It has them for several generations of processors, and nothing tells which it has chosen.
    """
    # Few arguments in a thousand are rounded otherwise.
    points = [0.37 + 0.0917 * k for k in range(8000)]
    found = [function(x) for function in (math.sin, math.cos) for x in points]
    found += [function(x % 1.0) for function in (math.asin, math.acos) for x in points]
    found += [math.expm1(-x % 3.0) for x in points] + [x**0.7 for x in points]
    return hashlib.sha256(np.array(found, '<f8').tobytes()).hexdigest()[:8]


def _kernel() -> str:
    """Return the kernel that OpenBLAS uses here; empty for another BLAS."""
    try:
        library = ctypes.CDLL(import_module('numpy.linalg._umath_linalg').__file__)
    except (ImportError, OSError):
        return ''
    for name in _CORE_NAMES:
        try:
            tell = getattr(library, name)
        except AttributeError:
            continue
        tell.restype = ctypes.c_char_p
        return bytes(tell() or b'').decode(errors='replace')
    return ''


def _version_of_scipy() -> str:
    """Return it without an import, which would cost every node a third of a second."""
    try:
        return metadata.version('scipy')
    except metadata.PackageNotFoundError:
        return ''


def _version_of_libc() -> str:
    try:
        tell = ctypes.CDLL(None).gnu_get_libc_version
    except (OSError, AttributeError):
        return ''
    tell.restype = ctypes.c_char_p
    return bytes(tell() or b'').decode(errors='replace')

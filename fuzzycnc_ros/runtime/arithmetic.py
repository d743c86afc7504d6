# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Processor and libraries that a process computes with, as words that a recording keeps.

Sums, products and elementary functions are rounded otherwise by other instructions: numpy and the
C library choose theirs by what the processor has, BLAS by the processor's make.
"""

import ctypes
import os
from collections.abc import Collection
from functools import cache
from importlib import import_module

import numpy as np
import scipy

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
    tunables = os.environ.get('GLIBC_TUNABLES', '')
    words = [
        os.uname().machine,
        *_features(),
        *([f'kernel={_kernel()}'] if _kernel() else []),
        *([f'tunables={"".join(tunables.split())}'] if 'hwcaps' in tunables else []),
        f'numpy={np.__version__}',
        f'scipy={scipy.__version__}',
        f'libc={"-".join((_libc() or "unknown").split())}',
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
    libraries = [w for w in (*theirs, *ours) if w.startswith(_LIBRARIES)]
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


@cache
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


def _libc() -> str:
    try:
        return os.confstr('CS_GNU_LIBC_VERSION') or ''
    except ValueError:
        return ''

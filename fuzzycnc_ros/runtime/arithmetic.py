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
from collections.abc import Callable, Collection
from functools import cache
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec

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
        f'libm={_functions()}',
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
    told = [text.split() for text in recorded]
    theirs = list(
        dict.fromkeys(w for words in told for w in words if w not in own and _is_said(w, own))
    )
    ours = [w for w in own if any(w not in words and _is_said(w, words) for words in told)]
    if not theirs and not ours:
        return ''
    # Elementary functions are those of the C library.
    other = any(word.startswith('libc=') for word in theirs)
    known = (*_LIBRARIES, 'libm=') if other else _LIBRARIES
    libraries = [w for w in (*theirs, *ours) if w.startswith(known)]
    what = 'with other libraries'
    if len(libraries) < len(theirs) + len(ours):
        what = 'on another kind of processor'
        theirs, ours = ([w for w in some if w not in libraries] for some in (theirs, ours))
    there = ' '.join(theirs) or 'nothing of it'
    return f'{what} ({there}, here {" ".join(ours) or "nothing of it"})'


def _is_said(word: str, words: Collection[str]) -> bool:
    """Return True if words concern the subject of a word: of `key=value` only with that key.

    Other versions have other keys.
    """
    key, equals, _ = word.partition('=')
    return not equals or any(other.startswith(f'{key}=') for other in words)


def _features() -> list[str]:
    """Return the instructions that numpy uses here; none where it does not say."""
    for name in ('numpy._core', 'numpy.core'):
        try:
            module = import_module(f'{name}._multiarray_umath')
        except ImportError:
            continue
        return [key for key, used in getattr(module, '__cpu_features__', {}).items() if used]
    return []


_TELLING: tuple[tuple[Callable[[float], float], tuple[int, ...]], ...] = (
    (math.sin, (2519, 18980, 53504, 90503, 108030, 146020, 161105, 199625)),
    (math.cos, (3307, 28635, 66046, 83437, 124623, 140868, 176779, 195954)),
    (math.asin, (1888, 2937, 5450, 5801, 7631, 10886, 14387, 15361)),
    (math.acos, (11705, 12243, 15733)),
    (lambda x: math.atan2(x, 1.0), (1443, 8089, 30965, 65158, 99202, 128324, 170445, 188383)),
    (math.exp, (-145923, -131626, -106489, -90974, -71456, -46630, -25313, -247)),
    (math.expm1, (-61381, -17333, -6582, -5317, -4389, -3894, -3377, -1598)),
    (math.log, (7223, 10458, 11223, 11640, 13458, 27642, 54692, 75137)),
    (lambda x: x**0.7, (1393, 36034, 55762, 77428, 98921, 131082, 164024, 198957)),
)
"""Functions, and arguments in 1/16384 at which glibc 2.36 rounds otherwise with FMA than without.

They are one to nine of ten thousand.
"""


def _functions() -> str:
    """Return a hash of what elementary functions of the C library give.

    It has them for several generations of processors, and nothing tells which it has chosen.
    """
    found = [function(k / 16384) for function, arguments in _TELLING for k in arguments]
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
    """Return it without an import of scipy, which would cost every node a third of a second."""
    package = find_spec('scipy')
    places = package.submodule_search_locations if package else None
    found = PathFinder.find_spec('scipy.version', places) if places else None
    if found is None or found.loader is None:
        return ''
    module = module_from_spec(found)
    found.loader.exec_module(module)
    return str(getattr(module, 'version', ''))


def _version_of_libc() -> str:
    try:
        tell = ctypes.CDLL(None).gnu_get_libc_version
    except (OSError, AttributeError):
        return ''
    tell.restype = ctypes.c_char_p
    return bytes(tell() or b'').decode(errors='replace')

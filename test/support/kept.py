# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Model files of tests: trained once, kept until what they depend on changes."""

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import scipy

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / 'build' / 'test-models'


@cache
def _of_the_package() -> str:
    """Return a hash of the sources of the package and of what it computes with."""
    digest = hashlib.sha256(f'{sys.version} {np.__version__} {scipy.__version__}'.encode())
    for path in sorted((ROOT / 'fuzzycnc_ros').rglob('*.py')):
        digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return digest.hexdigest()


def kept(make: Callable[..., str]) -> Callable[..., str]:
    """Keep the text that a function makes, in this process and in a file under `build/`.

    The file's name is a hash of the package, of the source file of `make` and of the arguments,
    so that no test ever sees the model of another version.
    """
    source = Path(make.__code__.co_filename).read_bytes()

    @cache
    def text(*arguments: object) -> str:
        digest = hashlib.sha256(_of_the_package().encode() + source)
        digest.update(f'{make.__qualname__}{arguments}'.encode())
        path = FOLDER / f'{make.__name__}-{digest.hexdigest()[:24]}.json'
        if path.is_file():
            return path.read_text(encoding='utf-8')
        made = make(*arguments)
        FOLDER.mkdir(parents=True, exist_ok=True)
        draft = path.with_suffix(f'.{os.getpid()}')
        draft.write_text(made, encoding='utf-8')
        draft.replace(path)
        return made

    return text

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files written whole or not at all."""

import os
from pathlib import Path


def write_text(path: Path, text: str) -> None:
    """Write a text file; a reader sees the old content or the new, never a part.

    Raises
    ------
    OSError
        If the folder cannot be written; the old file stays.
    """
    temporary = path.with_name(f'.{path.name}.new')
    temporary.write_text(text, encoding='utf-8')
    os.replace(temporary, path)

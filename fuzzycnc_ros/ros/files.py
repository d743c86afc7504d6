# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files that parameters name."""

from pathlib import Path


def file_text(file: str, size_max: int) -> str:
    """Return the text of a file, of at most one character more than is allowed.

    Parameters
    ----------
    file : str
        Its name; `~` is the home folder.
    size_max : int
        Largest document that its reader takes [characters].  One more is refused by the reader;
        an endless file ends here.

    Raises
    ------
    ValueError
        If it cannot be read.
    """
    try:
        with Path(file).expanduser().open(encoding='utf-8') as opened:
            return opened.read(size_max + 1)
    except OSError as error:
        raise ValueError(error.strerror) from error
    except RuntimeError as error:  # a home folder that nobody has
        raise ValueError(str(error)) from error

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the operating system in a sentence that names the file and the remedy."""

import errno
import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

SENTENCES: Mapping[int, str] = MappingProxyType(
    {
        errno.ENOSPC: 'the disk is full; free some space, or name a place on another disk',
        errno.EDQUOT: 'your share of the disk is used up; remove some files, or name a place on '
        'another disk',
        errno.EFBIG: 'the file would be larger than allowed; see `ulimit -f`, or name a place on '
        'another disk',
        errno.EACCES: 'no permission; change its rights with chmod, ask its owner, or name '
        'another place',
        errno.EPERM: 'no permission; ask its owner, or name another place',
        errno.EROFS: 'this disk can only be read; name a place on another one, or mount it for '
        'writing',
        errno.EISDIR: 'expected a file but found a folder; name a file',
        errno.EEXIST: 'expected a new name but it exists; choose another one or remove it',
        errno.ENOTDIR: 'expected a folder but found a file; name another place',
        errno.ENOTEMPTY: 'expected an empty folder but found files in it; remove them, or name '
        'another one',
        errno.ELOOP: 'symbolic links lead round in a circle; remove one of them',
        errno.ENAMETOOLONG: 'the name is too long; choose a shorter one',
        errno.EMFILE: 'too many files are open in this process; allow more with `ulimit -n 4096`',
        errno.ENFILE: 'too many files are open on this computer; close other programs',
        errno.EBUSY: 'something else is using it; wait for that or end it',
        errno.ETXTBSY: 'it is being run; end it first',
        errno.EIO: 'the disk cannot read or write it; look for faults of the disk with `dmesg`',
        errno.ENOMEM: 'there is not enough memory; end other programs',
        errno.EPIPE: 'its reader has gone, so the rest of the output is lost',
    }
)
"""Cause and remedy, by the number of the error."""

STANDARD_OUTPUT = 'standard output'


def os_sentence(error: OSError, path: Path | str | None = None) -> str:
    """Return an error of the operating system in a sentence.

    Parameters
    ----------
    error : OSError
        The error.
    path : Path or str, optional
        The file that it is about, if the error does not name the one that people know.

    Returns
    -------
    str
        File, what happened, and the remedy; the text of the error if it has no number.

    Examples
    --------
    >>> os_sentence(OSError(errno.ENOSPC, 'No space left on device', 'shift.json'))
    'shift.json: the disk is full; free some space, or name a place on another disk'
    """
    if error.errno is None:
        return str(error)
    file = path if path is not None else error.filename2 or error.filename
    place = '' if file is None else os.fsdecode(file)
    if error.errno in (errno.ENOENT, errno.ENOTDIR) and place:
        if Path(place).absolute().parent.is_dir():
            return f'{place}: expected a file but nothing is there; check the name'
        return no_folder(place)
    text = SENTENCES.get(error.errno, error.strerror or str(error))
    return f'{place}: {text}' if place else text


def about(error: OSError, path: Path | str) -> OSError:
    """Return the error with the file that people know, in place of a temporary one or of none."""
    error.filename, error.filename2 = os.fspath(path), None
    return error


def no_folder(path: Path | str) -> str:
    """Return in a sentence that the folder of a file is missing, or is a file itself."""
    for folder in reversed(Path(path).parents):
        if folder.exists() and not folder.is_dir():
            return f'{path}: expected a folder but {folder} is a file; name another place'
    parent = Path(path).parent
    return f'{path}: expected an existing folder but found no {parent}; make it first'

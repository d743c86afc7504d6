# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Facts about a whole part program that have to be known before its first line is read."""

import re
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Outline:
    """Facts about a whole program.

    Parameters
    ----------
    jumps : frozenset of int or None
        Numbers N of the lines that jumps may lead to, None where it may be any line.
    unnamed : str
        Which of X, Y and Z no line names: they never move by the program's own words.
    lathe : bool
        A lathe of Fanuc's kind (Haas, Okuma): X is a diameter, U and W are relative X and Z,
        G98 and G99 are modes of the feed, and the plane is that of X and Z.
    """

    jumps: frozenset[int] | None = frozenset()
    unnamed: str = ''
    lathe: bool = False


_JUMP = re.compile(
    r'(?:GOTO[FBCS]?[ \t]*N?|M0*9[79][ \t]*P|REPEATB?[ \t]+N|IF[ \t]*\[.*\][ \t]*N)'
    r'[ \t]*(?:0*(\d{1,9})(?!\d)|[#\["])',
    re.IGNORECASE | re.ASCII,
)
_MAY_JUMP = re.compile(r'GOTO|M0*9[79]|REPEAT|IF', re.IGNORECASE | re.ASCII)
_COMMENT = re.compile(r'\([^)\r\n]*\)?|;.*')


_AXIS = {
    axis: re.compile(rf'(?<![A-Z_]){letters}(?![A-Z_])', re.IGNORECASE | re.ASCII)
    for axis, letters in (('X', '[XU@^]'), ('Y', '[YV@^]'), ('Z', '[ZW]'))
}
_SIGNS = {'X': 'XxUu@^', 'Y': 'YyVv@^', 'Z': 'ZzWw'}
_CALL = re.compile(r'[ \t/]*(?:N[ \t]*\d+[ \t]*)?O[ \t]*[\d<#\[].*CALL', re.IGNORECASE | re.ASCII)
# A limit of the spindle by G50, or a way home by U and W: LinuxCNC and mills have neither.
_LATHE = re.compile(
    r'(?:G[ \t]*0*50(?![\d.]).*S[ \t]*[\d#\[]|S[ \t]*\d.*G[ \t]*0*50(?![\d.])'
    r'|G[ \t]*0*(?:28|30|53)(?![\d.]).*(?<![A-Z_])[UW][ \t]*[-+.\d])',
    re.IGNORECASE | re.ASCII,
)
_RELATIVE = re.compile(r'(?<![A-Z_])G[ \t]*0*91(?![\d.])', re.IGNORECASE | re.ASCII)


def outline_of(lines: Iterable[str]) -> Outline:
    """Return what is to be known of a program before it is read.

    Jumps are `GOTO 10` and `M99 P10` of Fanuc, `M97 P10` of Haas, `GOTOB N10` and `REPEAT N10 N20`
    of Siemens, and `IF [...] N10` of Okuma; labels of Siemens' controls are known where they
    stand.  A program is one of a lathe if it has words that no mill has, never names Y and has no
    G91, which such lathes do not know.

    Parameters
    ----------
    lines : iterable of str
        All lines.
    """
    jumps: set[int] | None = set()
    unnamed, lathe, relative, signs = dict(_AXIS), False, False, ''.join(_SIGNS.values()) + 'Ss'
    for line in lines:
        if jumps is not None and _MAY_JUMP.search(line) is not None:
            jumps = _more_jumps(jumps, _COMMENT.sub('', line))
        if not unnamed:
            continue
        if _CALL.match(line):  # what lies in a file of its own may name any axis
            unnamed = {}
            continue
        if not any(sign in line for sign in signs) and '91' not in line:
            continue  # most lines of a program in a plane
        text = _COMMENT.sub('', line)
        for axis in [axis for axis, word in unnamed.items() if word.search(text)]:
            del unnamed[axis]
            signs = ''.join(_SIGNS[axis] for axis in unnamed) + 'SsUuWw' * ('Y' in unnamed)
        lathe = lathe or _LATHE.search(text) is not None
        relative = relative or _RELATIVE.search(text) is not None
    return Outline(
        None if jumps is None else frozenset(jumps),
        ''.join(unnamed),
        lathe and not relative and list(unnamed) == ['Y'],
    )


def _more_jumps(jumps: set[int], text: str) -> set[int] | None:
    """Return jumps with those of a line, None if one of them is computed."""
    found = set(jumps)
    for match in _JUMP.finditer(text):
        if match[1] is None:
            return None
        found.add(int(match[1]))
    return found

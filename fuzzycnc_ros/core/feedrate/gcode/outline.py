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
_NUMBER = r'[ \t]*[-+.\d#\[]'
_MARKS = {
    name: re.compile(rf'(?<![A-Z_])(?:{pattern})', re.IGNORECASE | re.ASCII)
    for name, pattern in {
        # A limit of the spindle, a cycle of a contour, a way home by U and W: of no mill.
        'lathe': rf'G[ \t]*0*50(?![\d.]).*S{_NUMBER}|S[ \t]*\d.*G[ \t]*0*50(?![\d.])'
        rf'|G[ \t]*0*92(?![\d.])[^A-Z]*S{_NUMBER}[^A-Z]*$|S[ \t]*\d[^A-Z]*G[ \t]*0*92(?![\d.])'
        rf'|G[ \t]*0*(?:28|30|53)(?![\d.]).*(?<![A-Z_])[UW]{_NUMBER}'
        rf'|G[ \t]*0*7[0-2](?![\d.]).*P[ \t]*\d.*Q[ \t]*\d',
        'surface speed': rf'G[ \t]*0*96(?![\d.]).*S{_NUMBER}|S{_NUMBER}.*G[ \t]*0*96(?![\d.])',
        'turret': r'T[ \t]*\d{3,4}(?!\d)',
        'U or W': rf'[UW]{_NUMBER}',
        'G91': r'G[ \t]*0*91(?![\d.])',
        # LinuxCNC and Siemens: radius or diameter, change of a tool, limit beside the speed.
        'other': r'G[ \t]*0*[78](?![\d.])|M[ \t]*0*6(?![\d.])|DIAM|LIMS'
        rf'|G[ \t]*0*96(?![\d.]).*D{_NUMBER}|D{_NUMBER}.*G[ \t]*0*96(?![\d.])',
    }.items()
}
_MARKED = 'MmSsTtUuWw'
_MARK_WITHOUT = re.compile(r'DIAM|G[ \t]*0*(?:[78]|91)(?![\d.])', re.IGNORECASE | re.ASCII)


def outline_of(lines: Iterable[str]) -> Outline:
    """Return what is to be known of a program before it is read.

    Jumps are `GOTO 10` and `M99 P10` of Fanuc, `M97 P10` of Haas, `GOTOB N10` and `REPEAT N10 N20`
    of Siemens, and `IF [...] N10` of Okuma; labels of Siemens' controls are known where they
    stand.  A program is one of a lathe if it names X and Z, never Y, and has words of no mill:
    a limit of the spindle, a cycle of a contour such as G71 P10 Q20, a way home by U and W, or a
    constant surface speed with tools such as T0101, without words of LinuxCNC and Siemens.  With
    G91, U and W would be axes.

    Parameters
    ----------
    lines : iterable of str
        All lines.
    """
    jumps: set[int] | None = set()
    unnamed, unmarked, signs = dict(_AXIS), dict(_MARKS), ''.join(_SIGNS.values()) + _MARKED
    for line in lines:
        if jumps is not None and _MAY_JUMP.search(line) is not None:
            jumps = _more_jumps(jumps, _COMMENT.sub('', line))
        if not unnamed:
            continue
        if _CALL.match(line):  # what lies in a file of its own may name any axis
            unnamed = {}
            continue
        if not any(sign in line for sign in signs) and not _MARK_WITHOUT.search(line):
            continue  # most lines of a program in a plane
        text = _COMMENT.sub('', line)
        for axis in [axis for axis, word in unnamed.items() if word.search(text)]:
            del unnamed[axis]
            signs = ''.join(_SIGNS[axis] for axis in unnamed) + _MARKED * ('Y' in unnamed)
        if 'Y' in unnamed:
            for name in [name for name, words in unmarked.items() if words.search(text)]:
                del unmarked[name]
    return Outline(
        None if jumps is None else frozenset(jumps),
        ''.join(unnamed),
        list(unnamed) == ['Y'] and _is_lathe(_MARKS.keys() - unmarked),
    )


def _is_lathe(marks: set[str]) -> bool:
    """Return whether a program with these marks is one of a lathe of Fanuc's kind."""
    if marks >= {'U or W', 'G91'}:
        return False
    return 'lathe' in marks or (marks >= {'surface speed', 'turret'} and 'other' not in marks)


def _more_jumps(jumps: set[int], text: str) -> set[int] | None:
    """Return jumps with those of a line, None if one of them is computed."""
    found = set(jumps)
    for match in _JUMP.finditer(text):
        if match[1] is None:
            return None
        found.add(int(match[1]))
    return found

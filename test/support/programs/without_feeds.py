# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs without their feeds, to compare what a new program must not change."""

import re

from fuzzycnc_ros.core.feedrate.gcode.lexer import read_line


def strip_feeds(text: str) -> str:
    """Return a program without its feed words, to compare what must not change.

    Parameters
    ----------
    text : str
        A part program.

    Returns
    -------
    str
        The program without the words F that set a feed, and without the blanks before them.
    """
    lines = []
    for number, line in enumerate(re.findall(r'[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+', text), 1):
        rest = line
        if 'F' in line or 'f' in line:
            words = read_line(line, number).words
            if not any(word.letter == 'G' and word.value == 4.0 for word in words):
                for word in reversed(words):
                    if word.letter == 'F':
                        rest = rest[: word.start].rstrip(' \t') + rest[word.end :]
        lines.append(rest)
    return ''.join(lines)

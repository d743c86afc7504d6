# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Path mode of a part program: its words set and taken out."""

from fuzzycnc_ros.core.feedrate.gcode.blocks import Block
from fuzzycnc_ros.core.feedrate.gcode.lexer import read_line
from fuzzycnc_ros.core.feedrate.gcode.modal import MILLIMETRE, MINUTE
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.simulation.controller.program import PathMode

MODES = (61.0, 61.1, 64.0)
"""G words that set the path mode."""


def program_with_mode(text: str, mode: PathMode, units: str = 'mm') -> str:
    r"""Return a program whose path mode is one throughout: one line more, no other mode word.

    Parameters
    ----------
    text : str
        The program.
    mode : PathMode
        With a rounding above 0.
    units : {'mm', 'inch'}
        Unit before the program says G20 or G21.

    Examples
    --------
    >>> text = 'G21 G64 P0.1\nG1 X1 F60\nG61 X2\n'
    >>> print(program_with_mode(text, PathMode(2e-5, 2e-5)), end='')
    G21
    G64 P0.02 Q0.02
    G1 X1 F60
    X2
    """
    lines: list[str] = []
    set_yet = False
    for block in read_program(text, units).blocks:
        moves = block.segment is not None
        if moves and not set_yet:
            unit = block.feed_unit * MINUTE / MILLIMETRE
            lines.append(mode_line(mode, unit))
            set_yet = True
        lines.append(_without_mode(block))
    return ''.join(lines)


def mode_line(mode: PathMode, unit: float) -> str:
    """Return the line that sets a mode where a length of 1 is so many millimetres."""
    rounding, merging = 1e3 * mode.rounding / unit, 1e3 * mode.merging / unit
    return f'G64 P{rounding:.6f}'.rstrip('0') + f' Q{merging:.6f}'.rstrip('0') + '\n'


def _without_mode(block: Block) -> str:
    """Return a line without its words of the path mode."""
    text = block.text
    words = read_line(text, block.line).words
    if not any(word.letter == 'G' and word.value in MODES for word in words):
        return text
    waits = any(word.letter == 'G' and word.value == 4.0 for word in words)
    for word in reversed(words):
        own = word.letter == 'G' and word.value in MODES
        if own or (word.letter in 'PQ' and not waits):
            text = text[: word.start].rstrip(' \t') + text[word.end :]
    return text.lstrip(' ') if not block.text.startswith(' ') else text

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What G words do to the modal state."""

from collections.abc import Callable

from fuzzycnc_ros.core.feedrate.program import cycles, modal
from fuzzycnc_ros.core.feedrate.program.lexer import Line
from fuzzycnc_ros.core.feedrate.program.motion import named_axes

LOST = 'where the tool stands is unknown until all axes are named'


class GWords:
    """Takes G words, as numbers in tenths: 53 is G5.3, below 0 is one that is computed.

    Parameters
    ----------
    state : State
        Modal state that they change.
    say : callable
        Told what is passed through.
    """

    def __init__(self, state: modal.State, say: Callable[[str], None]) -> None:
        self._state = state
        self._say = say

    def take(self, code: int, line: Line) -> str:
        """Heed a G word; return what it does to the line, empty for nothing special."""
        state = self._state
        if code in modal.MOTION:
            state.motion = code
            state.cycle = None
        elif code in modal.PLANE:
            state.plane = modal.PLANE[code]
        elif code in modal.LENGTH_UNIT:
            state.length_unit = modal.LENGTH_UNIT[code]
            if code in modal.FEED_UNITS:
                state.unit_said = True
                state.feed_unit = state.length_unit / modal.MINUTE
        elif code in (900, 910):
            state.absolute = code == 900
        elif code in (901, 911):
            state.centre_absolute = code == 901
        elif code in (930, 940, 950):
            self._feed_mode(code // 10)
        elif code == 40:
            return 'dwell'
        elif code in modal.CYCLES:
            cycles.begin(code, state)
            state.motion = -1
        elif code in modal.ELSEWHERE:
            return 'elsewhere'
        elif code in modal.CALLS:
            return 'call'
        elif code in modal.FRAMES:
            state.lose()
            self._say(f'G{code / 10:g}: new coordinates; {LOST}')
            return 'shift'
        elif code == 920:
            self._set_place(line)
            return 'shift'
        else:
            return self._other_code(code, line)
        return ''

    def _other_code(self, code: int, line: Line) -> str:
        """Heed a G word that moves nothing by itself."""
        state = self._state
        if code in modal.OFFSETS:
            if state.offset not in (None, code):
                state.lose()
                self._say(f'change of the work offset: {LOST}')
            state.offset = code
        elif code in modal.TOOL_LENGTHS or (code == 490 and state.tool_length):
            state.tool_length = code != 490
            state.lose('Z')
            self._say('change of the tool length: where Z stands is unknown until it is named')
        elif code in modal.CUTTER:
            state.cutter = True
            self._say(f'cutter compensation (G{code / 10:g}): the path is the programmed one')
        elif code == 400:
            state.cutter = False
        elif code in (980, 990):
            state.retracts = code == 990
        elif code in (160, 150):
            state.polar = code == 160
        elif code == 800:
            state.motion = None if state.motion == -1 else state.motion
            state.cycle = None
        elif code not in modal.HARMLESS:
            self._say(
                f'unknown word G{code / 10:g}: passed through' if code >= 0 else 'computed G'
            )
            if code < 0 or named_axes(line):
                state.lose()
                return 'gone'
        return ''

    def _set_place(self, line: Line) -> None:
        """G92: the tool stands where the words say, from now on."""
        state = self._state
        state.kind = ''
        self._say('G92: new coordinates')
        for letter, value, _, _ in line.words:
            if letter in 'XYZ':
                if value is None:
                    state.lose(letter)
                else:
                    state.position['XYZ'.index(letter)] = value * state.length_unit
                    state.assumed.discard(letter)
            elif letter in 'ABCUVW':
                state.others.pop(letter, None)
                if value is not None:
                    state.others[letter] = value

    def _feed_mode(self, mode: int) -> None:
        state = self._state
        if mode != state.feed_mode:
            state.feed, state.feed_known, state.feed_mode = None, True, mode
        if mode != 94:
            self._say(f'G{mode}: the feed is no length per time and is kept')

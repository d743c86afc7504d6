# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of RS 274 (`#1`, `#<name>`): set by the program, or known to the controller alone."""

from math import isfinite

from fuzzycnc_ros.core.feedrate.gcode.modal import INCH, ModalState

ARGUMENTS = 30
"""`#1` to `#30` belong to the subroutine that runs."""

_SETTINGS = 5061
"""From here on the controller keeps its own values: probed places, offsets, the tool."""

_LAST = 10_000  # above all numbers of parameters
_PLACES = 5420
"""`#5420` to `#5428` are the places of X, Y, Z, A, B, C, U, V and W."""

_AXES = 'XYZABCUVW'
_INTEGER = 1e-4  # how far off a whole number may be, as in LinuxCNC


class Parameters:
    """Values of parameters while a program runs; None is what only the controller knows.

    Parameters
    ----------
    state : ModalState
        Modal state, for the parameters that the controller sets from it.

    Attributes
    ----------
    unknown : str
        What was unknown when it was read last, mostly a parameter, for messages.

    Notes
    -----
    Numbered parameters and global ones (`#<_name>`) outlive programs: what this program has not
    set is unknown.  `#<_feed>` is unknown always: its value is what scheduling changes.
    """

    def __init__(self, state: ModalState) -> None:
        self._state = state
        self._numbered: dict[int, float | None] = {}
        self._global: dict[str, float | None] = {}
        self._local: list[dict[str, float | None]] = [{}]
        self._saved: list[dict[int, float | None]] = []
        self._result: tuple[float | None, float] = (0.0, 0.0)
        self.unknown = ''

    @property
    def depth(self) -> int:
        """Depth of nested subroutine calls."""
        return len(self._local) - 1

    def number(self, index: float | None) -> float | None:
        """Return a numbered parameter; None for an unknown one."""
        if index is None:
            return None
        found = None
        whole = round(index) if abs(index) < _LAST else 0
        if abs(index - whole) <= _INTEGER:
            if _PLACES <= whole < _PLACES + len(_AXES):
                found = self._place(_AXES[whole - _PLACES])
            else:
                found = self._numbered.get(whole)
        if found is None:
            self.unknown = f'#{index:g}'
        return found

    def named(self, name: str) -> float | None:
        """Return a named parameter; None for an unknown one."""
        if name.startswith('_'):
            found = self._global[name] if name in self._global else self._predefined(name)
        else:
            found = self._local[-1].get(name)
        if found is None:
            self.unknown = f'#<{name}>'
        return found

    def exists(self, name: str) -> float | None:
        """Return 1 for a parameter that is set, 0 for one that is not, None if nobody knows."""
        if not name.startswith('_'):
            return float(name in self._local[-1])
        if name in self._global or self._predefined(name) is not None:
            return 1.0
        self.unknown = f'#<{name}>'
        return None

    def doubt(self, what: str) -> None:
        """Remember what is unknown."""
        self.unknown = what

    def set_number(self, index: float | None, value: float | None) -> None:
        """Set a numbered parameter; with an unknown index every one of them becomes unknown."""
        if index is None:
            self._numbered.clear()
        elif 0.0 < index < _SETTINGS - 0.5:
            self._numbered[round(index)] = value

    def set_named(self, name: str, value: float | None) -> None:
        """Set a named parameter."""
        (self._global if name.startswith('_') else self._local[-1])[name] = value

    def enter(self, arguments: list[float | None] | None) -> None:
        """Begin a subroutine; None hands on `#1` to `#30` as they are (M98)."""
        own = range(1, ARGUMENTS + 1)
        self._saved.append({})
        self._local.append({})
        if arguments is not None:
            self._saved[-1] = {index: self._numbered.get(index) for index in own}
            rest = [0.0] * (ARGUMENTS - len(arguments))
            self._numbered.update(zip(own, [*arguments, *rest], strict=True))
            self._local[-1]['n_args'] = float(len(arguments))

    def leave(self, result: tuple[float | None, float]) -> None:
        """End a subroutine; its result and whether it gave one."""
        self._local.pop()
        self._numbered.update(self._saved.pop())
        self._result = result

    def forget(self, everything: bool = False) -> None:
        """Forget what a subroutine that was not followed may have set, or really everything."""
        own = {} if everything else self._numbered
        self._numbered = {at: value for at, value in own.items() if at <= ARGUMENTS}
        if everything:
            self._local[-1] = dict.fromkeys(self._local[-1])
        self._global = dict.fromkeys(self._global)
        self._result = (None, 0.0)

    def _predefined(self, name: str) -> float | None:
        """Return a parameter that the controller sets, as far as the program tells it."""
        state = self._state
        if len(name) == 2 and name[1].upper() in _AXES:
            return self._place(name[1].upper())
        if name == '_value':
            return self._result[0]
        if name == '_value_returned':
            return None if self._result[0] is None else self._result[1]
        if name in ('_metric', '_imperial') and not state.unit_said:
            return None
        found = {
            '_absolute': state.absolute,
            '_incremental': not state.absolute,
            '_metric': state.length_unit != INCH,
            '_imperial': state.length_unit == INCH,
            '_inverse_time': state.feed_mode == 93,
            '_units_per_minute': state.feed_mode == 94,
            '_units_per_rev': state.feed_mode == 95,
            '_ijk_absolute_mode': state.centre_absolute,
            '_lathe_diameter_mode': state.x_share[0] != 1.0,
            '_lathe_radius_mode': state.x_share[0] == 1.0,
            '_plane': 10 * state.plane,
            '_call_level': self.depth,
        }.get(name)
        return None if found is None else float(found)

    def _place(self, axis: str) -> float | None:
        """Return where an axis stands, in the unit of the program."""
        state = self._state
        if axis not in 'XYZ':
            return state.others.get(axis)
        place = state.position['XYZ'.index(axis)]
        if state.cutter or axis in state.assumed or not isfinite(place):
            return None
        # Lengths are kept in metres: what the program wrote has few decimals.
        return round(place / state.length_unit, 10)

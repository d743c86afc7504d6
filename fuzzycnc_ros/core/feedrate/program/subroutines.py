# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where subroutines are found: in the program, or in files of their own."""

from collections.abc import Callable

from fuzzycnc_ros.core.feedrate.program.flow import Listing

LINES = 200_000
"""Lines that a steered part, or a file, has at most: they are held in memory."""

Files = Callable[[str], str | None]
"""Told the name of a subroutine; returns the text of its file, None where there is none."""


class Subroutines:
    """Finds subroutines in the order of LinuxCNC: before the call, in a file, behind the call.

    Parameters
    ----------
    main : Listing
        The program.
    files : callable or None
        Finds files.
    """

    def __init__(self, main: Listing, files: Files | None) -> None:
        self._main = main
        self._files = files
        self._loaded: dict[str, Listing | None] = {}

    def find(self, name: str, caller: Listing, index: int) -> tuple[Listing, int] | None:
        """Return where `oNAME sub` stands, called before a line of a text; None for nowhere."""
        own = caller.subroutine(name)
        if own is not None and own < index:
            return caller, own
        main = self._main.subroutine(name)
        if main is not None and caller is not self._main:
            return self._main, main
        listing = self._file(name)
        start = None if listing is None else listing.subroutine(name)
        if listing is not None and start is not None:
            return listing, start
        return None if own is None else (caller, own)

    def _file(self, name: str) -> Listing | None:
        if name not in self._loaded:
            text = self._files(name) if self._files is not None and name else None
            lines = [] if text is None else text.splitlines(keepends=True)
            known = 0 < len(lines) <= LINES
            self._loaded[name] = Listing(lines, label=f'{name}.ngc') if known else None
        return self._loaded[name]

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What was passed through untouched, and where."""

from fuzzycnc_ros.core.feedrate.program.blocks import Note


class Notes:
    """Collects notes; the same text is counted."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[int, int]] = {}

    def add(self, line: int, text: str) -> None:
        """Add a note of a line."""
        first, count = self._found.get(text, (line, 0))
        self._found[text] = (first, count + 1)

    def all(self) -> tuple[Note, ...]:
        """Return the notes in the order in which they were met first."""
        return tuple(Note(line, count, text) for text, (line, count) in self._found.items())

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The console of all commands: it shows text of foreign origin as it is, and obeys none of it."""

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import Task, TextColumn
from rich.segment import Segment
from rich.text import Text

from fuzzycnc_ros.core.names import visible


class Terminal(Console):
    """A console without markup that spells control characters out, in tables and bars too.

    Parameters
    ----------
    **settings
        As of `rich.console.Console`.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(markup=False, emoji=False, **settings)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Render an object to segments; those of rich's own, such as cursor moves, stay."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(visible(segment.text, keep='\n'), segment.style)


class Description(TextColumn):
    """The column of a progress bar that says what is going on."""

    def __init__(self) -> None:
        super().__init__('{task.description}')

    def render(self, task: Task) -> Text:
        """Return the text of a task, whose width is that of what is shown."""
        return Text(visible(task.description), style=self.style)

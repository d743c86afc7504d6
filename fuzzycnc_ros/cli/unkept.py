# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The sentence that a tolerance is not kept, in red."""

import sys

from fuzzycnc_ros.cli.console import say


def say_unkept(text: str) -> None:
    """Print that a tolerance is not kept: in red on a terminal, after a mark elsewhere."""
    if not sys.stdout.isatty():
        say(f'! {text}')
        return
    from fuzzycnc_ros.cli.terminal import Terminal

    Terminal().print(text, style='bold red', soft_wrap=True, highlight=False)

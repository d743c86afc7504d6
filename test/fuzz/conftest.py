# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of a campaign at the end of its run."""

from fuzzing.campaign import CAMPAIGN, WORST


def pytest_terminal_summary(terminalreporter):
    """Show what the worst input of each test took."""
    if not CAMPAIGN:
        return
    terminalreporter.section('campaign')
    for test, worst in WORST.items():
        terminalreporter.write_line(
            f'{test}: {worst.pieces} pieces, at most {worst.time:.2f} s '
            f'and {worst.memory / 1e6:.0f} MB'
        )

# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs (G-code): read them, sample their paths, write them with new feeds."""

from fuzzycnc_ros.core.feedrate.program.blocks import Block, Note, Program, Role
from fuzzycnc_ros.core.feedrate.program.lexer import ProgramError
from fuzzycnc_ros.core.feedrate.program.reader import ProgramReader, read_program
from fuzzycnc_ros.core.feedrate.program.sampling import ProgramPoints, sample_path
from fuzzycnc_ros.core.feedrate.program.segments import (
    ArcSegment,
    DwellSegment,
    LineSegment,
    NurbsSegment,
    Segment,
)
from fuzzycnc_ros.core.feedrate.program.tally import FeedTally
from fuzzycnc_ros.core.feedrate.program.writer import strip_feeds, write_blocks, write_program

__all__ = [
    'ArcSegment',
    'Block',
    'DwellSegment',
    'FeedTally',
    'LineSegment',
    'Note',
    'NurbsSegment',
    'Program',
    'ProgramError',
    'ProgramPoints',
    'ProgramReader',
    'Role',
    'Segment',
    'read_program',
    'sample_path',
    'strip_feeds',
    'write_blocks',
    'write_program',
]

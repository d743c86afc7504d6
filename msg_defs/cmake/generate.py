#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Run one rosidl generator, with the parsed interfaces kept for the next one.

Every generator of ROS parses every interface anew, which takes most of its time.  This takes a
generator's place in `only_python.cmake`: it reads what an earlier one has parsed from
`parsed_interfaces/` in the build folder, then runs the generator that the arguments name.
"""

import hashlib
import os
import pickle
import runpy
import sys
from pathlib import Path

import rosidl_parser.parser

SUFFIX = '__arguments.json'


def parse_once(folder: Path) -> None:
    """Make the parser keep and reuse its results in a folder."""
    parse = rosidl_parser.parser.parse_idl_string
    version = Path(rosidl_parser.parser.__file__).read_bytes()

    def parse_or_load(text: str, png_file: object = None) -> object:
        held = folder / hashlib.sha256(version + text.encode()).hexdigest()
        if held.is_file():
            return pickle.loads(held.read_bytes())
        content = parse(text, png_file=png_file)
        folder.mkdir(exist_ok=True)
        draft = held.with_suffix(f'.{os.getpid()}')  # generators run side by side
        draft.write_bytes(pickle.dumps(content))
        draft.replace(held)
        return content

    rosidl_parser.parser.parse_idl_string = parse_or_load


def main() -> None:
    """Run the generator whose file of arguments is given, `<generator>__arguments.json`."""
    arguments = Path(sys.argv[sys.argv.index('--generator-arguments-file') + 1])
    name = arguments.name[: -len(SUFFIX)]
    prefix = Path(rosidl_parser.__file__).parents[4]
    parse_once(arguments.parent / 'parsed_interfaces')
    runpy.run_path(str(prefix / 'lib' / name / name), run_name='__main__')


if __name__ == '__main__':
    main()

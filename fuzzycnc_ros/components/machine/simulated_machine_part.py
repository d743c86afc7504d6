# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The part that the simulated machine cuts where it is given no other program."""

PART_PROGRAM = """\
%
(Bearing plate, 70 x 44 mm: facing, pocket, slot, four holes)
G21 G17 G90 G94
G0 Z5
(facing)
G0 X-30 Y-15
G1 Z0 F3000
G1 X30 F9000
G3 X30 Y-5 I0 J5
G1 X-30
G2 X-30 Y5 I0 J5
G1 X30
G3 X30 Y15 I0 J5
G1 X-30
G0 Z5
(pocket with rounded corners, from the inside)
G0 X0 Y0
G1 Z-2 F1500
G1 X6 F4800
G3 X6 Y0 I-6 J0
G1 X10 Y0
G1 Y4
G3 X6 Y8 I-4 J0
G1 X-6
G3 X-10 Y4 I0 J-4
G1 Y-4
G3 X-6 Y-8 I4 J0
G1 X6
G3 X10 Y-4 I0 J4
G1 Y0
G0 Z5
(curved slot)
G0 X-18 Y-10
G1 Z-1 F1500
G2 X-18 Y10 I14 J10 F3600
G0 Z5
(holes)
G0 X-26 Y-13
G1 Z-4 F1200
G0 Z5
G0 X26 Y-13
G1 Z-4
G0 Z5
G0 X26 Y13
G1 Z-4
G0 Z5
G0 X-26 Y13
G1 Z-4
G0 Z5
G0 X0 Y0
M2
%
"""
"""A plate of our own in mm, cut in about twenty seconds."""

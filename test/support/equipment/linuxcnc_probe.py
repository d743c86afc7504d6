# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A LinuxCNC with a touch probe and a sphere that the thermal error moves, in its servo thread."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fuzzycnc_ros.adapters.linuxcnc.simulation import LinuxcncSimulation

CENTRE = {'X': 50.0, 'Y': -40.0, 'Z': -80.0}
"""Centre of the sphere [mm]."""
DIAMETER, TIP = 20.0, 6.0
"""Diameters of the sphere and of the tip [mm]."""

FILE = f"""
box: {{X: [0, 100], Y: [-100, 10], Z: [-95, 5]}}
travel_height: -64
tip: {TIP}
clearance: 1
back_off: 0.1
approach_feed: 1500
feed: 60
repeats: 3
artefacts:
  - {{name: ball, kind: sphere, at: [50, -40, -80], diameter: {DIAMETER}, axes: YZ}}
"""
"""Probe file of that sphere."""

NEVER = -1.0
"""Radius of what is never touched [mm]."""
CHIP = 0.06
"""Thickness of a chip [mm]."""
ON_A_SIDE = 4
"""Touches on a side: a fast one, and those that count."""

HAL = """
loadrt sum2 names=tool-x,tool-y,tool-z
loadrt hypot names=ball-distance
loadrt comp names=ball-touch,chip-side
loadrt updown names=touches
loadrt select8 names=chip-touch
loadrt lut5 names=chip
loadrt mux2 names=chip-reach
addf tool-x servo-thread
addf tool-y servo-thread
addf tool-z servo-thread
addf ball-distance servo-thread
addf ball-touch servo-thread
addf touches servo-thread
addf chip-touch servo-thread
addf chip-side servo-thread
addf chip servo-thread
addf chip-reach servo-thread
net J0 => tool-x.in0
net J1 => tool-y.in0
net J2 => tool-z.in0
newsig error-x float
newsig error-y float
newsig error-z float
newsig reach float
net error-x => tool-x.in1
net error-y => tool-y.in1
net error-z => tool-z.in1
setp tool-x.offset {X}
setp tool-y.offset {Y}
setp tool-z.offset {Z}
net off-x tool-x.out => ball-distance.in0
net off-y tool-y.out => ball-distance.in1 chip-side.in1
net off-z tool-z.out => ball-distance.in2
net distance ball-distance.out => ball-touch.in0
net reach => chip-reach.in0
net reach-now chip-reach.out => ball-touch.in1
setp chip-side.in0 5
setp touches.wrap 1
setp touches.max {last}
net touches touches.count => chip-touch.sel
net touch-0 chip-touch.out0 => chip.in-0
net touch-1 chip-touch.out1 => chip.in-1
net touch-2 chip-touch.out2 => chip.in-2
net touch-3 chip-touch.out3 => chip.in-3
net side chip-side.out => chip.in-4
net chip chip.out => chip-reach.sel
setp chip-reach.in1 {chip}
setp ball-touch.hyst 0
net probe ball-touch.out => motion.probe-input touches.countup
sets reach {reach}
"""


class LinuxcncWithProbe(LinuxcncSimulation):
    """LinuxCNC that probes; `files` are programs that it may call."""

    def __init__(self, folder: Path, files: Mapping[str, str], **section: float) -> None:
        super().__init__(folder, **section)
        self._programs = files

    def error(self, **micrometres: float) -> None:
        """Move the tool against the workpiece, by axis [um]."""
        for axis, value in micrometres.items():
            self.halcmd('sets', f'error-{axis.lower()}', f'{1e-3 * value:.9f}')

    def reach(self, value: float = (DIAMETER + TIP) / 2.0) -> None:
        """Let the probe touch at a distance from the centre [mm]."""
        self.halcmd('sets', 'reach', f'{value:.9f}')

    def chips(self, *touches: int, positive: bool | None = None) -> None:
        """Let a chip lie below each of these touches of a side, and fall off at the touch.

        Parameters
        ----------
        *touches : int
            0 is the fast one.
        positive : bool, optional
            Only on the side of positive Y, or only on the others.
        """
        sides = (False, True) if positive is None else (positive,)
        inputs = [(1 << touch) + (side << ON_A_SIDE) for touch in touches for side in sides]
        self.halcmd('setp', 'chip.function', str(sum(1 << number for number in inputs)))
        for value in '10':
            self.halcmd('setp', 'touches.reset', value)

    def mdi(self, code: str) -> Any:
        """Execute a line, and wait for its end."""
        return self.line(code)

    def _write_files(self) -> None:
        super()._write_files()
        ini = self._folder / 'test.ini'
        text = ini.read_text()
        text = text.replace(
            'HALFILE = fuzzycnc.hal', 'HALFILE = fuzzycnc.hal\nHALFILE = probe.hal'
        )
        text = text.replace('HALFILE = probe.hal', 'HALFILE = probe.hal\nHALFILE = results.hal')
        text = text.replace('[RS274NGC]', '[RS274NGC]\nSUBROUTINE_PATH = .')
        ini.write_text(text)
        moved = {axis: -value for axis, value in CENTRE.items()}
        reach = (DIAMETER + TIP) / 2.0
        hal = HAL.format(**moved, reach=reach, chip=reach + CHIP, last=ON_A_SIDE - 1)
        (self._folder / 'probe.hal').write_text(hal)
        shipped = Path(__file__).parents[3] / 'linuxcnc' / 'fuzzycnc_probe.hal'
        (self._folder / 'results.hal').write_text(shipped.read_text())
        for name, text in self._programs.items():
            (self._folder / name).write_text(text)

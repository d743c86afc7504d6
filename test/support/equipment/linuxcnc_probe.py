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

HAL = """
loadrt sum2 names=tool-x,tool-y,tool-z
loadrt hypot names=ball-distance
loadrt comp names=ball-touch
addf tool-x servo-thread
addf tool-y servo-thread
addf tool-z servo-thread
addf ball-distance servo-thread
addf ball-touch servo-thread
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
net off-y tool-y.out => ball-distance.in1
net off-z tool-z.out => ball-distance.in2
net distance ball-distance.out => ball-touch.in0
net reach => ball-touch.in1
setp ball-touch.hyst 0
net probe ball-touch.out => motion.probe-input
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
        hal = HAL.format(**moved, reach=(DIAMETER + TIP) / 2.0)
        (self._folder / 'probe.hal').write_text(hal)
        shipped = Path(__file__).parents[3] / 'linuxcnc' / 'fuzzycnc_probe.hal'
        (self._folder / 'results.hal').write_text(shipped.read_text())
        for name, text in self._programs.items():
            (self._folder / name).write_text(text)

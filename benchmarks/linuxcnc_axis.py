# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Exported controllers against LinuxCNC's `pid` with feedforward, in LinuxCNC's servo thread.

On the axes X of the ball screw and the lathe all are tuned in Python with the same number of
trials on the same cost and cases; what `pid` does there is repeated by `HalPid`, which is compared
with what the component did on LinuxCNC.  Then all move side by side in one LinuxCNC, each with a
simulated axis of its own, on the cases that nothing was tuned on: ways, gains, frictions, steps
and pulses of load.  Errors are those of the slide against the command that LinuxCNC's following
error refers to.  At last the same program runs for some minutes, and the thread's times are
recorded in every period.

The law that is written is the winner of `servo tune`.  Fails if its errors or settling times are
above those of `pid` in the geometric mean, one of them by more than 10 %, if it has overruns that
`pid` does not have, or if `HalPid` differs from `pid`.  Run with
`python benchmarks/linuxcnc_axis.py [--json FILE] [--minutes MINUTES]`, as a user who may start
LinuxCNC; searches that FILE has are not made again.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import Any

# One thread each, set before numpy starts its pool: the searches share the processors.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import numpy as np
from scipy.stats import qmc

sys.path.insert(0, str(Path(__file__).parents[1]))

from fuzzycnc_ros.adapters.linuxcnc.axis_loop import PLANT, AxisLoop, LoopController, axis_loop
from fuzzycnc_ros.adapters.linuxcnc.simulation import Limits
from fuzzycnc_ros.cli.console import progress_bar
from fuzzycnc_ros.cli.workers import Progress, in_workers
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.machine_data import AxisData, axis_hash
from fuzzycnc_ros.core.servo.axis import velocity_lag
from fuzzycnc_ros.core.servo.axis_control import (
    AXIS_CONTROLLERS,
    SETTINGS,
    make_axis_controller,
    setting_ranges,
)
from fuzzycnc_ros.core.servo.params import default_crossover
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.simulation.servo.axis_tuning import (
    AxisCase,
    AxisFigures,
    AxisTuning,
    TunedController,
    axis_cases,
    cases_cost,
    evolved,
    tune_controller,
)
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.servo.axis_tuning_tables import LABELS
from fuzzycnc_ros.studies.servo.c_export import hal_controller
from fuzzycnc_ros.studies.servo.c_text import ExportOrigin
from fuzzycnc_ros.studies.servo.plant_export import hal_plant

MACHINES = ('ballscrew', 'lathe')
AXIS = 'X'
PID = 'pid of LinuxCNC'
UNIT = 1e-3
"""Unit of LinuxCNC [m]."""
GENERATIONS, CANDIDATES = 5, 9
"""Of every search: generations after the first, and settings in each."""
REST, JUDGED = 0.3, 0.1
"""Rest before and after every way, and the end of it that is judged as rest [s]."""
PULSE = 0.13
"""Time for which a pulse of load acts, and for which it then does not [s]."""
CLOSE = 2e-6
"""Distance from the target from which on a move has settled [m]."""
QUIET = 0.3
"""Noise of a sensor of which none is known [counts]: without any, no real one is."""
WORSE = 1.1
"""Ratio of two figures that is allowed for one."""
HEADINGS = {'rms': 'rms [um]', 'largest': 'max [um]', 'rest': 'at rest [um]', 'settle': 'settles'}

HAL = f"""
loadrt siggen num_chan=1
loadrt sum2 names=loads
addf siggen.0.update servo-thread
addf loads servo-thread
setp siggen.0.frequency {0.5 / PULSE:.9g}
net pulse motion.analog-out-01 => siggen.0.amplitude siggen.0.offset
net pulses siggen.0.square => loads.in1
net step motion.analog-out-00 => loads.in0
net load loads.out
net case motion.analog-out-02
net last-period motion.servo.last-period
net thread-time servo-thread.time
""".splitlines()


class HalPid:
    """LinuxCNC's component `pid`, as its manual page describes it.

    Parameters
    ----------
    period : float
        Of the thread [s].
    **pins
        Values of its pins by name, `-` as `_`; those left out are 0.
    """

    def __init__(self, period: float, **pins: float) -> None:
        self._period = period
        names = ('Pgain', 'Igain', 'Dgain', 'FF0', 'FF1', 'FF2', 'FF3', 'bias', 'deadband')
        limits = ('maxerror', 'maxerrorI', 'maxerrorD', 'maxcmdD', 'maxcmdDD', 'maxcmdDDD')
        given = {**dict.fromkeys((*names, *limits, 'maxoutput'), 0.0), **pins}
        self._pins = SimpleNamespace(**given)
        self.command = self._integral = self._speed = self._rise = self._feedback = 0.0
        self._end = 0

    def compute(
        self, enable: bool, command: float, feedback: float, command_deriv: float
    ) -> float:
        """Return the output of a period; the error is that against the command before."""
        pins, per_period = self._pins, 1.0 / self._period
        error = _limited(self.command - feedback, pins.maxerror)
        band = pins.deadband
        error = error - band if error > band else error + band if error < -band else 0.0
        if not enable:
            self._integral = 0.0
        elif error * self._end <= 0.0:  # an output at its end winds nothing up
            self._integral += error * self._period
        self._integral = _limited(self._integral, pins.maxerrorI)
        rate = command_deriv - (feedback - self._feedback) * per_period
        rate = _limited(rate, pins.maxerrorD)
        speed = _limited(command_deriv, pins.maxcmdD)
        rise = _limited((speed - self._speed) * per_period, pins.maxcmdDD)
        jerk = _limited((rise - self._rise) * per_period, pins.maxcmdDDD)
        self._speed, self._rise, self.command, self._feedback = speed, rise, command, feedback
        if not enable:
            self._end = 0
            return 0.0
        output = (
            pins.bias + pins.Pgain * error + pins.Igain * self._integral + pins.Dgain * rate
        ) + (command * pins.FF0 + speed * pins.FF1 + rise * pins.FF2 + jerk * pins.FF3)
        cut = _limited(output, pins.maxoutput)
        self._end = 0 if cut == output else 1 if cut > 0.0 else -1
        return cut


def _limited(value: float, most: float) -> float:
    return min(max(value, -most), most) if most else value


class PidDriver:
    """`pid` on the axis of a machine file, as the controllers in Python are called.

    In the search their watch judges it too: else a loop that swings without end would cost it no
    more than the error, and the others the case.

    Parameters
    ----------
    data : AxisData
        The axis.
    settings : mapping of str to float
        Of `pid_ranges`.
    """

    taken_back = False

    def __init__(self, data: AxisData, settings: Mapping[str, float]) -> None:
        self._period, self._pins = data.known_plant().period, pid_pins(data, settings)
        self.watch = make_axis_controller(data, 'pid').watch
        self._duty = 0.0

    def reset(self, position: float) -> None:
        """Begin at rest at a position [m]."""
        self.watch.reset(position)
        self._duty = 0.0
        self._pid = HalPid(self._period, **self._pins)
        self._pid.compute(False, position / UNIT, position / UNIT, 0.0)

    def step(self, reference: float, position: float, velocity: float, rise: float) -> float:
        """Return the duty [-] of a period; reference and its derivatives in SI, for now."""
        if not self.watch.accepts(reference, position):
            return self._duty
        if self.watch.swing.grows:
            self.watch.give_up_unstable()
        self._pid.command = reference / UNIT
        ahead = velocity + rise * self._period
        command = reference + 0.5 * (velocity + ahead) * self._period
        self._duty = self._pid.compute(True, command / UNIT, position / UNIT, ahead / UNIT)
        self.watch.applied(self._duty)
        return self._duty


def pid_ranges(data: AxisData) -> dict[str, tuple[float, float, float]]:
    """Return lowest, highest and first value of what is searched of `pid`.

    Those of the other laws, `late`, the age of a reading that feedforward makes up for [s], and
    `deadband` [counts].
    """
    late = getattr(data.known_plant(), 'sensor_lag', 0.0)
    return {
        **setting_ranges(data, 'pid', SETTINGS),
        'late': (0.1 * late, 1.5 * late, late) if late else (1e-6, 1e-3, 1e-6),
        'deadband': (0.05, 4.0, 1.0),
    }


def pid_pins(data: AxisData, settings: Mapping[str, float]) -> dict[str, float]:
    """Return the pins of `pid` that settings stand for, in units of LinuxCNC."""
    plant = data.known_plant()
    axis = plant.linear()
    bandwidth = settings['bandwidth'] * default_crossover(axis)
    lag = velocity_lag(axis)
    damping = max(settings['damping'], 1.05 * 0.5 / (bandwidth * lag))
    proportional = bandwidth * bandwidth * lag / axis.gain
    derivative = (2.0 * damping * bandwidth * lag - 1.0) / axis.gain
    pins = {
        'Pgain': proportional,
        'Igain': proportional * settings['estimator'] * bandwidth / 3.0,
        'Dgain': derivative,
        'FF1': 1.0 / axis.gain - proportional * settings['late'],
        'FF2': axis.lag / axis.gain - derivative * settings['late'],
    }
    return {
        **{name: UNIT * value for name, value in pins.items()},
        'deadband': settings['deadband'] * plant.count / UNIT,
        'maxoutput': plant.duty_max,
    }


def tune_pid(data: AxisData, progress: Any) -> dict[str, Any]:
    """Tune `pid` as `servo tune` does its laws; return settings, costs and trials."""
    ranges, cases = pid_ranges(data), axis_cases(data)
    low, high, first = np.log(np.array(list(ranges.values()))).T
    draw = qmc.LatinHypercube(len(ranges), seed=np.random.default_rng(0))
    points = low + (high - low) * draw.random(CANDIDATES)
    points[0] = np.clip(first, low, high)
    tried = 0

    def driver(point: Array) -> PidDriver:
        values = dict(zip(ranges, np.exp(point).tolist(), strict=True))
        return PidDriver(data, values)

    def cost(point: Array) -> float:
        nonlocal tried
        tried += 1
        return cases_cost(data, driver(point), cases)  # type: ignore[arg-type]

    found = evolved(cost, ranges, GENERATIONS, 0, progress, init=points)
    judged: Any = driver(found.x)
    return {
        'settings': dict(zip(ranges, np.exp(found.x).tolist(), strict=True)),
        'cost': float(found.fun),
        'held_out_cost': cases_cost(data, judged, axis_cases(data, held_out=True)),
        'trials': tried,
    }


def search(piece: tuple[str, str], progress: Progress) -> dict[str, Any]:
    """Tune one law on the axis of one machine."""
    machine, law = piece
    data = axis_of(machine)

    def told(done: int, total: int) -> None:
        progress('searching', f'{machine} {law}', done, total)

    if law == PID:
        return tune_pid(data, told)
    found = tune_controller(
        data,
        law,
        generations=GENERATIONS,
        population=CANDIDATES // len(SETTINGS),
        progress=told,
    )
    return asdict(replace(found, margin=None))


def axis_of(machine: str) -> AxisData:
    """Return the axis of a built-in machine, its sensor with a noise."""
    data = read_machine_file(machine).axes[AXIS]
    plant = data.known_plant()
    return replace(data, plant=replace(plant, noise=max(plant.noise, QUIET * plant.count)))


def winner_of(found: Mapping[str, Mapping[str, Any]], data: AxisData) -> str:
    """Return the law that `servo tune` writes."""
    controllers = [
        TunedController(
            **{
                **found[law],
                'held_out': tuple(AxisFigures(**one) for one in found[law]['held_out']),
            }
        )
        for law in AXIS_CONTROLLERS
    ]
    return AxisTuning(tuple(controllers), axis_cases(data, held_out=True)).winner.name


# ---- On LinuxCNC --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drive:
    """A case on LinuxCNC: figures by law, by `HEADINGS` [m], settling times [s]."""

    case: AxisCase
    figures: Mapping[str, Mapping[str, float]]


def component_of(law: str) -> str:
    """Return the name of the component of an exported law."""
    return f'fuzzycnc_loop_{law}'


def controllers_of(
    machine: str, data: AxisData, found: Mapping[str, Mapping[str, Any]]
) -> dict[str, LoopController]:
    """Return the controllers of all joints by law, `pid` last."""
    file_hash = axis_hash(AXIS, data)
    made = {
        law: LoopController(
            component_of(law),
            hal_controller(
                make_axis_controller(data, law, found[law]['settings']),
                ExportOrigin(component_of(law), law, machine, file_hash),
            ),
            {'machine-file': f'0x{file_hash[:8]}'},
        )
        for law in AXIS_CONTROLLERS
    }
    pins = pid_pins(data, found[PID]['settings'])
    made[PID] = LoopController('pid', settings={name: f'{pins[name]:.17g}' for name in pins})
    return made


def program(case: AxisCase, number: int, velocity: float) -> str:
    """Return a part program of a case: there, a step of load, and back."""
    lines = [
        'G21 G90 G94 G61',
        f'M68 E1 Q{0.5 * case.pulse:.9f}',
        f'M68 E2 Q{number}',
        f'G4 P{REST}',
        f'G1 X{case.way / UNIT:.6f} F{60.0 * velocity * case.pace / UNIT:.6f}',
        f'G4 P{REST}',
        f'M68 E0 Q{case.load:.9f}',
        f'G4 P{REST}',
        'G1 X0',
        f'G4 P{REST}',
        *('M68 E2 Q0', 'M68 E0 Q0', 'M68 E1 Q0'),
        f'G4 P{REST}',
        'M2',
    ]
    return '\n'.join([*lines, ''])


def set_case(loop: AxisLoop, case: AxisCase, joints: int) -> None:
    """Change the axes to those of a case; they rest."""
    for joint in range(joints):
        loop.halcmd('setp', f'plant-{joint}.gain_factor', f'{case.gain:.9g}')
        loop.halcmd('setp', f'plant-{joint}.friction_factor', f'{case.friction:.9g}')


def looped(
    machine: str,
    data: AxisData,
    controllers: Mapping[str, LoopController],
    record: Sequence[str],
    further: Mapping[str, str],
) -> Any:
    """Return a LinuxCNC with all axes."""
    velocity, acceleration, _ = data.limits.positioning
    limits = data.limits
    allowed = Limits(
        *(one / UNIT for one in (velocity, acceleration, limits.travel_low, limits.travel_high))
    )
    plant = hal_plant(
        data.known_plant(), ExportOrigin(PLANT, 'axis', machine, axis_hash(AXIS, data))
    )
    noise = data.known_plant().noise
    return axis_loop(
        list(controllers.values()), plant, allowed, record, noise, lines=HAL, further=further
    )


def drive(
    machine: str,
    data: AxisData,
    controllers: dict[str, LoopController],
    cases: Sequence[AxisCase],
) -> tuple[dict[str, Array], dict[str, str]]:
    """Drive all cases side by side.

    A law that gives up switches the machine off: the others drive anew without it.

    Returns
    -------
    samples : dict of str to ndarray
        Of the laws that are left in `controllers`.
    given_up : dict of str to str
        When and why, by law.
    """
    given_up: dict[str, str] = {}
    record = ('feedback', 'output', 'position')
    while True:
        with looped(machine, data, controllers, record, {'case': 'f'}) as loop:
            loop.ready()
            lost: dict[str, str] = {}
            for number, case in enumerate(cases, 1):
                set_case(loop, case, len(controllers))
                loop.run_program(program(case, number, data.limits.positioning[0]))
                lost = faults(loop, controllers)
                if lost:
                    given_up |= {law: f'case {number}: {why}' for law, why in lost.items()}
                    break
            else:
                found: dict[str, Array] = loop.samples()
                return found, given_up
        for law in lost:
            del controllers[law]


def faults(loop: AxisLoop, controllers: Mapping[str, LoopController]) -> dict[str, str]:
    """Return the laws that have given up, with their fault."""
    found = {}
    for law, one in controllers.items():
        if one.source:
            pin = f'{one.name.replace("_", "-")}.fault-code'
            code = loop.halcmd('getp', pin).split()[-1]
            if code != '0':
                found[law] = f'fault {code}'
    return found


def judged(
    samples: Mapping[str, Array], cases: Sequence[AxisCase], laws: Sequence[str], period: float
) -> Iterator[Drive]:
    """Return the figures of all laws in each case."""
    late = round(JUDGED / period)
    for number, case in enumerate(cases, 1):
        rows = np.flatnonzero(samples['case'] == number)
        command = UNIT * samples['command'][rows - 1]
        moves = np.flatnonzero(np.diff(samples['command'][rows - 1]))
        turn = np.flatnonzero(np.diff(moves) > 0.5 * REST / period)
        arrivals = (moves[turn[0]] + 1, moves[-1] + 1)
        leaving = moves[turn[0] + 1]
        ends = (arrivals[0] + round(REST / period), len(rows))
        figures = {}
        for joint, law in enumerate(laws):
            error = np.abs(command - UNIT * samples[f'position-{joint}'][rows])
            rest = np.concatenate([error[leaving - late : leaving], error[-late:]])
            settle = [
                period * (1 + np.flatnonzero(np.r_[True, error[begin:end] > CLOSE])[-1])
                for begin, end in zip(arrivals, ends, strict=True)
            ]
            figures[law] = {
                'rms': float(np.sqrt((error**2).mean())),
                'largest': float(error.max()),
                'rest': float(np.sqrt((rest**2).mean())),
                'settle': float(np.mean(settle)),
            }
        yield Drive(case, figures)


def pid_difference(samples: Mapping[str, Array], joint: int, pins: Mapping[str, float]) -> float:
    """Return the largest difference between `pid` on LinuxCNC and `HalPid` [-]."""
    model, most = HalPid(1000000 * 1e-9, **pins), 0.0
    columns = ('enable', 'command', f'feedback-{joint}', 'command-deriv', f'output-{joint}')
    rows = np.column_stack([samples[name] for name in columns]).tolist()
    for number, (enable, command, feedback, speed, output) in enumerate(rows):
        found = model.compute(enable > 0.0, command, feedback, speed)
        if number > 2:  # what was before the first sample is not known
            most = max(most, abs(found - output))
    return most


def times(
    machine: str,
    data: AxisData,
    controllers: Mapping[str, LoopController],
    cases: Sequence[AxisCase],
    minutes: float,
) -> dict[str, Array]:
    """Run the cases for some minutes; return the times of every period [us]."""
    further = {'last-period': 'u', 'thread-time': 's'}
    with looped(machine, data, controllers, ('time',), further) as loop:
        loop.ready()
        end = monotonic() + 60.0 * minutes
        while monotonic() < end:
            for number, case in enumerate(cases, 1):
                set_case(loop, case, len(controllers))
                loop.run_program(program(case, number, data.limits.positioning[0]))
        samples: dict[str, Array] = loop.samples()
    clock = float(np.median(samples['last-period'])) / 1000.0  # per microsecond
    enabled = samples['enable'][:-1] > 0.0
    # What the thread took is known when the period is over.
    found = {'thread': samples['thread-time'][1:][enabled] / clock}
    for joint, law in enumerate(controllers):
        found[law] = samples[f'time-{joint}'][:-1][enabled] / clock
    return found


def overruns(found: Mapping[str, Array], law: str) -> int:
    """Return the periods that ended too late and with `pid` in the place of a law would not."""
    whole = found['thread']
    return int(((whole > 1000.0) & (whole - found[law] + found[PID] <= 1000.0)).sum())


def ratios(drives: Sequence[Drive], law: str, name: str) -> Array:
    """Return a figure of a law over that of `pid` in each case [-]."""
    least = 1e-3 if name == 'settle' else 1e-9
    return np.array(
        [max(one.figures[law][name], least) / max(one.figures[PID][name], least) for one in drives]
    )


def mean(values: Any) -> float:
    """Return the geometric mean."""
    return float(np.exp(np.mean(np.log(values))))


def table(
    machine: str,
    drives: Sequence[Drive],
    laws: Sequence[str],
    best: str,
    timed: Mapping[str, Array],
) -> Table:
    """Return the figures of all laws on a machine."""
    columns = [Column('Law', numeric=False)]
    columns += [Column(heading) for heading in HEADINGS.values()]
    columns += [Column('error over that of pid'), Column('settling'), Column('worst figure')]
    columns += [
        Column('median', 'us a period'),
        Column('99.9 %', 'us a period'),
        Column('overruns'),
    ]
    rows = []
    for law in laws:
        scale = {'settle': 1e3}
        row = [f'{LABELS.get(law, law)}{" *" if law == best else ""}']
        for name in HEADINGS:
            values = [max(one.figures[law][name], 1e-9) for one in drives]
            row.append(f'{mean(values) * scale.get(name, 1e6):.3g}')
        errors = [ratios(drives, law, name) for name in ('rms', 'largest', 'rest')]
        settling = ratios(drives, law, 'settle')
        row += [f'{mean(np.concatenate(errors)):.2f}', f'{mean(settling):.2f}']
        row.append(f'{max(map(np.max, (*errors, settling))):.2f}')
        row += [f'{np.median(timed[law]):.2f}', f'{np.percentile(timed[law], 99.9):.2f}']
        row.append(str(overruns(timed, law)))
        rows.append(tuple(row))
    return Table(f'{machine}, {len(drives)} cases', tuple(columns), tuple(rows))


def main() -> None:
    """Tune, drive, time, and print a table for each machine."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else '')
    parser.add_argument('--json', type=Path)
    parser.add_argument('--minutes', type=float, default=5.0, help='of each machine')
    parser.add_argument('--jobs', type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    laws = (*AXIS_CONTROLLERS, PID)
    known: dict[str, Any] = {}
    if given.json and given.json.exists():
        known = json.loads(given.json.read_text())
    for machine in MACHINES:
        pieces = [(machine, law) for law in laws if f'{machine} {law}' not in known]
        if not pieces:
            continue
        names = [' '.join(piece) for piece in pieces]
        with progress_bar('searching') as tell:
            found = in_workers(search, pieces, names, given.jobs, tell)
        known |= dict(zip(names, found, strict=True))
        if given.json:
            given.json.write_text(json.dumps(known, indent=1) + '\n')
    failures = []
    for machine in MACHINES:
        data = axis_of(machine)
        tuned = {law: known[f'{machine} {law}'] for law in laws}
        best = winner_of(tuned, data)
        cases = axis_cases(data, held_out=True)
        controllers = controllers_of(machine, data, tuned)
        samples, given_up = drive(machine, data, controllers, cases)
        left = tuple(controllers)
        drives = list(judged(samples, cases, left, data.known_plant().period))
        pins = {name: float(text) for name, text in controllers[PID].settings.items()}
        differs = pid_difference(samples, len(left) - 1, pins)
        timed = times(machine, data, controllers, cases, given.minutes)
        print(table(machine, drives, left, best, timed).to_text())
        for law, why in given_up.items():
            print(f'{law} gave up in {why}')
        if best in given_up:
            failures.append(f'{machine}: {best} gave up')
            continue
        trials = ', '.join(str(tuned[law]['trials']) for law in laws)
        print(f'* what `servo tune` writes; trials {trials}')
        print(
            f'pid in Python and on LinuxCNC differ by at most {differs:.2g} of the duty in '
            f'{len(samples["command"])} periods; thread {np.median(timed["thread"]):.1f} us, '
            f'{len(timed["thread"])} periods, {int((timed["thread"] > 1000.0).sum())} too long\n'
        )
        figures = {name: ratios(drives, best, name) for name in HEADINGS}
        errors = np.concatenate([figures[name] for name in ('rms', 'largest', 'rest')])
        if mean(errors) > 1.0 or mean(figures['settle']) > 1.0:
            failures.append(f'{machine}: {best} is worse than pid')
        if max(one.max() for one in figures.values()) > WORSE:
            failures.append(f'{machine}: {best} is worse than pid in a case')
        if overruns(timed, best):
            failures.append(f'{machine}: {best} has overruns that pid does not have')
        if differs > 1e-12:
            failures.append(f'{machine}: pid differs from its model')
    if failures:
        sys.exit('\n'.join(failures))


if __name__ == '__main__':
    main()

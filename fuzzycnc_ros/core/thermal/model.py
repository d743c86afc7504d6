# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A trained thermal model: inputs, fitted candidates, domain and uncertainty."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import ModelFileError, text_hash
from fuzzycnc_ros.core.thermal.band import Band
from fuzzycnc_ros.core.thermal.candidate import SPEED_SUFFIX, UNCOMPENSATED, Candidate
from fuzzycnc_ros.core.thermal.cold_start import ColdStart
from fuzzycnc_ros.core.thermal.domain import Domain
from fuzzycnc_ros.core.thermal.drivers import (
    SPINDLE_SPEED,
    drive_of,
    driven_speed,
    speed_drive,
    speed_known,
)
from fuzzycnc_ros.core.thermal.fingerprint import Fingerprint
from fuzzycnc_ros.core.thermal.model_document import SIZE_MAX, read_document, write_document
from fuzzycnc_ros.core.thermal.recursions import (
    BoundedRecursion,
    Recursion,
    Stream,
    check_interval,
    combine,
)
from fuzzycnc_ros.core.thermal.run import JITTER_MAX, ThermalRun
from fuzzycnc_ros.core.thermal.sensor_watch import SensorSelection, SensorWatchModel

REFERENCE_RULE = 'mean of the first three samples'
"""What rises are meant against, unless a thermal reference says otherwise."""


class ModelMismatchError(ValueError):
    """A model does not fit the stream or run that it is to be used on."""


@dataclass(frozen=True, eq=False)
class ThermalModel:
    """Everything that a predictor needs, as it is written to a model file.

    Parameters
    ----------
    inputs : tuple of str, length p
        Sensors in the order of the rises.
    interval : float
        Sampling interval that the recursions belong to [s].
    channel, axis : tuple of str, length c
        Displacement channels and the ISO 841 axis of each.
    runs : tuple of str
        Runs that it was trained on.
    candidates : mapping of str to Candidate
        All fitted candidates, so that an evaluation can show them side by side.
    default : tuple of str, length c
        Candidate that each channel uses.
    selection : SensorSelection
        How the inputs were chosen, with their substitutes and gains.
    domain : Domain
        Rises that it was trained on.
    band : Band
        How far the default may be off, from samples that neither fit nor choice had seen.
    drivers : tuple of str, length d
        What the candidates may read behind the rises: the driver of the spindle speed, or
        nothing where it was not recorded.
    bound : ndarray, shape (c,), optional
        Largest absolute error that the default may predict [m]; absent in old files, where it
        has no bound.
    omitted : mapping of str to str
        Candidates that could not be fitted, and why.
    reference : str
        Rule by which the reference of the rises was found.
    watch : SensorWatchModel, optional
        How the sensors follow each other, to find faulty ones and to stand in for them; files
        of earlier versions have none.
    cold_start : ColdStart, optional
        How the inputs differ before the machine is used; files of earlier versions have none.
    fingerprints : tuple of Fingerprint
        What it was trained on, to recognise it; files of earlier versions have none.
    """

    inputs: tuple[str, ...]
    interval: float
    channel: tuple[str, ...]
    axis: tuple[str, ...]
    runs: tuple[str, ...]
    candidates: Mapping[str, Candidate]
    default: tuple[str, ...]
    selection: SensorSelection
    domain: Domain
    band: Band
    drivers: tuple[str, ...] = ()
    bound: Array | None = None
    omitted: Mapping[str, str] = field(default_factory=dict)
    reference: str = REFERENCE_RULE
    watch: SensorWatchModel | None = None
    cold_start: ColdStart | None = None
    fingerprints: tuple[Fingerprint, ...] = ()
    _default_recursion: Recursion = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check that the parts belong together and assemble the default's recursion.

        Raises
        ------
        ValueError
            If a part contradicts another; the message names it.
        """
        check_interval(self.interval)
        check_parts(self)
        names = set(self.default)
        if len(names) == 1:
            recursion = self.candidates[names.pop()].recursion
        else:
            recursion = combine(
                [
                    self.candidates[name].recursion.channel(channel)
                    for channel, name in enumerate(self.default)
                ]
            )
        if self.bound is not None:
            recursion = BoundedRecursion(recursion, self.bound)
        object.__setattr__(self, '_default_recursion', recursion)

    def to_json(self) -> str:
        """Return the model as a JSON document; equal models give equal text."""
        return write_document(self)

    @staticmethod
    def from_json(text: str) -> 'ThermalModel':
        """Return the model of a document that `to_json` returned.

        Raises
        ------
        ModelFileError
            If it is no usable model; the message says where and why.
        """
        fields = read_document(text)
        try:
            model = ThermalModel(**fields)
            check_output(model)
        except ValueError as error:
            raise ModelFileError(f'model file: {error}') from error
        return model

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the model file's text, 64 hexadecimal digits."""
        return text_hash(self.to_json())

    @property
    def held_out_rms(self) -> Array:
        """Root mean square that the default left on held-out samples, (c,) [m]."""
        return np.array(
            [
                self.candidates[used].held_out_rms[number]
                for number, used in enumerate(self.default)
            ]
        )

    @property
    def uncompensated(self) -> tuple[str, ...]:
        """Channels that the default leaves as they are: no model improved them beyond chance."""
        pairs = zip(self.channel, self.default, strict=True)
        return tuple(name for name, used in pairs if used == UNCOMPENSATED)

    @property
    def losing(self) -> dict[str, tuple[float, float]]:
        """Channels that are worse with the default than without, on held-out samples.

        Their residual with it and without [m].  Only a model that was named for all channels
        can be so; files of earlier versions cannot tell.
        """
        bare = self.candidates.get(UNCOMPENSATED)
        if bare is None:
            return {}
        found = {}
        for number, (name, used) in enumerate(zip(self.channel, self.default, strict=True)):
            left = float(self.candidates[used].held_out_rms[number])
            none = float(bare.held_out_rms[number])
            if used != UNCOMPENSATED and left >= none:
                found[name] = (left, none)
        return found

    def warmth(self, reference: ArrayLike) -> dict[str, float]:
        """Return the inputs that are warmer than at a cold start, by how much [K].

        Parameters
        ----------
        reference : array_like, shape (p,)
            Temperature of each input at the start of a run [degC].
        """
        if self.cold_start is None:
            return {}
        warmth = self.cold_start.warmth(reference)
        pairs = zip(self.inputs, warmth.tolist(), strict=True)
        return {name: kelvin for name, kelvin in pairs if kelvin}

    @property
    def needs_speed(self) -> bool:
        """Whether the default reads the spindle speed."""
        return any(name.endswith(SPEED_SUFFIX) for name in self.default)

    @property
    def speed_max(self) -> float:
        """Largest spindle speed that it was trained on [rad/s]; infinite if it reads none."""
        if not self.needs_speed or not len(self.domain.drive):
            return np.inf
        return float(driven_speed(self.domain.drive.max()))

    def drive(self, spindle_speed: float, candidate: str | None = None) -> Array:
        """Return what stands behind the rises in a sample, shape (d,) [-].

        Parameters
        ----------
        spindle_speed : float
            Spindle speed [rad/s]; not looked at unless it is needed.
        candidate : str, optional
            Candidate that is stepped; the default if absent.
        """
        needed = self.needs_speed if candidate is None else candidate.endswith(SPEED_SUFFIX)
        if not needed:
            return np.zeros(len(self.drivers))
        return np.full(len(self.drivers), speed_drive(np.array(spindle_speed)))

    def drives(self, run: ThermalRun) -> Array:
        """Return what stands behind the rises of a run, shape (n, d) [-]; zeros if unknown."""
        if not speed_known(run):
            return np.zeros((len(run.time), len(self.drivers)))
        return drive_of(run, self.drivers)

    def candidates_on(self, run: ThermalRun) -> tuple[str, ...]:
        """Return the candidates that find all they read in a run."""
        return tuple(
            name for name in self.candidates if not name.endswith(SPEED_SUFFIX) or speed_known(run)
        )

    def check_stream(self, sensors: Sequence[str], interval: float) -> None:
        """Refuse a stream that the model was not made for.

        Parameters
        ----------
        sensors : sequence of str
            Sensors that the stream carries, in any order.
        interval : float
            Its sampling interval [s].

        Raises
        ------
        ModelMismatchError
            If inputs are missing or the interval differs by more than 10 %; the message spells
            out the difference.
        """
        missing = [name for name in self.inputs if name not in sensors]
        if missing:
            raise ModelMismatchError(
                f'sensors: expected the inputs {", ".join(self.inputs)} of the model, but found '
                f'no {", ".join(missing)}; the stream has {", ".join(sensors)}'
            )
        if not abs(interval - self.interval) <= JITTER_MAX * self.interval:
            raise ModelMismatchError(
                f'interval: expected {self.interval:g} s as the model was trained with, but '
                f'found {interval:g} s; average the stream, or convert the model with '
                'with_interval'
            )

    def recursion(self, candidate: str | None = None) -> Recursion:
        """Return the recursion of a candidate, or of the default.

        Raises
        ------
        ValueError
            If the model holds no such candidate.
        """
        if candidate is None:
            return self._default_recursion
        if candidate not in self.candidates:
            why = self.omitted.get(candidate)
            raise ValueError(
                f'candidate: expected one of {", ".join(self.candidates)}, but found '
                f'{candidate!r}' + (f', which was left out: {why}' if why else '')
            )
        return self.candidates[candidate].recursion

    def start(self, candidate: str | None = None) -> Stream:
        """Begin a run, sample by sample.

        Parameters
        ----------
        candidate : str, optional
            Candidate to run; the default of each channel if absent.

        Returns
        -------
        Stream
            Its `step` takes the rises (p,) [K], with `drive` behind them, and returns the
            thermal errors (c,) [m]; its `state` is a flat array that a checkpoint may keep.
        """
        return Stream(self.recursion(candidate))

    def predict(self, source: ThermalRun | ArrayLike, candidate: str | None = None) -> Array:
        """Return the thermal error of a whole run.

        Parameters
        ----------
        source : ThermalRun or array_like, shape (n, p + d)
            A run that carries the inputs at the model's interval, or the rises of the inputs
            [K] and the drivers behind them, from the start of the run.
        candidate : str, optional
            Candidate to run; the default of each channel if absent.

        Returns
        -------
        ndarray, shape (n, c)
            Thermal error [m]; infinite or NaN where a candidate has diverged.

        Raises
        ------
        ModelMismatchError
            If the run lacks inputs or has another interval, or the rises have another width.
        ThermalDataError
            If the run lacks a spindle speed that the default, or the candidate, reads.
        ValueError
            If a rise is NaN: a failed sensor needs its substitute first.
        """
        recursion = self.recursion(candidate)
        if candidate is not None and candidate.endswith(SPEED_SUFFIX):
            if isinstance(source, ThermalRun):
                drive_of(source, self.drivers)  # refuses a run without the speed
        return recursion.run(self.rises(source))

    def rises(self, source: ThermalRun | ArrayLike) -> Array:
        """Return the samples of a run, shape (n, p + d), checked as `predict` says.

        Rises [K] come first, then the drivers [-]; zeros where the run does not have the spindle
        speed in every sample and the default needs none.
        """
        width = len(self.inputs) + len(self.drivers)
        if isinstance(source, ThermalRun):
            self.check_stream(source.sensor, source.interval)
            drive = drive_of(source, self.drivers) if self.needs_speed else self.drives(source)
            rise = np.hstack([source.rise()[:, source.columns(self.inputs)], drive])
        else:
            rise = np.asarray(source, dtype=np.float64)
            if rise.ndim != 2 or rise.shape[1] != width:
                raise ModelMismatchError(
                    f'rise: expected {width} columns ({", ".join(self.inputs + self.drivers)}), '
                    f'but found shape {rise.shape}'
                )
        bad = np.argwhere(~np.isfinite(rise))
        if len(bad):
            row, column = bad[0]
            raise ValueError(
                f'rise: expected finite values, but found {rise[row, column]} of input '
                f'{(self.inputs + self.drivers)[column]!r} at sample {row}; put a substitute in '
                'its place'
            )
        return rise

    def distance(self, rise: ArrayLike) -> Array:
        """Return the distance of samples (..., p + d) from the training, shape (...) [-].

        It is in units of the domain's limit: up to 1 a sample is in the domain.  A driver counts
        only where the default reads it, so that a run and a stream give the same.
        """
        samples = np.asarray(rise, dtype=np.float64)
        if not self.needs_speed:
            samples = samples[..., : len(self.inputs)]
        return self.domain.distance(samples)

    def in_domain(self, rise: ArrayLike) -> NDArray[np.bool_]:
        """Return whether samples (..., p + d) lie where the model was trained, shape (...)."""
        return np.asarray(self.distance(rise) <= 1.0)

    def standard_deviation(self, rise: ArrayLike) -> Array:
        """Return the standard deviation of the prediction at samples (..., p + d).

        Returns
        -------
        ndarray, shape (..., c)
            That of the held-out residual, wider with the distance from the training, or of the
            model itself, whichever is larger [m]; see `Band`.
        """
        samples = np.asarray(rise, dtype=np.float64)
        said = self._default_recursion.standard_deviation(samples)
        return self.band.at(self.distance(samples), said)

    def with_interval(self, interval: float) -> 'ThermalModel':
        """Return the model for another sampling interval [s], with the same time constants.

        Raises
        ------
        ValueError
            If `interval` is not positive, or the default has no meaning at another interval;
            other candidates without one are left out.
        """
        check_interval(interval)
        ratio = interval / self.interval
        candidates, omitted = {}, dict(self.omitted)
        for name, item in self.candidates.items():
            try:
                recursion = item.recursion.with_interval(ratio)
            except ValueError as error:
                if name in self.default:
                    raise ValueError(f'candidate {name!r}: {error}') from error
                omitted[name] = str(error)
            else:
                candidates[name] = replace(item, recursion=recursion)
        return replace(self, interval=interval, candidates=candidates, omitted=omitted)


def check_parts(model: 'ThermalModel') -> None:
    """Refuse parts that contradict each other.

    Raises
    ------
    ValueError
        The message names the part.
    """
    inputs, channels = len(model.inputs), len(model.channel)
    if not inputs or len(set(model.inputs)) != inputs:
        raise ValueError(f'inputs: expected each sensor once, but found {model.inputs}')
    if not channels or len(set(model.channel)) != channels:
        raise ValueError(f'channel: expected each channel once, but found {model.channel}')
    for name, found in (
        ('axis', len(model.axis)),
        ('default', len(model.default)),
        ('residual_deviation', len(model.band.deviation)),
    ):
        if found != channels:
            raise ValueError(f'{name}: expected one per channel ({channels}), but found {found}')
    if model.selection.chosen != model.inputs:
        raise ValueError(
            f'selection: expected the inputs {", ".join(model.inputs)} as chosen sensors, but '
            f'found {", ".join(model.selection.chosen)}'
        )
    if model.drivers not in ((), (SPINDLE_SPEED,)):
        raise ValueError(
            f'drivers: expected none or {SPINDLE_SPEED}, but found {", ".join(model.drivers)}'
        )
    if model.domain.drive.shape != (len(model.drivers),):
        raise ValueError(
            f'domain: expected {len(model.drivers)} drivers, but found {len(model.domain.drive)}'
        )
    if model.watch is not None and model.watch.input != model.inputs:
        raise ValueError(
            f'watch: expected the inputs {", ".join(model.inputs)}, but found '
            f'{", ".join(model.watch.input)}'
        )
    if model.cold_start is not None and model.cold_start.pattern.shape != (inputs,):
        raise ValueError(
            f'cold_start: expected {inputs} inputs, but found {model.cold_start.pattern.shape}'
        )
    if model.domain.mean.shape != (inputs,):
        raise ValueError(f'domain: expected {inputs} inputs, but found {model.domain.mean.shape}')
    for name, candidate in model.candidates.items():
        shape = (candidate.recursion.channels, candidate.recursion.inputs)
        width = inputs + len(model.drivers)
        if shape != (channels, width):
            raise ValueError(
                f'candidate {name!r}: expected {channels} channels and {width} inputs, but '
                f'found {shape[0]} and {shape[1]}'
            )
    for name in model.default:
        if name not in model.candidates:
            raise ValueError(
                f'default: expected one of {", ".join(model.candidates)}, but found {name!r}'
            )
        if model.candidates[name].problems:
            raise ValueError(
                f'default: expected a reliable candidate, but found {name!r}: '
                f'{"; ".join(model.candidates[name].problems)}'
            )


def check_output(model: 'ThermalModel') -> None:
    """Refuse numbers that are finite one by one, but of which no finite prediction follows.

    Raises
    ------
    ValueError
        If an error or a deviation amid the training is not finite.
    """
    sample = np.concatenate([model.domain.mean, model.domain.drive])
    stream = model.start()
    with np.errstate(all='ignore'):
        values = [stream.step(sample) for _ in range(3)]
        deviation = model.standard_deviation(sample)
    if not (np.isfinite(values).all() and np.isfinite(deviation).all()):
        raise ValueError(
            f'default: expected finite errors and deviations amid the training, but found '
            f'{values[-1]} and {deviation}; train the model anew'
        )


def load_model(source: str | os.PathLike[str]) -> ThermalModel:
    """Return the model of a file, or of a text that `ThermalModel.to_json` returned.

    Parameters
    ----------
    source : str or path
        Path of a model file; a text that begins with a brace is taken for the document itself.

    Raises
    ------
    ModelFileError
        If the file cannot be read or is no usable model.

    Notes
    -----
    This is the one place where the core reads a file: a model is what users load by path.
    """
    if isinstance(source, str) and source.lstrip().startswith('{'):
        return ThermalModel.from_json(source)
    path = Path(source)
    try:
        with path.open(encoding='utf-8') as file:
            text = file.read(SIZE_MAX + 1)
    except (OSError, ValueError) as error:
        raise ModelFileError(f'{path}: expected a readable model file, but: {error}') from error
    try:
        return ThermalModel.from_json(text)
    except ModelFileError as error:
        raise ModelFileError(f'{path}: {error}') from error

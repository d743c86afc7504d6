# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Progress of a training in words: the candidate, and the number of its fits."""

STAGES = {'fit': 'fitting', 'select_sensors': 'trying sensor', 'sensor_count': 'sensors:'}
"""Stage of a training, for people."""


class FitCounter:
    """Words for a training that reports after every single fit.

    The number of fits that a candidate needs is not known beforehand: it depends on folds,
    channels and settings.  So the bar counts candidates, and the words count fits.
    """

    def __init__(self) -> None:
        self._current = ('', '')
        self._fits = 0

    def __call__(self, stage: str, name: str, done: int, total: int) -> str:
        """Return what is going on, such as 'fitting mlp (5 of 8), 12 fits'."""
        if (stage, name) != self._current:
            self._current, self._fits = (stage, name), 0
        else:
            self._fits += 1
        place = f' ({min(done + 1, total)} of {total})' if stage == 'fit' else ''
        counted = f', {self._fits} fit{"s"[: self._fits > 1]}' if self._fits else ''
        return f'{STAGES.get(stage, stage)} {name}{place}{counted}'

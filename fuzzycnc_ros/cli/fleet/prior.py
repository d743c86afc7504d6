# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc fleet prior`: what machines of one kind teach of another one."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from fuzzycnc_ros.cli.console import check_folder, say, write_text


def prior(
    models: Annotated[
        list[Path],
        typer.Argument(
            metavar='MODEL...',
            help='Files of `fuzzycnc model export`, one of each machine of the kind.',
        ),
    ],
    out: Annotated[Path, typer.Option(help='Model file to write.')],
) -> None:
    """Combine what machines of one kind have learnt, for a new one to begin with.

    The file has the mean of their weights, and a band as wide as they differ. `fuzzycnc up --learn
    --model FILE` begins with it on a machine with sensors of the same names.

        fuzzycnc model export mill_1 --out 1.json
        fuzzycnc model export mill_2 --out 2.json
        fuzzycnc model export mill_3 --out 3.json
        fuzzycnc fleet prior 1.json 2.json 3.json --out kind.json
    """
    from fuzzycnc_ros.core.document import ModelFileError
    from fuzzycnc_ros.core.thermal.model import load_model
    from fuzzycnc_ros.core.thermal.prior import of_one_kind

    check_folder(out)
    loaded = [load_model(path) for path in models]
    first, priors = loaded[0], []
    for path, model in zip(models, loaded, strict=True):
        if model.prior is None or model.runs:
            raise ModelFileError(
                f'{path}: expected what one machine has learnt from nothing, but found a trained '
                'model; export it from a recording (`fuzzycnc model export`)'
            )
        if (model.inputs, model.axis) != (first.inputs, first.axis):
            raise ModelFileError(
                f'{path}: expected the sensors and axes of {models[0]}, but found others'
            )
        priors.append(model.prior)
    kind = replace(first, prior=of_one_kind(priors))
    write_text(out, kind.to_json())
    say(f'{out}: written from {len(priors)} machines, hash {kind.hash[:16]}')

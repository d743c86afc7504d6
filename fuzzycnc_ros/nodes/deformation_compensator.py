# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `deformation_compensator`: the files of model and learnt offsets.

They reach the component as requests with their whole text, which the node publishes as events:
so a bag of the run holds what its replay needs.
"""

from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from fuzzycnc_ros.components.soft.deformation_compensator import (
    DeformationCompensator,
)
from fuzzycnc_ros.core.deformation import soft_model
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.lifecycle import ManagedComponentNode
from fuzzycnc_ros.ros.parameters import ParameterError, changed, file_text, refusal
from fuzzycnc_ros.runtime.component import Answer

Request = Callable[[str, Mapping[str, Any]], Answer]

FILES = ('model', 'offsets')
"""Parameters that name files."""


class DeformationCompensatorNode(ManagedComponentNode):
    """Serve the compensator and its files."""

    component: DeformationCompensator

    def __init__(self) -> None:
        super().__init__(DeformationCompensator)

    def start(self) -> None:
        """Load the files, then announce the configuration; activate if `autostart` says so.

        Raises
        ------
        ParameterError
            If a file cannot be read or is none of its kind.
        """
        use_files(self.component, self.request)
        super().start()

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take other files, from the next pattern on; all that is set at once, or nothing."""
        files = {item.name: str(item.value) for item in parameters if item.name in FILES}
        try:
            changed(self.component.configuration, parameters)
        except ValueError as error:
            return refusal(str(error))
        if len(files) > 1:
            return refusal('model and offsets: expected one at a time but found both')
        for name, file in files.items():
            problem = _load(name, file, self.request)
            if problem:
                return refusal(f'{name}: {problem}')
        return super().on_parameters(parameters)


def use_files(component: DeformationCompensator, request: Request | None = None) -> None:
    """Put the files to use that the configuration names.

    Parameters
    ----------
    component : DeformationCompensator
        The component.
    request : callable, optional
        Carries a request out and writes it down; the component's own way if left out.

    Raises
    ------
    ParameterError
        If a file cannot be read or is none of its kind.
    """
    config = component.configuration
    ask = request or (lambda name, arguments: component.on_request(name, arguments, 0))
    for name, file in (('model', config.model), ('offsets', config.offsets)):
        problem = _load(name, file, ask) if file else ''
        if problem:
            raise ParameterError(f'parameter {name}: {problem}')


def _load(name: str, file: str, request: Request) -> str:
    """Put a file to use, none if its name is empty; return what is wrong with it."""
    try:
        text = file_text(file, soft_model.SOFT_FILE_MAX) if file else ''
    except ValueError as error:
        return f'{file}: {error}'
    answer = request(f'use_{name}', {name: text})
    return '' if answer.success else f'{file}: {answer.message}'


def make() -> DeformationCompensatorNode:
    """Create the node."""
    return DeformationCompensatorNode()


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()

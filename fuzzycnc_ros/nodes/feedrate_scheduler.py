# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `feedrate_scheduler`: service `schedule_program`."""

from fuzzycnc_msgs.srv import ScheduleProgram
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.streaming_node import StreamingNode


class FeedrateSchedulerNode(StreamingNode):
    """Serve the scheduler and its service."""

    component: FeedrateScheduler

    def __init__(self) -> None:
        super().__init__(FeedrateScheduler)
        self.node.create_service(ScheduleProgram, 'schedule_program', self._on_program)

    def _on_program(
        self, request: ScheduleProgram.Request, response: ScheduleProgram.Response
    ) -> ScheduleProgram.Response:
        arguments = {
            'program': request.program,
            'units': request.units,
            'path_id': request.path_id,
            'run': bool(request.run),
        }
        answer = self.request('schedule_program', arguments)
        response.success, response.message = answer.success, answer.message
        response.duration = float('nan')
        found = self.component.scheduled
        if answer.success and found is not None:
            response.program, response.duration = found.program, found.duration
        return response


def make() -> FeedrateSchedulerNode:
    """Create the node."""
    return FeedrateSchedulerNode()


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()

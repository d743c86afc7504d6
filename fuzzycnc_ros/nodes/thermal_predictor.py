# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `thermal_predictor`: the model file, and the action `train_thermal_model`.

Training runs in a thread of its own, so that the node goes on predicting; a timer carries its
progress to the client and a cancellation to it.  A cancelled goal is answered at once; its thread
ends at the next progress that it tells, and a training asked for meanwhile waits for that.
"""

import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

from fuzzycnc_msgs.action import TrainThermalModel
from fuzzycnc_msgs.srv import ForgetThermalPosterior
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.core.remedies import Remedy, remedied
from fuzzycnc_ros.core.thermal.model import SIZE_MAX, ThermalModel
from fuzzycnc_ros.files.atomic import write_regular
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.host import ComponentNode
from fuzzycnc_ros.ros.parameters import ParameterError, changed, file_text, refusal

POLL = 0.05
"""Wall time [s] between two looks at a training."""

STOP_PATIENCE = 2.0
"""Wall time [s] that a training gets to end with the node; it looks up between two steps only."""

TOLD_AT_ONCE = 5
"""Most feedback sent at one look: a client keeps ten, and loses the oldest of a longer burst."""


_NO_FILE = 'model: expected a model file but found an empty name; a model in use stays in use'


class CancelledError(Exception):
    """The client does not want the model any more."""


@dataclass
class Training:
    """A training that runs in a thread."""

    goal: ServerGoalHandle
    finished: Future
    stop: threading.Event = field(default_factory=threading.Event)
    progress: 'queue.SimpleQueue[tuple[str, str, int, int]]' = field(
        default_factory=queue.SimpleQueue
    )
    untold: list[tuple[str, str, int, int]] = field(default_factory=list)
    thread: threading.Thread | None = None
    before: threading.Thread | None = None
    """A cancelled training that has not ended yet: two at once would slow the predictor down."""
    model: ThermalModel | None = None
    error: str = 'the training broke off; the log of the node says where'

    def work(self, bags: Sequence[str], name: str, sensor_limits: Sequence[str]) -> None:
        """Read the runs and train; what goes wrong ends up in `error`."""
        # Loaded on use: a node that is never asked to train starts a second faster.
        from fuzzycnc_ros.core.thermal.fit import train_model

        try:
            if self.before is not None:
                self.note('wait', '', 0, 1)
                self.before.join()
            runs = []
            for done, bag in enumerate(bags):
                self.note('read', bag, done, len(bags))
                runs.append(read_run(bag, sensor_limits=sensor_limits))
            self.model = train_model(runs, model=name, progress=self.note)
        except CancelledError:
            self.error = 'cancelled'
        except (ValueError, OSError) as error:
            refusal = remedied(error)
            self.error = str(error) if refusal is None else refusal.told(_with_goal)

    def note(self, stage: str, candidate: str, done: int, total: int) -> None:
        """Pass progress on; leave the training if it was cancelled."""
        if self.stop.is_set():
            raise CancelledError
        self.progress.put((stage, candidate, done, total))

    def news(self) -> list[tuple[str, str, int, int]]:
        """Return the progress to be told now; of one candidate's steps the newest suffices."""
        while not self.progress.empty():
            step = self.progress.get()
            if self.untold and _same_work(self.untold[-1], step):
                self.untold[-1] = step
            else:
                self.untold.append(step)
        told, self.untold = self.untold[:TOLD_AT_ONCE], self.untold[TOLD_AT_ONCE:]
        return told


def _with_goal(remedy: Remedy) -> str:
    """Return a remedy with what the goal says for it, if it can."""
    limits = remedy.arguments.get('sensor_limits')
    return remedy.words if limits is None else f"{remedy.words}: sensor_limits: ['{limits}']"


class ThermalPredictorNode(ComponentNode):
    """Serve the predictor and train its model."""

    component: ThermalPredictor

    def __init__(self, node: Node) -> None:
        super().__init__(node, ThermalPredictor)
        use_files(self.component)
        self._training: Training | None = None
        self._thread: threading.Thread | None = None
        """Thread of the newest training; it outlives one that was cancelled by a moment."""
        self._server = ActionServer(
            node,
            TrainThermalModel,
            'train_thermal_model',
            self._train,
            goal_callback=self._on_goal,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )
        node.create_service(ForgetThermalPosterior, 'forget_thermal_posterior', self._on_forget)
        self._timer = wall_timer(node, POLL, self._poll)
        self._timer.cancel()  # it runs while there is a training

    def stop(self) -> None:
        """End a training that is under way."""
        if self._training is not None:
            self._training.stop.set()
        if self._thread is not None:
            self._thread.join(STOP_PATIENCE)
        self._server.destroy()
        super().stop()

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Let the model of another file take over; the other parameters as every node."""
        files = [item.value for item in parameters if item.name == 'model']
        # A file that is named again may have been trained anew.
        if files and (files[-1] or self._settings.model):
            file = files[-1]
            try:
                # What else is set at once is checked first: all of it is taken, or nothing.
                changed(self.component.configuration, parameters)
                text = file_text(file, SIZE_MAX)
            except ValueError as error:
                return refusal(f'model: {file}: {error}' if file else _NO_FILE)
            answer = self.request('use_model', {'model': text})
            if not answer.success:
                return refusal(f'model: {file}: {answer.message}')
        return super().on_parameters(parameters)

    @property
    def _settings(self) -> ThermalPredictorConfig:
        config = self.component.configuration
        return config

    def _on_forget(
        self, request: ForgetThermalPosterior.Request, response: ForgetThermalPosterior.Response
    ) -> ForgetThermalPosterior.Response:
        arguments = {'mode': request.mode, 'why': request.why, 'by': request.by}
        answer = self.request('forget', arguments)
        response.success, response.message = answer.success, answer.message
        return response

    def _on_goal(self, request: TrainThermalModel.Goal) -> GoalResponse:
        if self._training is not None:
            self.node.get_logger().warning('a training is under way; cancel it first')
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _train(self, goal: ServerGoalHandle) -> TrainThermalModel.Result:
        request = goal.request
        training = Training(goal, Future(executor=self.node.executor), before=self._thread)
        training.thread = threading.Thread(
            target=training.work,
            args=(list(request.bag), request.model or 'auto', list(request.sensor_limits)),
            daemon=True,
        )
        self._training, self._thread = training, training.thread
        training.thread.start()
        self._timer.reset()
        await training.finished
        self._training = None
        self._timer.cancel()
        return self._finish(training, request.file)

    def _poll(self) -> None:
        """Carry progress to the client and a cancellation to the thread."""
        training = self._training
        if training is None or training.thread is None or training.finished.done():
            return
        if training.goal.is_cancel_requested:
            training.stop.set()
        # Looked at before the progress is fetched, so that the last of it is told too.
        ended = not training.thread.is_alive()
        for stage, candidate, done, total in training.news():
            training.goal.publish_feedback(
                TrainThermalModel.Feedback(
                    stage=stage, candidate=candidate, done=done, total=total
                )
            )
        if (ended and not training.untold) or training.stop.is_set():
            training.finished.set_result(None)

    def _finish(self, training: Training, file: str) -> TrainThermalModel.Result:
        """Put a trained model to use; leave everything as it was if there is none."""
        goal, model = training.goal, training.model
        if goal.is_cancel_requested:
            goal.canceled()
            return TrainThermalModel.Result(success=False, message='cancelled')
        if model is None:
            goal.abort()
            return TrainThermalModel.Result(success=False, message=training.error)
        text = model.to_json()
        if file:
            try:
                write_regular(Path(file).expanduser(), text)
            except (OSError, RuntimeError) as error:  # the latter: a home folder nobody has
                goal.abort()
                message = f'file: {file}: {getattr(error, "strerror", error)}'
                return TrainThermalModel.Result(success=False, message=message)
        answer = self.request('use_model', {'model': text})
        goal.succeed() if answer.success else goal.abort()
        return TrainThermalModel.Result(
            success=answer.success,
            message=answer.message,
            model_hash=text_hash(text),
            channel=list(model.channel),
            held_out_rms=_of_default(model, 'held_out_rms'),
            held_out_max=_of_default(model, 'held_out_max'),
        )


def use_files(component: ThermalPredictor) -> None:
    """Put the model file to use that the configuration names.

    Raises
    ------
    ParameterError
        If it cannot be read or is none.
    """
    config = component.configuration
    if not config.model:
        return
    try:
        component.use_model(file_text(config.model, SIZE_MAX))
    except ValueError as error:
        raise ParameterError(f'parameter model: {config.model}: {error}') from error


def _same_work(one: tuple[str, str, int, int], other: tuple[str, str, int, int]) -> bool:
    """Return True if two steps belong to one candidate, or to the one search for sensors."""
    return one[0] == other[0] and (one[1] == other[1] or one[0] == 'select_sensors')


def _of_default(model: ThermalModel, name: str) -> list[float]:
    """Return a held-out figure of the candidate that each channel uses."""
    return [
        float(np.asarray(getattr(model.candidates[candidate], name))[column])
        for column, candidate in enumerate(model.default)
    ]


def make() -> ThermalPredictorNode:
    """Create the node."""
    return ThermalPredictorNode(Node(ThermalPredictor.NAME))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()

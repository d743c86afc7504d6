# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `thermal_predictor`: the model file, and the action `train_thermal_model`.

Training runs in a thread of its own, so that the node goes on predicting; a timer carries its
progress to the client and a cancellation to it.
"""

import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future

from fuzzycnc_msgs.action import TrainThermalModel
from fuzzycnc_ros.bags.atomic import write_text
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.components.thermal_predictor import ThermalPredictor, ThermalPredictorConfig
from fuzzycnc_ros.core.text_hash import text_hash
from fuzzycnc_ros.core.thermal import ThermalModel
from fuzzycnc_ros.nodes import run
from fuzzycnc_ros.nodes.host import ComponentNode
from fuzzycnc_ros.nodes.parameters import ParameterError
from fuzzycnc_ros.nodes.timers import wall_timer

POLL = 0.05
"""Wall time [s] between two looks at a training."""


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
    thread: threading.Thread | None = None
    model: ThermalModel | None = None
    error: str = ''

    def work(self, bags: Sequence[str], name: str) -> None:
        """Read the runs and train; what goes wrong ends up in `error`."""
        # Loaded on use: a node that is never asked to train starts a second faster.
        from fuzzycnc_ros.core.thermal import train_model

        try:
            runs = []
            for done, bag in enumerate(bags):
                self.note('read', bag, done, len(bags))
                runs.append(read_run(bag))
            self.model = train_model(runs, model=name, progress=self.note)
        except CancelledError:
            self.error = 'cancelled'
        except (ValueError, OSError) as error:
            self.error = str(error)

    def note(self, stage: str, candidate: str, done: int, total: int) -> None:
        """Pass progress on; leave the training if it was cancelled."""
        if self.stop.is_set():
            raise CancelledError
        self.progress.put((stage, candidate, done, total))


class ThermalPredictorNode(ComponentNode):
    """Serve the predictor and train its model."""

    component: ThermalPredictor

    def __init__(self, node: Node) -> None:
        super().__init__(node, ThermalPredictor)
        config = self.component.configuration
        assert isinstance(config, ThermalPredictorConfig)
        if config.model:
            self._load(Path(config.model).expanduser())
        self._training: Training | None = None
        self._server = ActionServer(
            node,
            TrainThermalModel,
            'train_thermal_model',
            self._train,
            goal_callback=self._on_goal,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )
        wall_timer(node, POLL, self._poll)

    def stop(self) -> None:
        """End a training that is under way."""
        if self._training is not None and self._training.thread is not None:
            self._training.stop.set()
            self._training.thread.join()
        self._server.destroy()
        super().stop()

    def _load(self, path: Path) -> None:
        try:
            self.component.use_model(path.read_text(encoding='utf-8'))
        except OSError as error:
            raise ParameterError(f'parameter model: {path}: {error.strerror}') from error
        except ValueError as error:
            raise ParameterError(f'parameter model: {path}: {error}') from error

    def _on_goal(self, request: TrainThermalModel.Goal) -> GoalResponse:
        if self._training is not None:
            self.node.get_logger().warning('a training is under way; cancel it first')
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    async def _train(self, goal: ServerGoalHandle) -> TrainThermalModel.Result:
        request = goal.request
        training = Training(goal, Future(executor=self.node.executor))
        training.thread = threading.Thread(
            target=training.work, args=(list(request.bag), request.model or 'auto'), daemon=True
        )
        self._training = training
        training.thread.start()
        await training.finished
        self._training = None
        return self._finish(training, request.file)

    def _poll(self) -> None:
        """Carry progress to the client and a cancellation to the thread."""
        training = self._training
        if training is None or training.thread is None or training.finished.done():
            return
        if training.goal.is_cancel_requested:
            training.stop.set()
        while not training.progress.empty():
            stage, candidate, done, total = training.progress.get()
            training.goal.publish_feedback(
                TrainThermalModel.Feedback(
                    stage=stage, candidate=candidate, done=done, total=total
                )
            )
        if not training.thread.is_alive():
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
                write_text(Path(file).expanduser(), text)
            except OSError as error:
                goal.abort()
                message = f'file: {file}: {error.strerror}'
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

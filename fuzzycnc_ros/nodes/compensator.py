# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `compensator`: the only source of offsets, as a managed lifecycle node.

Deactivation takes effect at once as a state, while the offsets go to zero at the ramp rate; the
node goes on publishing until they are there.  Should it be killed meanwhile, the machine side
lets its last command expire.
"""

from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from fuzzycnc_ros.components.compensator import Compensator, CompensatorConfig
from fuzzycnc_ros.nodes import run
from fuzzycnc_ros.nodes.host import ComponentNode

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ManagedNode(LifecycleNode):
    """A lifecycle node that passes its transitions on to a host."""

    host: 'CompensatorNode | None' = None

    def on_configure(self, state: LifecycleState) -> Any:
        """Become inactive."""
        return self._announce('inactive')

    def on_cleanup(self, state: LifecycleState) -> Any:
        """Become unconfigured."""
        return self._announce('unconfigured')

    def on_activate(self, state: LifecycleState) -> Any:
        """Start to follow the thermal error."""
        return self._request('activate', 'active')

    def on_deactivate(self, state: LifecycleState) -> Any:
        """Start to ramp to zero."""
        return self._request('deactivate', 'inactive')

    def on_shutdown(self, state: LifecycleState) -> Any:
        """Start to ramp to zero if active."""
        if state.label == 'active':
            self._request('deactivate', 'finalized')
        return self._announce('finalized')

    def _announce(self, state: str) -> Any:
        if self.host is not None:
            self.host.announce(state)
        return SUCCESS

    def _request(self, name: str, state: str) -> Any:
        if self.host is None or not self.host.request(name, {}).success:
            return FAILURE
        return self._announce(state)

    def _LifecycleNodeMixin__on_change_state(  # noqa: N802
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Refuse an impossible transition; rclpy lets it end the node with an exception."""
        possible = {item[0]: item[1] for item in self._state_machine.available_transitions}
        wanted = request.transition
        if wanted.id not in possible and wanted.label not in possible.values():
            self.get_logger().warning(
                f'transition {wanted.label or wanted.id} is not possible now; '
                f'possible: {", ".join(possible.values())}'
            )
            response.success = False
            return response
        return super()._LifecycleNodeMixin__on_change_state(request, response)


class CompensatorNode(ComponentNode):
    """Serve the compensator on a managed node."""

    def __init__(self, node: ManagedNode) -> None:
        super().__init__(node, Compensator)
        node.host = self
        self._lifecycle_state = 'unconfigured'

    def start(self) -> None:
        """Announce the configuration; configure and activate if `autostart` says so."""
        super().start()
        config = self.component.configuration
        assert isinstance(config, CompensatorConfig)
        if config.autostart:
            self.node.trigger_configure()
            self.node.trigger_activate()


def make() -> CompensatorNode:
    """Create the node."""
    return CompensatorNode(ManagedNode(Compensator.NAME))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()

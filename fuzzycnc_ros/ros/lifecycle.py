# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Managed lifecycle nodes: those through which something reaches a machine.

A transition takes effect at once as a state; what the component still has to do on its way to
rest, it goes on doing.
"""

from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from fuzzycnc_ros.ros.host import ComponentNode
from fuzzycnc_ros.runtime.component import Component
from fuzzycnc_ros.runtime.host import FINALIZED, WAS_FINALIZED

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE

REACHED = {'configure': 'inactive', 'activate': 'active', 'deactivate': 'inactive'}
"""State of a managed node after a transition."""


class ManagedNode(LifecycleNode):
    """A lifecycle node that passes its transitions on to a host."""

    host: 'ManagedComponentNode | None' = None

    def on_configure(self, state: LifecycleState) -> Any:
        """Become inactive."""
        return self._announce('inactive')

    def on_cleanup(self, state: LifecycleState) -> Any:
        """Become unconfigured."""
        return self._announce('unconfigured')

    def on_activate(self, state: LifecycleState) -> Any:
        """Let the component act."""
        return self._request('activate', 'active')

    def on_deactivate(self, state: LifecycleState) -> Any:
        """Let the component come to an end."""
        return self._request('deactivate', 'inactive')

    def on_shutdown(self, state: LifecycleState) -> Any:
        """Let the component come to an end if it is active."""
        if state.label == 'active':
            self._request('deactivate', FINALIZED)
        if self.host is not None:
            self.host.troubles['lifecycle'] = WAS_FINALIZED
        return self._announce(FINALIZED)

    def _announce(self, state: str) -> Any:
        if self.host is not None:
            self.host.announce(state)
        return SUCCESS

    def _request(self, name: str, state: str) -> Any:
        if self.host is None:
            return FAILURE
        answer = self.host.request(name, {})
        if not answer.success:
            self.host.troubles['lifecycle'] = f'{name} refused: {answer.message}'
            self.get_logger().error(self.host.troubles['lifecycle'])
            return FAILURE
        self.host.troubles.pop('lifecycle', None)
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


class ManagedComponentNode(ComponentNode):
    """Serve a component on a managed node; its configuration has the parameter `autostart`."""

    def __init__(self, component_type: type[Component]) -> None:
        node = ManagedNode(component_type.NAME)
        super().__init__(node, component_type)
        node.host = self
        self._lifecycle_state = 'unconfigured'

    def start(self) -> None:
        """Announce the configuration; configure and activate if `autostart` says so."""
        super().start()
        config: Any = self.component.configuration
        if config.autostart:
            self.node.trigger_configure()
            self.node.trigger_activate()

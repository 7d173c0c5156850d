"""The parameter protocol of one vehicle: reads, sets, and the whole list a few at a time."""

from __future__ import annotations

from collections import deque

from gatar_edge.sim_sitl.core import Core
from gatar_edge.sim_sitl.stack import Stack
from gatar_edge.sim_sitl.wire import Message

_PER_STEP = 20


class ParameterServer:
    """Answers PARAM_ messages."""

    def __init__(self, core: Core, stack: Stack) -> None:
        self._core, self._stack = core, stack
        self._listed: deque[str] = deque()  # still to be said

    def list_all(self) -> None:
        """PARAM_REQUEST_LIST."""
        params = self._core.params
        names = (params.name_of(index) for index in range(len(params)))
        self._listed = deque(name for name in names if name is not None)

    def read(self, message: Message) -> None:
        """PARAM_REQUEST_READ, by index or by name."""
        params = self._core.params
        by_index = message.param_index >= 0
        name = params.name_of(message.param_index) if by_index else message.param_id
        if name is not None and name in params:
            self._say(name, indexed=by_index)

    def set(self, message: Message) -> None:
        """PARAM_SET: taken into use and said back, or ignored."""
        if self._core.params.set_from_wire(message.param_id, message.param_value):
            self._stack.parameter_changed(self._core, message.param_id)
            self._say(message.param_id)

    def step(self) -> None:
        """Say some more of the list."""
        if not self._listed:
            return
        for _ in range(min(_PER_STEP, len(self._listed))):
            self._say(self._listed.popleft(), indexed=True)

    def _say(self, name: str, indexed: bool = False) -> None:
        params = self._core.params
        index = params.index_of(name) if indexed or not self._stack.hides_parameter_index else 65535
        self._core.emit(
            "PARAM_VALUE",
            param_id=name.encode(), param_value=params.to_wire(name), param_type=params.type_of(name),
            param_count=len(params), param_index=index,
        )  # fmt: skip

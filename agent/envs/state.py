"""States of environments that can be saved and restored, and environments that are closed."""

import copy
from typing import Any, ClassVar

from cosim.base.errors import UserError, shown


class ClosedError(UserError, ValueError):
    """A closed environment is used."""


class StateError(UserError, ValueError):
    """A state that does not fit the environment."""


class Restorable:
    """An object that saves and restores its state; the same bits follow.

    Attributes:
        closed: whether `close` has been called since the last `reset`.
    """

    closed: bool = False
    _mutable: ClassVar[tuple[str, ...]]  # names of the attributes that change

    def get_state(self) -> dict[str, Any]:
        """Return a copy of everything that changes; it can be pickled.

        Raises:
            ClosedError: the environment is closed.
            FmuError: the motor FMU cannot save its state.
        """
        self._require_open()
        mine = {name: getattr(self, name) for name in self._mutable}
        return {
            name: part.get_state() if hasattr(part, "get_state") else copy.deepcopy(part)
            for name, part in mine.items()
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state of this object, or of one that was made with the same arguments.

        Raises:
            ClosedError: the environment is closed.
            StateError: the state is that of another kind of environment, or of another number.
        """
        self._require_open()
        if not isinstance(state, dict) or set(state) != set(self._mutable):
            raise StateError(
                f"{shown(state)} is not a state of this kind of environment; give the result "
                "of get_state() of one that was made with the same arguments"
            )
        for name, saved in state.items():
            mine = getattr(self, name)
            if hasattr(mine, "set_state"):
                mine.set_state(saved)
            else:
                setattr(self, name, copy.deepcopy(saved))

    def _require_open(self) -> None:
        if self.closed:
            raise ClosedError("the environment is closed; call reset to use it again")

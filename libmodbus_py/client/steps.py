"""
The methods of both clients: each is made once.

A method makes a request (`asks`), or is a procedure that yields requests, one or `Several`, and is
sent results (`follows`). A blocking client carries it out at once; an awaiting one returns a
coroutine.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Generator, Iterable
from functools import update_wrapper
from typing import (
    TYPE_CHECKING,
    Any,
    Concatenate,
    Generic,
    NamedTuple,
    ParamSpec,
    TypeVar,
    overload,
)

from ..protocol import pdu
from ..protocol.errors import ModbusError

__all__ = ["Awaiting", "Blocking", "ChangeRegister", "Several", "Steps", "asks", "follows"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class Several(NamedTuple):
    """
    Requests that a procedure makes together, as `execute_many` takes them.

    Attributes:
        stops: True to send nothing more after a ModbusError, and to return the results and that
            error; only without `return_exceptions`.
    """

    requests: Iterable[pdu.Request[Any]]
    max_in_flight: int
    return_exceptions: bool
    stops: bool = False

    @property
    def returned(self) -> tuple[type[BaseException], ...]:
        """The exceptions that are returned among the results."""
        return (ModbusError,) if self.return_exceptions or self.stops else ()


class ChangeRegister(NamedTuple):
    """
    A holding register that is read, changed and written, because the device lacks function 22.

    No other such step on the connection takes place at the same time.
    """

    request: pdu.MaskWriteRegister

    def write(self, register: int) -> pdu.WriteRegister:
        """Return the request that writes the register, as in section 6.16 of the specification."""
        request = self.request
        value = register & request.and_mask | request.or_mask & ~request.and_mask
        return pdu.WriteRegister(request.address, value & 0xFFFF)


Steps = Generator[pdu.Request[Any] | Several | ChangeRegister, Any, Result]


class Blocking:
    """A client whose methods return results."""

    def _refuse(self, error: Exception) -> Any:
        raise error

    def _follow(self, make: Any, arguments: Any, named: Any) -> Any:
        raise NotImplementedError


class Awaiting:
    """A client whose methods return coroutines."""

    async def _refuse(self, error: Exception) -> Any:
        raise error

    async def _follow(self, make: Any, arguments: Any, named: Any) -> Any:
        raise NotImplementedError


if TYPE_CHECKING:

    class _Method(Generic[Arguments, Result]):
        """A method of both clients, for type checkers: returns a result, or one to await."""

        @overload
        def __get__(self, client: Blocking, owner: object) -> Callable[Arguments, Result]: ...
        @overload
        def __get__(
            self, client: Awaiting, owner: object
        ) -> Callable[Arguments, Coroutine[Any, Any, Result]]: ...
        @overload
        def __get__(self, client: None, owner: object) -> Callable[..., Any]: ...
        def __get__(self, client: Any, owner: object) -> Any: ...

    def asks(
        make: Callable[Concatenate[Any, Arguments], pdu.Request[Result]],
    ) -> _Method[Arguments, Result]: ...

    def follows(
        make: Callable[Concatenate[Any, Arguments], Steps[Result]],
    ) -> _Method[Arguments, Result]: ...

else:
    # Plain functions, so that help() and inspect.signature() work.

    def asks(make):
        def method(self, /, *arguments, **named):
            try:
                request = make(self, *arguments, **named)
            except (TypeError, ValueError) as error:
                return self._refuse(error)
            return self.execute(request)

        return _dressed(method, make)

    def follows(make):
        def method(self, /, *arguments, **named):
            return self._follow(make, arguments, named)

        return _dressed(method, make)

    def _dressed(method, make):
        """As the method is told of: with its result, not with what is made on the way."""
        told = make.__annotations__["return"]
        make.__annotations__["return"] = told.partition("[")[2].removesuffix("]")
        method.__annotations__ = make.__annotations__
        return update_wrapper(method, make)

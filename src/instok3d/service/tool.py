"""A question that the HTTP API and MCP take alike, and what it may answer."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from instok3d.service.parameters import Parameter, check_arguments

PNG, JPEG = "image/png", "image/jpeg"


@dataclass(frozen=True)
class Picture:
    """A picture as an answer."""

    data: bytes
    media_type: str = PNG


@dataclass(frozen=True)
class Tool:
    """One question with its parameters."""

    name: str
    about: str
    """What comes out."""
    parameters: tuple[Parameter, ...]
    answer: Callable[..., dict[str, Any] | Picture]
    """Called with all parameters by name, and with the bytes of a picture before them."""
    picture_type: str | None = None
    """The media type of the picture that is its answer; None: the answer is data."""
    takes_picture: bool = False
    """Whether it is asked by the bytes of a picture; such tools are not among those of MCP."""

    def run(self, given: Mapping[str, Any], picture: bytes = b"") -> dict[str, Any] | Picture:
        """The answer to some arguments.

        Args:
            given: By name.
            picture: What the request brought, of tools that take one.

        Raises:
            KeyError: There is no such scene or object.
            ValueError: An argument is wrong, or what is asked for cannot be.
            FileNotFoundError: An encoder's weights are missing.
        """
        arguments = check_arguments(self.parameters, given)
        return self.answer(*([picture] if self.takes_picture else []), **arguments)


@runtime_checkable
class Tools(Protocol):
    """Whatever has tools: opened scenes, a library."""

    def tools(self) -> tuple[Tool, ...]:
        """All tools, by name."""
        ...

"""Parameters of tools: described once, as JSON Schema, and checked by it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["string", "integer", "number", "boolean"]


class ArgumentError(ValueError):
    """An argument is unknown, missing, of another kind or out of range."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a tool."""

    name: str
    kind: Kind
    about: str
    """What it means, a sentence."""
    default: Any = None
    """None where it can be left out without one."""
    required: bool = False
    least: int | float | None = None
    """Smallest number."""
    most: int | float | None = None
    """Largest number, or characters of a string."""
    choices: tuple[str, ...] = ()
    """The only strings."""

    def schema(self) -> dict[str, Any]:
        """Its JSON Schema."""
        found: dict[str, Any] = {"type": self.kind, "description": self.about}
        if self.choices:
            found["enum"] = list(self.choices)
        elif self.kind == "string":
            found |= {"minLength": 1, "maxLength": int(self.most or 0)}
        else:
            found |= {"minimum": self.least} if self.least is not None else {}
            found |= {"maximum": self.most} if self.most is not None else {}
        return found | ({} if self.default is None else {"default": self.default})

    def checked(self, value: Any) -> Any:
        """The value as the tool takes it.

        Args:
            value: Of its kind, or the text of one, as addresses have it.

        Raises:
            ArgumentError: It is of another kind or out of range.
        """
        found = self._parsed(value)
        if self.kind == "string":
            sound = found in self.choices if self.choices else 0 < len(found) <= (self.most or 0)
        else:
            low, high = (-math.inf if self.least is None else self.least,
                         math.inf if self.most is None else self.most)  # fmt: skip
            sound = math.isfinite(found) and low <= found <= high
        if not sound:
            raise ArgumentError(f"{self.name} must be {self.wanted()}, got {str(value)[:40]!r}")
        return found

    def wanted(self) -> str:
        """What is taken, in words."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if self.kind == "string":
            return f"a text of 1 to {int(self.most or 0)} characters"
        limits = [f"from {self.least}"] if self.least is not None else []
        limits += [f"up to {self.most}"] if self.most is not None else []
        kinds = {"integer": "a whole number", "number": "a number", "boolean": "true or false"}
        return " ".join([kinds[self.kind], *limits])

    def _parsed(self, value: Any) -> Any:
        wrong = ArgumentError(f"{self.name} must be {self.wanted()}, got {str(value)[:40]!r}")
        if self.kind == "boolean":
            known = {"true": True, "false": False}
            if isinstance(value, str) and value in known:
                return known[value]
            if isinstance(value, bool):
                return value
            raise wrong
        if self.kind == "string":
            if isinstance(value, str):
                return value
            raise wrong
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise wrong
        try:
            number = float(value)
        except (ValueError, OverflowError) as error:
            raise wrong from error
        if self.kind == "integer":
            if not math.isfinite(number) or number != int(number) or abs(number) > 2**53:
                raise wrong
            return int(number)
        return number


def check_arguments(parameters: tuple[Parameter, ...], given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a tool, with defaults.

    Raises:
        ArgumentError: One is unknown, missing, of another kind or out of range.
    """
    known = {each.name: each for each in parameters}
    strange = sorted(set(given) - set(known))
    if strange:
        raise ArgumentError(
            f"no parameter {strange[0][:40]!r}; there are: {', '.join(known) or 'none'}"
        )
    missing = [each.name for each in parameters if each.required and given.get(each.name) is None]
    if missing:
        raise ArgumentError(f"{missing[0]} is missing: {known[missing[0]].about}")
    found = {name: each.default for name, each in known.items()}
    return found | {name: known[name].checked(value) for name, value in given.items()
                    if value is not None}  # fmt: skip


def arguments_schema(parameters: tuple[Parameter, ...]) -> dict[str, Any]:
    """JSON Schema of the arguments as one object."""
    return {
        "type": "object",
        "properties": {each.name: each.schema() for each in parameters},
        "required": [each.name for each in parameters if each.required],
        "additionalProperties": False,
    }

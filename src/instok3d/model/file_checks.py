"""What a model file says of itself, checked before anything of those sizes is made."""

import collections.abc
import reprlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from threading import get_ident
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from torch import Tensor, nn
from torch.nn.modules.module import register_module_parameter_registration_hook

from instok3d.model.on_paper import on_paper
from instok3d.reading import number, one_of, text, whole_number

MOST = 2**24
"""No size is larger."""
SPARE_PARAMETERS = 100
"""A module may register one parameter more than once while it is built."""

Header = Mapping[str, tuple[tuple[int, ...], str]]
"""Shape of each tensor of a safetensors file, and its type there: F32, F16, I64, ..."""


def config_of_json(
    config_class: type, values: Any, added_later: Mapping[str, Mapping[str, Any]]
) -> Any:
    """The dataclass of JSON values, nested ones too; keys and fields must be the same.

    A size that is missing must not become today's default: the file was made with another one,
    which added_later knows where this version has more sizes than the one that wrote the file.

    Args:
        config_class: The dataclass.
        values: What the file has.
        added_later: By the dataclass's name, sizes that files may lack.

    Raises:
        ValueError: A size is missing, unknown, or of another kind than wanted.
    """
    name = config_class.__name__
    if not isinstance(values, dict):
        raise ValueError(f"its {name} is no JSON object")
    values = {**added_later.get(name, {}), **values}
    known = {each.name for each in fields(config_class)}
    if unknown := sorted(set(values) - known):
        raise ValueError(
            f"it has sizes that this version does not know: {', '.join(unknown)} of {name}"
        )
    if missing := sorted(known - set(values)):
        raise ValueError(f"it lacks sizes that this version needs: {', '.join(missing)} of {name}")
    types, settled = get_type_hints(config_class), {}
    for key, value in values.items():
        if is_dataclass(types[key]):
            settled[key] = config_of_json(types[key], value, added_later)  # pyright: ignore[reportArgumentType]
            continue
        try:
            settled[key] = _value(types[key], value)
        except ValueError as error:
            raise ValueError(f"its {key} of {name}: {error}") from error
    return config_class(**settled)


def check_finite(weights: Mapping[str, Tensor], *, half: bool = False) -> None:
    """Fail if a weight is NaN or infinite: the model's answers would be, far from the cause.

    Args:
        weights: As they stand in the file.
        half: The caller made them float16, in which numbers above 65,504 are infinite.

    Raises:
        ValueError: So it is; names the weight.
    """
    for name, value in weights.items():
        if not value.isfinite().all():
            raise ValueError(f"weight {name} is not finite{' in float16' if half else ''}")


def check_tensors(build: Callable[[], nn.Module], header: Header) -> None:
    """Fail unless a file has the tensors of a model, before memory for the model is taken.

    Args:
        build: Makes the model; called where tensors have shapes alone.
        header: What the file has.

    Raises:
        ValueError: A tensor is missing, unknown, or of another shape or kind.
    """
    with on_paper(), _at_most_parameters(len(header) + SPARE_PARAMETERS):
        wanted = build().state_dict()
    for problem, names in (
        ("lacks", wanted.keys() - header.keys()),
        ("has the unknown", header.keys() - wanted.keys()),
    ):
        if names:
            raise ValueError(f"it {problem} weight {min(names)}, and {len(names) - 1} more")
    for name, value in wanted.items():
        shape, kind = header[name]
        if shape != tuple(value.shape):
            raise ValueError(f"weight {name} has the shape {shape}, wanted {tuple(value.shape)}")
        if ("F" in kind) != value.is_floating_point():
            raise ValueError(f"weight {name} holds {kind}, wanted {value.dtype}")


@contextmanager
def _at_most_parameters(most: int) -> Iterator[None]:
    """An error where more parameters than that are made: a number of layers may be anything."""
    count, thread = 0, get_ident()

    def counted(module: nn.Module, name: str, parameter: nn.Parameter | None) -> None:
        nonlocal count
        count += get_ident() == thread
        if count > most:
            raise ValueError(f"its sizes ask for more than {most} weights, which it does not have")

    hook = register_module_parameter_registration_hook(counted)
    try:
        yield
    finally:
        hook.remove()


def _value(kind: Any, value: Any) -> Any:
    """A value of JSON as a field of this type has it.

    Raises:
        ValueError: It is something else.
    """
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return one_of(value, inner)
    if origin in (Union, UnionType):
        if value is None and NoneType in inner:
            return None
        others = [each for each in inner if each is not NoneType]
        return _value(others[0], value) if len(others) == 1 else value
    if origin in (tuple, list, collections.abc.Sequence):
        if not isinstance(value, list):
            raise ValueError("it is no list")
        return tuple(_value(inner[0], each) if inner else each for each in value)
    if kind is bool and type(value) is not bool:
        raise ValueError(f"{reprlib.repr(value)} is neither true nor false")
    plain = {int: lambda v: whole_number(v, most=MOST), float: number, str: text}
    return plain[kind](value) if kind in plain else value

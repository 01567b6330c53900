"""huggingface-hub, which is optional, and its errors in one sentence each."""

import errno
import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from instok3d.hub.references import HubReference

LOG_IN = "log in with `hf auth login`, or set HF_TOKEN"
_FULL = (errno.ENOSPC, errno.EDQUOT)


def hub_library() -> Any:
    """The package.

    Raises:
        ModuleNotFoundError: It is not installed.
    """
    try:
        return importlib.import_module("huggingface_hub")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "the Hugging Face hub is reached through huggingface-hub, which is not installed: "
            "pip install 'instok3d[models]'"
        ) from error


def hub_api() -> Any:
    """Its client, of the server that HF_ENDPOINT names where it is set."""
    return hub_library().HfApi(endpoint=os.environ.get("HF_ENDPOINT"))


@contextmanager
def explained(reference: HubReference, what: str) -> Iterator[None]:
    """Errors of the hub in the block, in one sentence, without the user's token.

    Args:
        reference: What is asked for.
        what: What it is, such as "model".

    Raises:
        FileNotFoundError: The hub has no such repository, revision or file.
        PermissionError: The hub refuses.
        ConnectionError: The hub cannot be reached, or does not answer as it should.
        ValueError: The name is longer than the hub allows, or the like.
        OSError: The disk is full.
    """
    errors = importlib.import_module("huggingface_hub.errors")
    try:
        yield
    except Exception as error:  # which errors there are depends on the library's HTTP library
        if isinstance(error, errors.HFValidationError) or _is_full(error):
            raise
        status = getattr(getattr(error, "response", None), "status_code", None)
        if isinstance(error, errors.GatedRepoError):
            kind, reason = PermissionError, f"is given on request alone: ask on its page, {LOG_IN}"
        elif isinstance(error, errors.RepositoryNotFoundError):
            kind, reason = FileNotFoundError, f"is no {what} that this account may see: {LOG_IN}"
        elif isinstance(error, errors.RevisionNotFoundError):
            kind, reason = FileNotFoundError, "is there, but without this revision"
        elif isinstance(error, errors.EntryNotFoundError) and status is not None:
            kind, reason = FileNotFoundError, f"holds no {what} of instok3d: a file is missing"
        elif status in (401, 403):
            kind, reason = PermissionError, f"is refused by the hub ({status}): {LOG_IN}"
        else:
            kind, reason = ConnectionError, f"cannot be had from the hub ({_reason(error)})"
        # The chain of errors, which --debug prints, could hold the token of a refused header.
        raise kind(f"{reference} {reason}") from (None if _names_token(error) else error)


def _reason(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    reason = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
    return type(error).__name__ if _names_token(error) else reason


def _names_token(error: BaseException | None) -> bool:
    """Whether an error, or one behind it, says the user's token."""
    token = hub_library().get_token()
    forms = (token, repr(token)[1:-1]) if token else ()
    while error is not None:
        if any(form in str(error) for form in forms):
            return True
        error = error.__cause__ or error.__context__
    return False


def _is_full(error: Exception) -> bool:
    return isinstance(error, OSError) and error.errno in _FULL

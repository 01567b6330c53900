"""What teachers ask of texts."""

from collections.abc import Sequence


def check_texts(texts: Sequence[str]) -> None:
    """Fail for a text that says nothing.

    Raises:
        ValueError: One is empty or blank.
    """
    for text in texts:
        if not text.strip():
            raise ValueError(f"the text {text!r} is empty: describe what to look for")


def too_long(text: str, tokens: int, longest: int) -> ValueError:
    """The error for a text that a teacher cannot take whole; nothing is cut off in silence."""
    return ValueError(
        f"the text {text[:40]!r}... has {tokens} tokens, and the text encoder takes {longest}: say "
        "it in fewer words"
    )

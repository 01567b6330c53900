"""Errors with an exit code of their own; knowing them takes no import of torch."""


class MissingWeightsError(FileNotFoundError):
    """The weights that were asked for are not on this machine (exit code 4)."""


class NotEnoughMemoryError(MemoryError):
    """What was asked for is predicted not to fit in memory (exit code 3)."""

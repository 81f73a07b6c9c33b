"""The exception of this package."""

from __future__ import annotations


class Re4Error(Exception):
    """What is wrong with an input or the machine, and how to fix it.

    The text is the sentence that the command line prints, such as ``there is no file a.zarr; check the path``.

    Attributes:
        message: What is wrong.
        remedy: How to fix it, in the imperative, or None.
    """

    def __init__(self, message: str, remedy: str | None = None) -> None:
        super().__init__(message, remedy)
        self.message = message
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}" if self.remedy else self.message

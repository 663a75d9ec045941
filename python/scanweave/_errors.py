"""Exceptions. Every message names the argument, file or setting, what was found, what was expected, and
what to do."""

from __future__ import annotations

__all__ = ["InputError", "OutputError", "ReadError", "ScanweaveError", "ScanweaveWarning", "SettingError"]


class ScanweaveError(Exception):
    """Base of all errors of this package."""


class InputError(ScanweaveError, ValueError):
    """Scans, files or arguments that cannot be used."""


class ReadError(InputError, OSError):
    """A file or folder that the system refuses to read, or that is not there."""


class SettingError(ScanweaveError, ValueError):
    """A setting that is unknown or has a value that cannot be used."""


class OutputError(ScanweaveError, OSError):
    """A result that cannot be written, or whose place is taken."""


class ScanweaveWarning(UserWarning):
    """Something about the scans that may be wrong, and with which the work went on."""


def input_error(subject: str, found: str, expected: str, remedy: str) -> InputError:
    """An error worded as those of the library are."""
    return InputError(f"{subject}: found {found}, expected {expected}; {remedy}")

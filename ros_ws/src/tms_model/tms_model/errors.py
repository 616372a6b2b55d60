"""The exception of the project for parameters, names and settings."""

from __future__ import annotations


class ParameterError(ValueError):
    """A parameter, name or setting that can't be used: text says what was expected, found, and what to do."""

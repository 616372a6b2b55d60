"""The one exception of this package."""

from __future__ import annotations


class RecordingError(Exception):
    """A recording, log or mapping that can't be used: says what was expected, what was found, what to do."""

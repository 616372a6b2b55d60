"""Texts of the command line and of node parameters that stand for names and numbers."""

from __future__ import annotations

import argparse


def names(text: str) -> tuple[str, ...]:
    """NAME,NAME,... as names."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def assignment(text: str) -> tuple[str, float]:
    """NAME=VALUE as both. Raises argparse.ArgumentTypeError."""
    name, equals, value = text.partition("=")
    try:
        if equals:
            return name.strip(), float(value)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"expected NAME=VALUE with a number, found {text!r}")

"""YAML texts of anybody's, read by PyYAML's safe loader, compiled where it was built with libyaml."""

from __future__ import annotations

from typing import Any

import yaml

MOST_NESTED = 100  # levels; the compiled loader would run out of stack at some ten thousand, and crash
# What the safe loader raises for texts that aren't YAML, or not of the types that their tags say.
NOT_YAML = (yaml.YAMLError, ValueError, TypeError, AttributeError, LookupError, OverflowError, RecursionError)

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load_yaml(text: str) -> Any:
    """What a text says. Raises one of NOT_YAML."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MOST_NESTED:
            raise yaml.YAMLError(f"nested in more than {MOST_NESTED} levels")
    return yaml.load(text, Loader=_Loader)

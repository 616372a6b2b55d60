"""Options of a fit as arguments of a command line, and texts that stand for names and numbers."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from tms_model.errors import ParameterError

from tms_fit.settings import AUTO, OPTIONS, Option, Settings

Value = TypeVar("Value")


def add_options(command: argparse.ArgumentParser, *names: str, **helps: str) -> None:
    """Declare options of the table, by default all that a command line offers.

    names: fields of Settings; helps: other texts of help, by such a name.
    """
    for name in names or OPTIONS:
        one = OPTIONS[name]
        if one.flag:
            command.add_argument(one.flag, dest=name, help=helps.get(name, _help(one)), **_reading(one))


def settings_of(arguments: argparse.Namespace, **values: Any) -> Settings:
    """Settings by the arguments of `add_options`; `values` take precedence. Raises ParameterError."""
    asked: dict[str, Any] = {}
    for name, one in OPTIONS.items():
        given = getattr(arguments, name, None)
        if name in values or given is None:
            continue
        if one.kind in ("values", "priors"):
            asked[name] = each_once(given, one.flag)
        else:
            asked[name] = tuple(given) if isinstance(given, list) else given
    return Settings(**{**asked, **values})


def _reading(one: Option) -> dict[str, Any]:
    """How argparse reads an option; not given: None, and Settings has the default."""
    if one.kind in ("values", "priors"):
        written = {"type": assignment, "metavar": "NAME=VALUE"}
        if one.kind == "priors":
            written = {"type": prior, "metavar": "NAME=MEAN,STD"}
        return {"action": "append", "default": [], **written}
    if one.repeated:
        return {"action": "append", "choices": one.choices}
    if one.kind == "choice":
        return {"choices": one.choices, "default": one.default}
    readers: dict[str, tuple[Callable[[str], Any], str]] = {
        "number": (float, {"s": "S", "rad/s": "RATE"}.get(one.unit, "NUMBER")),
        "numbers": (numbers, "NUMBER,..."),
        "angles": (angles, "NUMBER,..."),
        "names": (names, "NAME,..."),
    }
    read, metavar = readers[one.kind]
    return {"type": read, "default": one.default, "metavar": one.metavar or metavar}


def _help(one: Option) -> str:
    """Help of an option, with its default; a choice's names stand beside its flag already."""
    text = one.help if one.kind == "choice" or one.repeated else one.text
    default = ", ".join(one.default) if one.kind == "names" and one.default else one.default
    note = one.unset or (f"{default:g}" if isinstance(default, float) else f"{default}")
    again = "; may be repeated" if one.repeated or one.kind in ("values", "priors") else ""
    return f"{text}{again} (default: {note})".replace("%", "%%")


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


def prior(text: str) -> tuple[str, tuple[float, float]]:
    """NAME=MEAN,STD as a name, a mean and a positive deviation. Raises argparse.ArgumentTypeError."""
    name, equals, values = text.partition("=")
    try:
        mean, std = (float(part) for part in values.split(","))
        if equals and math.isfinite(mean) and 0.0 < std < math.inf:
            return name.strip(), (mean, std)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"expected NAME=MEAN,STD with STD positive, found {text!r}")


def numbers(text: str) -> tuple[float, ...]:
    """NUMBER,NUMBER,... as numbers. Raises argparse.ArgumentTypeError."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers, found {text!r}") from None


def angles(text: str) -> tuple[float, ...] | str:
    """ROLL,PITCH,YAW as numbers, or auto. Raises argparse.ArgumentTypeError."""
    try:
        return AUTO if text == AUTO else numbers(text)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"expected ROLL,PITCH,YAW [deg] or {AUTO}, found {text!r}") from None


def each_once(pairs: Iterable[tuple[str, Value]], option: str) -> dict[str, Value]:
    """Names and values as a dictionary. Raises ParameterError for a name that comes twice."""
    found: dict[str, Value] = {}
    for name, value in pairs:
        if name in found:
            raise ParameterError(f"{option}: {name}: expected each name once, found it twice")
        found[name] = value
    return found

"""The columns of a logger's CSV, read with a mapping that says what they mean."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tms_model.frames import flip_axes

from tms_bag.conversion import LAST_STAMP_NS
from tms_bag.errors import RecordingError
from tms_bag.mapping import QUANTITIES, TIME_UNITS_NS, UNITS, LogMapping
from tms_bag.samples import FloatArray, IntArray

LARGEST_LOG = 2**28  # [bytes]; an hour at 100 Hz has about 40 MB

_Lines = Sequence[tuple[int, list[str]]]  # line number and cells of each row


@dataclass(frozen=True, eq=False)
class Log:
    """Columns of a log in SI units and the model's SAE signs."""

    path: Path
    sha256: str
    time_ns: IntArray  # (n,) [ns since 1970]
    columns: dict[str, FloatArray]  # by quantity, (n,) each
    skipped: int = 0  # rows left out because a mapped cell was empty or NaN


def read_csv(log: str | os.PathLike[str], mapping: LogMapping) -> Log:
    """The mapped columns of a CSV file; other columns may hold anything.

    RecordingError with the line and column if a column is missing, a cell isn't a number, or (unless the
    mapping says to skip them) cells are empty or NaN.
    """
    path = Path(log)
    content = _content(path)
    rows = csv.reader(io.StringIO(_text(path, content)), delimiter=mapping.delimiter)
    try:
        header = [name.strip() for name in next(rows, [])]
        lines = [(rows.line_num, row) for row in rows]
    except csv.Error as error:
        raise RecordingError(f"{path}: can't be read as CSV ({error}, line {rows.line_num})") from error
    while lines and not any(cell.strip() for cell in lines[-1][1]):
        lines.pop()  # empty lines at the end
    if not lines:
        raise RecordingError(
            f"{path}: expected a header and rows of numbers, found {len(header)} columns and no rows"
        )
    positions = _positions(path, header, mapping)
    _check_row_lengths(path, header, lines)
    table = {
        quantity: _numbers(path, lines, positions[quantity], column.name)
        for quantity, column in mapping.columns.items()
    }
    times = _times(path, lines, positions.get("time", 0), mapping)
    kept = _complete_rows(path, lines, table, mapping)
    columns = {
        quantity: _in_model_units(quantity, values[kept], mapping) for quantity, values in table.items()
    }
    return Log(path, hashlib.sha256(content).hexdigest(), times[kept], columns, int(kept.size - kept.sum()))


def text_of(path: Path) -> str:
    """A CSV file's text. RecordingError if there is none, or if it's something else."""
    return _text(path, _content(path))


def _content(path: Path) -> bytes:
    try:
        if not path.is_file():
            found = "a folder" if path.is_dir() else "nothing there"
            raise RecordingError(f"{path}: expected a CSV file, found {found}; check the path")
        if path.stat().st_size > LARGEST_LOG:
            raise RecordingError(
                f"{path}: expected a log below 256 MiB, found {path.stat().st_size} bytes; split it"
            )
        return path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: can't be read ({error.strerror})") from error


def _text(path: Path, content: bytes) -> str:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"{path}: expected a CSV text in UTF-8, found other bytes at {error.start}"
        ) from error
    if "\0" in text:
        raise RecordingError(f"{path}: expected a CSV text, found zero bytes: it is binary or damaged")
    return text


def _check_row_lengths(path: Path, header: Sequence[str], lines: _Lines) -> None:
    twice = sorted({name for name in header if name and header.count(name) > 1})
    if twice:
        raise RecordingError(
            f"{path}: expected different column names, found more than one {', '.join(twice)}"
        )
    for line, row in lines:
        if any(cell.strip() for cell in row[len(header) :]):
            raise RecordingError(
                f"{path}: line {line}: expected {len(header)} cells as in the header, found {len(row)};"
                " repair that line or the header"
            )


def _positions(path: Path, header: Sequence[str], mapping: LogMapping) -> dict[str, int]:
    """Where the columns of each quantity (and of the time) stand. RecordingError names all missing ones."""
    wanted = {quantity: column.name for quantity, column in mapping.columns.items()}
    if mapping.clock.rate is None:
        wanted["time"] = mapping.clock.column
    missing = {quantity: name for quantity, name in wanted.items() if name not in header}
    if missing:
        names = ", ".join(f"{name!r} ({quantity})" for quantity, name in missing.items())
        quantity = next(iter(missing))
        remedy = "say it in a mapping of your own (--mapping FILE.yaml)"
        if quantity != "time":
            remedy = f"say --column {quantity}=NAME or --without {quantity}, or {remedy}"
        raise RecordingError(
            f"{path}: expected the columns {names}, found only {', '.join(header)}; {remedy}"
        )
    return {quantity: header.index(name) for quantity, name in wanted.items()}


def _numbers(path: Path, lines: _Lines, position: int, column: str) -> FloatArray:
    """A column; NaN where a cell is empty, missing or says NaN."""
    values = np.full(len(lines), np.nan)
    for row, (line, cells) in enumerate(lines):
        cell = cells[position].strip() if position < len(cells) else ""
        if not cell:
            continue
        values[row] = number_in(cell)
        if math.isinf(values[row]):
            raise RecordingError(
                f"{path}: line {line}, column {column!r}: expected a finite number, found {cell[:40]!r};"
                " repair or remove that line"
            )
    return values


def number_in(cell: str) -> float:
    """A number or NaN; infinite for everything that isn't one."""
    try:
        return math.inf if "_" in cell else float(cell)
    except ValueError:
        return math.inf


def _complete_rows(
    path: Path, lines: _Lines, table: dict[str, FloatArray], mapping: LogMapping
) -> NDArray[np.bool_]:
    """Which rows have all mapped cells. RecordingError if one hasn't, unless the mapping says to skip it."""
    absent = {quantity: np.isnan(values) for quantity, values in table.items()}
    kept = ~np.any(list(absent.values()), axis=0)
    if kept.all():
        return np.asarray(kept)
    counts = [
        f"{mapping.columns[quantity].name!r} has {rows.sum()} (first in line"
        f" {lines[int(np.argmax(rows))][0]})"
        for quantity, rows in absent.items()
        if rows.any()
    ]
    if not kept.any():
        raise RecordingError(
            f"{path}: expected rows with numbers, found an empty or NaN cell in each: {', '.join(counts)};"
            " leave that quantity out with --without"
        )
    if not mapping.skip_missing:
        raise RecordingError(
            f"{path}: expected a number in every mapped cell, found empty or NaN ones: {', '.join(counts)};"
            " say --missing skip to leave these rows out"
        )
    return np.asarray(kept)


def _times(path: Path, lines: _Lines, position: int, mapping: LogMapping) -> IntArray:
    """Time of each row [ns since 1970]."""
    clock = mapping.clock
    if clock.rate is not None:
        steps = np.rint(np.arange(len(lines)) * (1e9 / clock.rate)).astype(np.int64)
        return np.asarray(mapping.start_time_ns + steps)
    times: list[int] = []
    for line, cells in lines:
        cell = cells[position].strip() if position < len(cells) else ""
        where = f"{path}: line {line}, column {clock.column!r}"
        time = _nanoseconds(cell, clock.unit)
        if time is None:
            raise RecordingError(
                f"{where}: expected a time in {clock.unit}, found {cell[:40]!r}; repair that line"
            )
        if times and time <= times[-1]:
            raise RecordingError(
                f"{where}: expected a later time than in the row before, found {cell}; sort the rows, keep"
                " each once"
            )
        times.append(time)
    offset = mapping.start_time_ns - times[0] if clock.zero == "first_row" else 0
    first, last = times[0] + offset, times[-1] + offset
    if not 0 < first <= last < LAST_STAMP_NS:
        raise RecordingError(
            f"{path}: expected times from 1970 to 2038, found {first} to {last} ns;"
            f" check unit and zero of column {clock.column!r} in the mapping"
        )
    return np.array(times, dtype=object).astype(np.int64) + offset


def _nanoseconds(cell: str, unit: str) -> int | None:
    """A time exactly: a float would have no nanoseconds left since 1970. None if it isn't one."""
    try:
        value = Decimal(cell)
        return round(value * TIME_UNITS_NS[unit]) if value.is_finite() and abs(value) < 10**20 else None
    except ArithmeticError:  # not a number, or one beyond all bounds
        return None


def _in_model_units(quantity: str, values: FloatArray, mapping: LogMapping) -> FloatArray:
    """Column in SI units and SAE signs."""
    column, axis = mapping.columns[quantity], QUANTITIES[quantity].axis
    factor = UNITS[QUANTITIES[quantity].kind][column.unit] * column.sign
    if column.frame == "rep103" and axis is not None:
        factor *= float(flip_axes(np.ones(3))[axis])
    return np.asarray(values * factor)

"""The columns of a logger's CSV, read with a mapping that says what they mean."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import os
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tms_model.frames import flip_axes

from tms_bag.conversion import LAST_STAMP_NS
from tms_bag.errors import RecordingError
from tms_bag.logs.mapping import QUANTITIES, TIME_UNITS_NS, UNITS, LogMapping
from tms_bag.samples import FloatArray, IntArray

DELIMITERS = (",", ";", "\t", "|")
LONGEST_HEADER = 2**16  # [characters]
LARGEST_LOG = 2**28  # [bytes]; an hour at 100 Hz has about 40 MB

_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_Lines = Sequence[tuple[int, list[str]]]  # line number and cells of each row


@dataclass(frozen=True, eq=False)
class Log:
    """Columns of a log in SI units and the model's SAE signs."""

    path: Path
    sha256: str
    time_ns: IntArray  # (n,) [ns since 1970]
    columns: dict[str, FloatArray]  # by quantity, (n,) each; NaN where a cell was empty
    delimiter: str = ","
    blank_lines: int = 0  # between the rows: no rows themselves
    missing: dict[str, int] = field(default_factory=dict)  # empty or NaN cells by quantity, if there are some

    def rows_with(self, quantities: Collection[str]) -> NDArray[np.bool_]:
        """Which rows (n,) have a number for one of the quantities."""
        known = [np.isfinite(self.columns[quantity]) for quantity in quantities]
        return np.any(known, axis=0) if known else np.zeros(self.time_ns.size, bool)


def read_csv(log: str | os.PathLike[str], mapping: LogMapping) -> Log:
    """The mapped columns of a CSV file; other columns may hold anything.

    RecordingError with the line and column if a column is missing, a cell isn't a number, or (unless the
    mapping says to skip them) cells are empty or NaN.
    """
    path = Path(log)
    content = _content(path)
    text = _text(path, content)
    delimiter = mapping.delimiter or _delimiter_of(text, _wanted(mapping).values())
    rows = csv.reader(io.StringIO(text), delimiter=delimiter)
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
    mapping = _without_absent(mapping, header)
    positions = _positions(path, header, mapping)
    _check_row_lengths(path, header, lines)
    rows_at, blank = _rows_of(path, lines, mapping)
    lines = [lines[row] for row in rows_at]
    table = {
        quantity: _numbers(path, lines, positions[quantity], column.name, mapping.decimal)
        for quantity, column in mapping.columns.items()
    }
    table = {
        quantity: values
        for quantity, values in table.items()
        if not (mapping.columns[quantity].optional and np.isnan(values).all())
    }
    times = _times(path, lines, rows_at, positions.get("time", 0), mapping)
    _check_missing(path, lines, table, mapping)
    return Log(
        path=path,
        sha256=hashlib.sha256(content).hexdigest(),
        time_ns=times,
        columns={name: _in_model_units(name, values, mapping) for name, values in table.items()},
        delimiter=delimiter,
        blank_lines=blank,
        missing={
            name: int(np.isnan(values).sum()) for name, values in table.items() if np.isnan(values).any()
        },
    )


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
    wanted = _wanted(mapping)
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


def _without_absent(mapping: LogMapping, header: Sequence[str]) -> LogMapping:
    """The mapping without those optional columns that the log doesn't have."""
    there = {
        quantity: column
        for quantity, column in mapping.columns.items()
        if not column.optional or column.name in header
    }
    return replace(mapping, columns=there)


def _wanted(mapping: LogMapping) -> dict[str, str]:
    """Names of the columns by quantity, and of the time."""
    wanted = {quantity: column.name for quantity, column in mapping.columns.items()}
    if mapping.clock.rate is None:
        wanted["time"] = mapping.clock.column
    return wanted


def _delimiter_of(text: str, names: Collection[str]) -> str:
    """Of the usual delimiters the one by which the header has most of these columns; a comma if none has."""
    header = text.partition("\n")[0][:LONGEST_HEADER]

    def found(delimiter: str) -> int:
        cells = next(csv.reader([header], delimiter=delimiter), [])
        return len({cell.strip() for cell in cells} & {*names})

    try:
        return max(DELIMITERS, key=found)  # the first of the best
    except csv.Error:
        return DELIMITERS[0]


def _numbers(path: Path, lines: _Lines, position: int, column: str, decimal: str) -> FloatArray:
    """A column; NaN where a cell is empty, missing or says NaN."""
    values = np.full(len(lines), np.nan)
    for row, (line, cells) in enumerate(lines):
        cell = cells[position].strip() if position < len(cells) else ""
        if not cell:
            continue
        values[row] = number_in(cell, decimal)
        if math.isinf(values[row]):
            remedy = "repair or remove that line"
            if _DECIMAL_COMMA.fullmatch(cell):
                remedy = "say --decimal , (or decimal: ',' in the mapping) if that is a decimal comma"
            raise RecordingError(
                f"{path}: line {line}, column {column!r}: expected a finite number, found {cell[:40]!r};"
                f" {remedy}"
            )
    return values


def number_in(cell: str, decimal: str = ".") -> float:
    """A number or NaN; infinite for everything that isn't one."""
    try:
        if decimal != ".":
            cell = "" if "." in cell else cell.replace(decimal, ".")
        return math.inf if "_" in cell else float(cell)
    except ValueError:
        return math.inf


def _check_missing(path: Path, lines: _Lines, table: dict[str, FloatArray], mapping: LogMapping) -> None:
    """RecordingError if a cell is empty, unless the mapping says to skip these; or if a whole column is."""
    absent = {quantity: np.isnan(values) for quantity, values in table.items()}
    if not np.any(list(absent.values())):
        return
    counts = [
        f"{mapping.columns[quantity].name!r} has {rows.sum()} (first in line"
        f" {lines[int(np.argmax(rows))][0]})"
        for quantity, rows in absent.items()
        if rows.any()
    ]
    empty = [quantity for quantity, rows in absent.items() if rows.all()]
    if empty:
        names = ", ".join(repr(mapping.columns[quantity].name) for quantity in empty)
        flags = " ".join(f"--without {quantity}" for quantity in empty)
        raise RecordingError(
            f"{path}: expected numbers, found only empty or NaN cells in the columns {names}; leave them out"
            f" with {flags}"
        )
    if not mapping.skip_missing:
        raise RecordingError(
            f"{path}: expected a number in every mapped cell, found empty or NaN ones: {', '.join(counts)};"
            " say --missing skip to leave these cells out: each topic then gets the rows that have"
            " something for it"
        )


def _rows_of(path: Path, lines: _Lines, mapping: LogMapping) -> tuple[list[int], int]:
    """Which lines are rows, and how many are blank.

    Without a time column a blank line may be a lost row, or none: RecordingError, unless the mapping says to
    skip what is missing; time then goes on over it.
    """
    rows = [number for number, (_, row) in enumerate(lines) if len(row) > 1 or (row and row[0].strip())]
    blank = len(lines) - len(rows)
    if blank and mapping.clock.rate is not None and not mapping.skip_missing:
        first = next(line for line, row in lines if not any(cell.strip() for cell in row))
        raise RecordingError(
            f"{path}: expected a row in each line, found {blank} blank lines (first in line {first}):"
            " without a"
            " time column each may stand for a lost row; remove them, or say --missing skip to let the"
            " time go on"
            " over them"
        )
    return rows, blank


def _times(path: Path, lines: _Lines, rows_at: Sequence[int], position: int, mapping: LogMapping) -> IntArray:
    """Time of each row [ns since 1970]; `rows_at` are its places among all lines."""
    clock = mapping.clock
    if clock.rate is not None:
        steps = np.rint(np.array(rows_at) * (1e9 / clock.rate)).astype(np.int64)
        return np.asarray(mapping.start_time_ns + steps)
    times: list[int] = []
    for line, cells in lines:
        cell = cells[position].strip() if position < len(cells) else ""
        where = f"{path}: line {line}, column {clock.column!r}"
        time = _nanoseconds(cell.replace(",", ".") if mapping.decimal == "," else cell, clock.unit)
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

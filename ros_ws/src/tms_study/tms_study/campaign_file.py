"""The CSV of a campaign: a row per strike, written run by run, so that an interrupted campaign goes on."""

from __future__ import annotations

import csv
import math
import os
from collections import Counter
from dataclasses import fields
from io import StringIO
from pathlib import Path
from typing import Any

from tms_bag import RecordingError
from tms_model.atomic_write import atomic_write

from tms_study.campaign import Campaign, Row

MARK = "campaign"
FIGURES = tuple(field.name for field in fields(Row))[1:]  # after the combination
TEXTS, WHOLE = ("status",), ("seed", "number", "of", "doubted")


class CampaignFile:
    """Rows on the disk.

    Raises RecordingError for a file of something else, or of a campaign with other settings; ParameterError
    for a place that can't be written.
    """

    def __init__(self, path: Path, campaign: Campaign) -> None:
        self._path, self._mark, self._keys = path, campaign.mark, tuple(campaign.varied)
        self._header = [MARK, *self._keys, *FIGURES]
        if not path.absolute().parent.is_dir():
            raise RecordingError(f"-o: expected a file in a folder that exists, found {path}")
        self.rows = self._read() if path.exists() else []
        atomic_write(path, _text([self._header, *map(self._cells, self.rows)]).encode())

    def add(self, rows: list[Row]) -> None:
        """Append the rows of a run; they are on the disk when this returns. Raises RecordingError if not."""
        try:
            with self._path.open("a", encoding="utf-8", newline="") as stream:
                stream.write(_text(map(self._cells, rows)))
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            raise RecordingError(
                f"{self._path}: can't be written any further ({error.strerror}); make room, and the same"
                " command goes on from here"
            ) from error

    def _read(self) -> list[Row]:
        """The rows of all runs that were written to their end."""
        try:
            lines = list(csv.reader(StringIO(self._path.read_text(encoding="utf-8"), newline="")))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise RecordingError(f"{self._path}: expected the CSV of a campaign, found: {error}") from error
        if lines and lines[0] != self._header:
            raise RecordingError(
                f"{self._path}: expected the columns {','.join(self._header)}, found another table;"
                " choose another file"
            )
        rows: list[Row] = []
        for number, line in enumerate(lines[1:], start=2):
            if len(line) == len(self._header) and line[0] != self._mark:
                raise RecordingError(
                    f"{self._path}: line {number}: expected rows of this campaign, found one of another"
                    " scenario, fit or version; choose another file"
                )
            try:
                rows.append(self._row(line))
            except (ValueError, IndexError) as error:
                if number < len(lines):  # the last line of a killed campaign may be cut
                    raise RecordingError(
                        f"{self._path}: line {number}: expected {len(self._header)} columns of numbers,"
                        f" found {','.join(line)[:80]!r}"
                    ) from error
        there = Counter((row.combination, row.seed) for row in rows)
        return [row for row in rows if there[row.combination, row.seed] == row.of]

    def _row(self, line: list[str]) -> Row:
        told = dict(zip(self._header, line, strict=True))
        figures: dict[str, Any] = {
            name: told[name]
            if name in TEXTS
            else int(told[name])
            if name in WHOLE
            else float(told[name] or "nan")
            for name in FIGURES
        }
        return Row(tuple(told[key] for key in self._keys), **figures)

    def _cells(self, row: Row) -> list[str]:
        values = [getattr(row, name) for name in FIGURES]
        return [
            self._mark,
            *row.combination,
            *("" if isinstance(value, float) and math.isnan(value) else str(value) for value in values),
        ]


def _text(lines: object) -> str:
    stream = StringIO(newline="")
    csv.writer(stream, lineterminator="\n").writerows(lines)  # type: ignore[arg-type]
    return stream.getvalue()

"""One table, as CSV for machines and as Markdown for people."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

Value = str | float | int | None


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under named columns; None is what does not apply."""

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]

    def write(self, folder: Path) -> None:
        """`name`.csv in the folder."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([_exact(value) for value in row] for row in self.rows)
        (folder / f"{self.name}.csv").write_text(text.getvalue(), encoding="utf-8")

    def markdown(self, *columns: str) -> str:
        """Those of the columns that are named, by default all."""
        chosen = [self.columns.index(name) for name in columns or self.columns]
        lines = [[self.columns[i] for i in chosen], ["---"] * len(chosen)]
        lines += [[_read(row[i]) for i in chosen] for row in self.rows]
        return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)

    def column(self, name: str) -> list[Value]:
        """One column from top to bottom."""
        index = self.columns.index(name)
        return [row[index] for row in self.rows]


def _exact(value: Value) -> Value:
    return round(value, 5) if isinstance(value, float) else "" if value is None else value


def _read(value: Value) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else value

"""Rows of an experiment as tables for a reader: methods down, cases across, one table for each criterion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from binocal.experiments.row import Row

NO_RESULT = "refused"
MOST_ACROSS = 4  # cases beside each other, where one method is alone


@dataclass(frozen=True, slots=True)
class Table:
    """One criterion: a line for each method, with the methods' names first."""

    title: str
    header: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


def tables_of(rows: Sequence[Row], table: str) -> list[Table]:
    """The tables of one part of the page: median (least..greatest) of each case, and what the paper prints."""
    chosen = [row for row in rows if row.table == table]
    criteria = list(dict.fromkeys((row.criterion, row.unit) for row in chosen if row.criterion is not None))
    return [
        _table([row for row in chosen if row.criterion in (criterion, None)], criterion, unit)
        for criterion, unit in criteria
    ]


def _table(rows: list[Row], criterion: str | None, unit: str | None) -> Table:
    cases, methods = (list(dict.fromkeys(getattr(row, key) for row in rows)) for key in ("case", "calibrator"))
    by_place = {(row.calibrator, row.case): row for row in rows}
    printed = [case for case in cases if any(row.paper is not None for row in rows if row.case == case)]
    has_bound = any(row.bound is not None for row in rows)
    if len(methods) == 1 and len(cases) > MOST_ACROSS:
        return _cases_down(rows, _title(criterion, unit))
    lines = []
    for method in methods:
        of_method = [by_place.get((method, case)) for case in cases]
        line = [method, *(_cell(row) for row in of_method)]
        if has_bound:
            bounds = [f"{row.bound:.3g}" for row in of_method if row is not None and row.bound is not None]
            line.append(" / ".join(bounds))
        line += [_paper(by_place.get((method, case))) for case in printed]
        lines.append(tuple(line))
    header = ["method", *cases, *(["bound"] if has_bound else []), *(f"paper, {case}" for case in printed)]
    return Table(_title(criterion, unit), tuple(header), tuple(lines))


def _cases_down(rows: list[Row], title: str) -> Table:
    """One method alone, with a line for each case."""
    columns = [("case", [row.case for row in rows]), (rows[0].calibrator, [_cell(row) for row in rows])]
    if any(row.bound is not None for row in rows):
        columns.append(("bound", ["" if row.bound is None else f"{row.bound:.3g}" for row in rows]))
    if any(row.paper is not None for row in rows):
        columns.append(("paper", [_paper(row) for row in rows]))
    header = tuple(name for name, _ in columns)
    return Table(title, header, tuple(zip(*(cells for _, cells in columns), strict=True)))


def _title(criterion: str | None, unit: str | None) -> str:
    title = f"{criterion}, {unit}" if unit else str(criterion)
    return title[:1].upper() + title[1:]


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    failed = f", {row.failures} of {row.seeds} refused" if row.failures else ""
    if row.median is None:
        return f"{NO_RESULT}{failed}".removeprefix(f"{NO_RESULT}, ") if failed else "not measurable"
    if row.low == row.high:
        return f"{row.median:.3g}{failed}"
    return f"{row.median:.3g} ({row.low:.3g}..{row.high:.3g}){failed}"


def _paper(row: Row | None) -> str:
    if row is None or row.paper is None:
        return ""
    return row.paper if isinstance(row.paper, str) else f"{row.paper:.3g}"


def markdown(table: Table) -> str:
    """A table in Markdown, its title above."""
    lines = [table.header, tuple("---" for _ in table.header), *table.lines]
    return f"**{table.title}**\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines)

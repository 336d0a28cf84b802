"""The page of an experiment, in Markdown and in HTML that needs no other file; the same rows give the same page."""

from __future__ import annotations

import csv
import html
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields

from binocal.experiments.row import Row
from binocal.experiments.tables import Table, markdown, tables_of
from binocal.report.experiment import Span, draw_spans

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 64rem; margin: 2rem auto; padding: 0 1rem; color: #1a1a1a; background: #fff; }
table { border-collapse: collapse; margin: .5rem 0 1.5rem; font-size: 14px; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { border: 1px solid #ccc; padding: .25rem .6rem; text-align: left; font-variant-numeric: tabular-nums; }
th { background: #f2f2f2; }
svg { max-width: 100%; height: auto; }
"""


@dataclass(frozen=True, slots=True)
class Figure:
    """A criterion that is drawn: its name in the rows, the axis, the title, and the name of its file."""

    criterion: str
    axis: str
    title: str
    file: str
    is_log: bool = False


@dataclass(frozen=True, slots=True)
class Part:
    """A part of the page: the table or figure of the paper that it stands for, its heading, what to know, what is drawn.

    ``given`` are drawings that are not made of rows: title by file, left out where there is no such file.
    """

    table: str
    heading: str
    text: str
    figures: tuple[Figure, ...] = ()
    given: Mapping[str, str] = field(default_factory=dict)

    def drawn(self, drawings: Mapping[str, str]) -> Iterator[tuple[str, str]]:
        """Files and titles of the drawings that there are."""
        for file, title in ({f.file: f.title for f in self.figures} | dict(self.given)).items():
            if file in drawings:
                yield file, title


@dataclass(frozen=True, slots=True)
class Page:
    """Title, paragraphs above the parts, the parts, and the rows that they show."""

    title: str
    text: tuple[str, ...]
    parts: tuple[Part, ...]
    rows: tuple[Row, ...]


def page_files(page: Page, given: Mapping[str, str] | None = None) -> dict[str, str]:
    """The files of a page by name: page.md, page.html, the figures, those that are ``given`` too, and rows.csv with every row."""
    drawings = dict(given or {}) | {
        f.file: drawing for part in page.parts for f in part.figures if (drawing := _drawing(page.rows, part.table, f))
    }
    return {
        "page.md": _markdown(page, drawings),
        "page.html": _html(page, drawings),
        "rows.csv": rows_csv(page.rows),
        **drawings,
    }


def rows_csv(rows: Sequence[Row]) -> str:
    """Every row, as a spreadsheet reads it."""
    content = io.StringIO()
    names = [f.name for f in fields(Row)]
    writer = csv.writer(content, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        document = row.document()
        writer.writerow(["" if document[name] is None else document[name] for name in names])
    return content.getvalue()


def _drawing(rows: Sequence[Row], table: str, figure: Figure) -> str:
    """The SVG, or nothing where no row of the part's table has the figure's criterion."""
    spans = [
        Span(
            row.calibrator,
            row.case,
            row.median,
            row.low,
            row.high,
            row.paper if isinstance(row.paper, float | int) else None,
        )
        for row in rows
        if (row.table, row.criterion) == (table, figure.criterion)
        if row.median is not None and row.low is not None and row.high is not None
    ]
    return draw_spans(spans, figure.axis, figure.title, is_log=figure.is_log) if spans else ""


def _markdown(page: Page, drawings: Mapping[str, str]) -> str:
    lines = [f"# {page.title}", *page.text]
    for part in page.parts:
        tables = tables_of(page.rows, part.table)
        if not tables:
            continue
        lines += [f"## {part.heading}", part.text]
        lines += [f"![{title}]({file})" for file, title in part.drawn(drawings)]
        lines += [markdown(table) for table in tables]
    return "\n\n".join(line for line in lines if line) + "\n"


def _html(page: Page, drawings: Mapping[str, str]) -> str:
    body = [f"<h1>{html.escape(page.title)}</h1>", *(_paragraph(text) for text in page.text)]
    for part in page.parts:
        tables = tables_of(page.rows, part.table)
        if not tables:
            continue
        body += [f"<h2>{html.escape(part.heading)}</h2>", _paragraph(part.text)]
        body += [_inline(drawings[file], title) for file, title in part.drawn(drawings)]
        body += [_html_table(table) for table in tables]
    head = f'<meta charset="utf-8"><title>{html.escape(page.title)}</title><style>{STYLE}</style>'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n' + "\n".join(body) + "\n</body></html>\n"


def _paragraph(text: str) -> str:
    """A paragraph of Markdown's plain text, with its `code`."""
    marked = re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))
    return f"<p>{marked}</p>"


def _inline(svg: str, title: str) -> str:
    """The drawing itself, without the head of its file."""
    return f'<figure role="img" aria-label="{html.escape(title)}">{svg[svg.index("<svg") :]}</figure>'


def _html_table(table: Table) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in table.header)
    lines = ["<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in line) + "</tr>" for line in table.lines]
    return f"<table><caption>{html.escape(table.title)}</caption><tr>{head}</tr>\n" + "\n".join(lines) + "</table>"

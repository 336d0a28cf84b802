"""The page of ``binocal report``: one file that asks for nothing from outside, under a strict content security policy."""

from __future__ import annotations

import base64
import hashlib
import json
from importlib import resources
from typing import Any

from binocal import __version__
from binocal.errors import MissingExtraError
from binocal.report.contents import ReportContents
from binocal.report.headline import Headline
from binocal.report.sections import sections_of

TEMPLATE = "report.html.j2"
SCRIPTS = ("tips.js", "scene.js")
STYLE = "report.css"


def require_drawing() -> None:
    """Raises MissingExtraError: Jinja or Matplotlib is not installed. For before the work, not after it."""
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("the report", "report") from error


def report_page(contents: ReportContents, headline: Headline) -> str:
    """The whole page, HTML text; the headline stands first.

    Raises:
        MissingExtraError: Jinja or Matplotlib is not installed.
    """
    require_drawing()
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("binocal.report", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    style = _asset(STYLE)
    scripts = [_asset(name) for name in SCRIPTS]
    environment.filters["json"] = compact_json
    return environment.get_template(TEMPLATE).render(
        contents=contents,
        headline=headline,
        sections=sections_of(contents),
        style=style,
        scripts=scripts,
        policy=content_policy([style], scripts),
        version=__version__,
    )


def compact_json(value: Any) -> str:
    """JSON that may stand in a script element too: it holds no ``<``."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")


def content_policy(styles: list[str], scripts: list[str]) -> str:
    """A content security policy under which only these very texts are styles and scripts, and nothing comes from outside."""
    return "; ".join(
        (
            "default-src 'none'",
            f"style-src {' '.join(_source(text) for text in styles)}",
            f"script-src {' '.join(_source(text) for text in scripts)}",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )


def _source(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _asset(name: str) -> str:
    return resources.files("binocal.report").joinpath("templates", name).read_text(encoding="utf-8")

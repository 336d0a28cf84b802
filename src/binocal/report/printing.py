"""The page as PDF, printed by a browser that is installed: Chromium, Chrome or Edge without a window."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from binocal.errors import DataError, OutputError

NAMES = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge", "microsoft-edge-stable", "msedge",
)  # fmt: skip
PLACES = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)
LIMIT_S = 120.0


def find_browser() -> str:
    """The first browser that can print.

    Raises:
        DataError: There is none; the text says what was looked for.
    """
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    found = found or next((place for place in PLACES if Path(place).is_file()), None)
    if found is None:
        raise DataError(
            "--pdf needs a browser to print with, and none of chromium, chrome and edge was found; install one, or print the page."
        )
    return found


def page_as_pdf(page: str, browser: str) -> bytes:
    """The page printed.

    Raises:
        OutputError: The browser failed.
    """
    with tempfile.TemporaryDirectory(prefix="binocal-print-") as name:
        folder = Path(name)
        source, printed = folder / "report.html", folder / "report.pdf"
        source.write_text(page, encoding="utf-8")
        command = [
            browser, "--headless", "--disable-gpu", "--no-first-run", "--no-pdf-header-footer", f"--user-data-dir={folder / 'profile'}",
            f"--print-to-pdf={printed}", source.as_uri(),
        ]  # fmt: skip
        if sys.platform == "linux" and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # which browsers refuse to run with as root; the page is our own
        try:
            done = subprocess.run(command, capture_output=True, timeout=LIMIT_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise OutputError("the PDF", f"{browser} failed: {type(error).__name__}") from None
        if not printed.is_file() or not printed.read_bytes().startswith(b"%PDF"):
            raise OutputError("the PDF", f"{browser} ended with code {done.returncode} and printed none")
        return printed.read_bytes()

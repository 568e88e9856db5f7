# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The report as PDF, printed by an installed Chromium with the page's own style for paper."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from finger_common.cli import plain
from finger_common.errors import InputError
from finger_common.files import atomic_write

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
OPTIONS = (
    "--headless",
    "--disable-gpu",
    "--disable-extensions",
    "--disable-background-networking",
    "--no-first-run",
    "--no-pdf-header-footer",
)
PATIENCE = 300.0
"""s after which the browser is given up."""


def find_browser() -> str:
    """Path of an installed browser; raises InputError when there is none."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise InputError(
            "a PDF needs Chromium or Chrome, and neither is installed; install one (Debian, "
            "Ubuntu: apt install chromium), or leave --pdf out and print report.html"
        )
    return found


def write_pdf(page: Path, browser: str) -> Path:
    """Print an HTML page to a PDF file beside it; gives its path.

    Raises InputError when the browser writes none; an earlier file is kept then.
    """
    path = page.with_suffix(".pdf")
    # Beside the page: a browser in a container of its own may not see the system's /tmp.
    with tempfile.TemporaryDirectory(prefix="pdf_", dir=page.resolve().parent) as folder:
        made = Path(folder) / path.name
        command = [browser, *OPTIONS, f"--user-data-dir={folder}", f"--print-to-pdf={made}"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            # Its sandbox does not run as root; the page is our own.
            command.append("--no-sandbox")
        try:
            done = subprocess.run(
                [*command, page.resolve().as_uri()],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=PATIENCE,
            )
            said = done.stderr.strip()
            content = made.read_bytes() if made.is_file() else b""
        except subprocess.TimeoutExpired:
            said, content = f"no answer within {PATIENCE:g} s", b""
        except OSError as error:
            said, content = str(error), b""
    if not (content.startswith(b"%PDF-") and content.rstrip().endswith(b"%%EOF")):
        reason = plain(said.splitlines()[-1]) if said else "no reason given"
        raise InputError(
            f"{path}: not written, since {browser} printed nothing ({reason}); {page} is complete "
            "and can be printed"
        )
    with atomic_write(path, "wb") as file:
        file.write(content)
    return path

"""Headless Chromium, where it is installed."""

import shutil

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
in_browser = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")


def chromium(*arguments: str) -> list[str]:
    """The command that starts it."""
    return [str(CHROMIUM), *FLAGS, *arguments]

"""What a host may lack. A skip says what; with ROCLOG_NO_SKIPS=1 it is a failure."""

from __future__ import annotations

import os

import pytest


def need(what: str, there: bool) -> None:
    if there:
        return
    if os.environ.get("ROCLOG_NO_SKIPS") == "1":
        pytest.fail(f"this host lacks {what}")
    pytest.skip(f"this host lacks {what}")

"""The independent ROC as a process whose first sample follows the first block a client was sent.

What it completed before anybody was there would be lost by right, and every count in doubt.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[3] / "peers"))

import roc

_FLAG = 300


class PatientSchedule(roc.Schedule):
    """Starts its clock late."""

    def start(self) -> None:
        truth = self._shared.truth
        log, begin = truth.log, super().start

        def watch(event: str, **facts: Any) -> None:
            log(event, **facts)
            if event == "read" and facts.get("address") == _FLAG and facts.get("fate") == "ok":
                truth.log = log  # type: ignore[method-assign]
                begin()

        truth.log = watch  # type: ignore[method-assign]


if __name__ == "__main__":
    roc.Schedule = PatientSchedule  # type: ignore[misc]
    roc.main()

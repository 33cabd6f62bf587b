"""The judge of frames judges: what is spoiled is complained of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from bench.foreign import judge_frames, write_capture

if TYPE_CHECKING:
    from pathlib import Path

REQUEST = bytes.fromhex("8A 03 01 2C 00 01 5A 84")
ANSWER = bytes.fromhex("8A 03 02 00 01 DD 9B")
PORT = 15020


@pytest.mark.parametrize(
    ("answer", "complaints"),
    [
        (ANSWER, 0),
        (ANSWER[:-1] + b"\x9a", 1),
        (ANSWER[:4], 1),
        (b"\x8a\x03", 1),
    ],
)
def test_judge_of_frames(tmp_path: Path, answer: bytes, complaints: int) -> None:
    capture = tmp_path / "frames.pcap"
    write_capture(capture, [(True, REQUEST), (False, answer)], PORT)
    verdict = judge_frames(capture, "mbrtu", PORT)
    assert len(verdict.complaints) == complaints, verdict
    assert verdict.queries == 1

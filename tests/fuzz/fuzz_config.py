"""Feeds damaged configurations to the loader: settings or ConfigError, nothing else.

python tests/fuzz/fuzz_config.py [seconds] [seed]
"""

from __future__ import annotations

import random
import runpy
import sys
import tempfile
import time
from pathlib import Path

_RULES = runpy.run_path(str(Path(__file__).parents[1] / "config" / "test_any_file.py"))
_PIECES = [
    b"=", b"[", b"]]", b"{", b"}", b'"', b"'''", b"\\u0000", b"\\U0010ffff", b"\n", b"\r", b"\0",
    b"\xff", b"#", b",", b".", b"-", b"true", b"inf", b"nan", b"0x7fffffffffffffff", b"1e400",
    b"9" * 30, b"1979-05-27T07:32:00Z", b"devices.roc1", b"[[devices]]", b"hiac-roc", b"log",
    b'"5 chars"', b'"0s"', b'"99999999999999999999d"', b'"../../etc"', b"\xe2\x80\xae", b"[" * 2000,
]  # fmt: skip


def damaged(source: random.Random) -> bytes:
    """A valid configuration with one to six random changes."""
    octets = bytearray("\n".join(_RULES["VALID"]).encode())
    for _ in range(source.randint(1, 6)):
        start = source.randrange(len(octets) + 1)
        end = min(len(octets), start + source.choice([0, 1, 2, 10, 50]))
        action = source.randrange(4)
        if action == 0:
            octets[start:end] = source.choice(_PIECES)
        elif action == 1:
            octets[start:end] = source.randbytes(end - start)
        elif action == 2:
            octets[start:start] = octets[start:end]
        else:
            del octets[start:end]
    return bytes(octets)


def main(seconds: float, seed: int) -> None:
    source = random.Random(seed)
    counts = {True: 0, False: 0}
    end = time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "roclog.toml"
        while time.monotonic() < end:
            octets = damaged(source)
            path.write_bytes(octets)
            try:
                counts[_RULES["judge"](path)] += 1
            except BaseException:
                print(f"seed {seed}, after {sum(counts.values())} files: {octets!r}")
                raise
    print(f"seed {seed}: {counts[True]} accepted, {counts[False]} refused, no other outcome")


if __name__ == "__main__":
    arguments = [*sys.argv[1:], *("10", "1")[len(sys.argv) - 1 :]]
    main(float(arguments[0]), int(arguments[1]))

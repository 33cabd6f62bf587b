"""Damage recordings at random and read them: only documented errors, never a wrong sample.

    python tests/fuzz/fuzz_reader.py [SECONDS] [SEED]

A finding is written to fuzz-finding.mcap with the seed that made it.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "reading" / "lib"))

import mcapfiles as files
from mcap.writer import CompressionType
from mcapfiles import SECOND, T0

from roclog.errors import DamagedFile
from roclog.recording import segment_reader
from roclog.recording.reader import open_recording

ITEMS = [
    files.event(T0),
    *(files.sample(seq) for seq in range(1, 9)),
    files.clear(8, T0 + 9 * SECOND),
    files.gap(T0 + 10 * SECOND, T0, T0 + SECOND),
    files.link(T0 + 60 * SECOND),
]
FRAGMENTS = [b"\x89MCAP0\r\n", *(bytes([n]) + bytes(8) for n in range(1, 16)), b"\xff" * 8]


def mutate(octets: bytes, dice: random.Random) -> bytes:
    """One to four changes: bits, octets, lengths, copies, cuts."""
    spoiled = bytearray(octets)
    for _ in range(dice.choice([1, 1, 1, 2, 4])):
        at = dice.randrange(len(spoiled))
        match dice.randrange(7):
            case 0 | 1:
                spoiled[at] ^= 1 << dice.randrange(8)
            case 2:
                spoiled[at : at + 8] = dice.choice(
                    [0, 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1, dice.randrange(1000)]
                ).to_bytes(8, "little")
            case 3:
                spoiled[at:at] = dice.choice(FRAGMENTS)
            case 4:
                source = dice.randrange(len(spoiled))
                spoiled[at:at] = spoiled[source : source + dice.randrange(400)]
            case 5:
                del spoiled[at : at + dice.randrange(1, 400)]
            case 6:
                del spoiled[max(1, at) :]
    return bytes(spoiled)


def seeds(folder: Path) -> list[bytes]:
    found = [files.hot_octets([[item] for item in ITEMS]), files.hot_octets([ITEMS])]
    for compression in CompressionType:
        for size in (1, 700, 10**6):
            path = files.write_sealed(
                folder / "seed.mcap", ITEMS, compression=compression, chunk_size=size
            )
            found.append(path.read_bytes())
    return found


def main(seconds: float, seed: int) -> int:
    segment_reader.PATIENCE = 0.0  # type: ignore[misc]
    end = time.monotonic() + seconds
    count = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recordings = seeds(folder)
        whole = list(open_recording(folder / "seed.mcap").records())
        while time.monotonic() < end:
            dice = random.Random(seed + count)
            octets = mutate(dice.choice(recordings), dice)
            path = folder / dice.choice(["hot", "cold"]) / "1.mcap"
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(octets)
            try:
                recording = open_recording(path)
                wrong = [record for record in recording.records() if record not in whole]
                trouble = f"{len(wrong)} wrong records" if wrong else ""
            except DamagedFile:
                trouble = ""
            except Exception as error:  # noqa: BLE001 - this is what is looked for
                trouble = repr(error)
            if trouble:
                Path("fuzz-finding.mcap").write_bytes(octets)
                print(f"seed {seed + count}: {trouble}")
                return 1
            count += 1
    print(f"{count} damaged recordings read, no finding")
    return 0


if __name__ == "__main__":
    arguments = sys.argv[1:]
    sys.exit(
        main(
            float(arguments[0]) if arguments else 10.0,
            int(arguments[1]) if len(arguments) > 1 else random.randrange(2**31),
        )
    )

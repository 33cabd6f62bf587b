"""Whatever happens to a file: no exception but the documented one, and never a wrong sample."""

from __future__ import annotations

import random
import resource
import struct
from typing import TYPE_CHECKING

import mcapfiles as files
import pytest
import zstandard
from mcapfiles import SECOND, T0

from roclog.errors import DamagedFile
from roclog.recording.reader import Recording, open_recording
from roclog.recording.records import Sample

if TYPE_CHECKING:
    from pathlib import Path

TOPICS = [topic for topic in files.TOPICS if topic.topic in ("/roc1/sample", "/roc1/gap")]
ITEMS = [*(files.sample(seq) for seq in range(1, 5)), files.gap(T0 + 9 * SECOND, T0, T0 + SECOND)]


def hot_octets() -> bytes:
    return files.hot_octets([[item] for item in ITEMS], topics=TOPICS)


def sealed_octets(tmp_path: Path, chunk_size: int = 200) -> bytes:
    path = files.write_sealed(tmp_path / "s.mcap", ITEMS, topics=TOPICS, chunk_size=chunk_size)
    return path.read_bytes()


def read(path: Path, octets: bytes) -> tuple[list[object], Recording | None]:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(octets)
    try:
        recording = open_recording(path)
    except DamagedFile:
        return [], None
    return list(recording.records()), recording


def truth(tmp_path: Path) -> list[object]:
    path = files.write_sealed(tmp_path / "t.mcap", ITEMS, topics=TOPICS)
    return list(open_recording(path).records())


def is_part(found: list[object], whole: list[object]) -> bool:
    """Whether ``found`` is ``whole`` with some left out."""
    rest = iter(whole)
    return all(record in rest for record in found)


def test_a_hot_segment_cut_at_every_octet(tmp_path: Path) -> None:
    whole, octets = truth(tmp_path), hot_octets()
    path = tmp_path / "hot" / "1.mcap"
    path.parent.mkdir()
    starts = [
        len(files.hot_octets([[item] for item in ITEMS[:n]], topics=TOPICS)) for n in range(6)
    ]
    for size in range(len(octets)):
        found, recording = read(path, octets[:size])
        complete = sum(1 for end in starts[1:] if end <= size)
        assert found == whole[:complete], size
        if recording is not None and size not in starts and size > starts[0]:
            (problem,) = recording.damage
            assert problem.path == path
            assert problem.offset <= size


@pytest.mark.parametrize("chunk_size", [200, 10**6])
def test_a_sealed_segment_cut_at_every_octet(tmp_path: Path, chunk_size: int) -> None:
    whole, octets = truth(tmp_path), sealed_octets(tmp_path, chunk_size)
    for size in range(0, len(octets), 3):
        found, recording = read(tmp_path / "cut.mcap", octets[:size])
        assert is_part(found, whole)
        if recording is not None:
            assert recording.damage or found == whole


@pytest.mark.parametrize("kind", ["hot", "sealed"])
def test_a_single_flipped_bit(tmp_path: Path, kind: str) -> None:
    """All bits would take minutes here; the fuzzer goes on with the rest."""
    whole = truth(tmp_path)
    octets = hot_octets() if kind == "hot" else sealed_octets(tmp_path)
    path = tmp_path / kind / "1.mcap"
    for bit in range(3, 8 * len(octets), 11):
        flipped = bytearray(octets)
        flipped[bit // 8] ^= 1 << bit % 8
        found, recording = read(path, bytes(flipped))
        assert is_part(found, whole), bit
        if recording is not None and found != whole:
            assert recording.damage, bit


def test_every_bit_of_the_frames_between_chunks(tmp_path: Path) -> None:
    """Opcodes, lengths and chunk heads stand outside every checksum."""
    whole, octets = truth(tmp_path), hot_octets()
    path = tmp_path / "hot" / "1.mcap"
    begin = len(files.hot_octets([[ITEMS[0]]], topics=TOPICS))
    for bit in range(8 * begin, 8 * (begin + 9 + 40)):
        flipped = bytearray(octets)
        flipped[bit // 8] ^= 1 << bit % 8
        found, recording = read(path, bytes(flipped))
        assert recording is not None
        assert is_part(found, whole), bit
        assert found == whole or recording.damage, bit


@pytest.mark.parametrize("kind", ["hot", "sealed"])
def test_octets_at_random(tmp_path: Path, kind: str) -> None:
    whole = truth(tmp_path)
    octets = hot_octets() if kind == "hot" else sealed_octets(tmp_path)
    dice = random.Random(7)
    for _ in range(300):
        spoiled = bytearray(octets)
        at = dice.randrange(len(spoiled))
        size = dice.choice([1, 4, 64, 512])
        spoiled[at : at + size] = dice.randbytes(min(size, len(spoiled) - at))
        found, _ = read(tmp_path / kind / "1.mcap", bytes(spoiled))
        assert is_part(found, whole)


def test_zeros_behind_the_end(tmp_path: Path) -> None:
    found, recording = read(tmp_path / "hot" / "1.mcap", hot_octets() + bytes(5000))
    assert recording is not None
    assert len(found) == len(ITEMS)
    assert "opcode 0" in str(recording.damage[0])


def test_a_damaged_chunk_costs_only_its_own_samples(tmp_path: Path) -> None:
    octets = bytearray(hot_octets())
    begin = len(files.hot_octets([[ITEMS[0]]], topics=TOPICS))
    octets[begin + 80] ^= 1
    found, recording = read(tmp_path / "hot" / "1.mcap", bytes(octets))
    assert recording is not None
    assert [r.seq for r in found if isinstance(r, Sample)] == [1, 3, 4]
    assert [(d.offset, d.reason) for d in recording.damage] == [
        (begin, "a chunk whose checksum is wrong")
    ]
    assert recording.missing == [("/roc1/sample", files.EPOCH, 2, 2)]


def test_the_definitions_are_taken_from_the_summary_if_their_chunk_is_damaged(
    tmp_path: Path,
) -> None:
    octets = bytearray(sealed_octets(tmp_path))
    octets[octets.index(b"\x28\xb5\x2f\xfd") + 40] ^= 0xFF
    found, recording = read(tmp_path / "a.mcap", bytes(octets))
    assert recording is not None
    assert is_part(found, truth(tmp_path))
    assert len(found) == len(ITEMS) - 1
    assert len(recording.damage) == 1


def test_metadata_with_a_wrong_checksum_is_damage(tmp_path: Path) -> None:
    metadata = files.facts()
    metadata["roclog.device.roc1"]["unit"] = "139"
    path = files.write_sealed(tmp_path / "a.mcap", ITEMS, metadata=metadata)
    recording = open_recording(path)
    assert len(list(recording)) == 4
    assert "roclog.device.roc1" in str(recording.damage[0])
    assert recording.devices == {}


def test_a_recording_goes_on_behind_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    files.write_sealed(tmp_path / "b.mcap", ITEMS)
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + b"\x06" + struct.pack("<Q", 2**36))
    (tmp_path / "c.mcap").write_bytes(b"not MCAP")
    recording = open_recording(tmp_path)
    assert len(list(recording)) == 4
    assert [d.path.name for d in recording.damage] == ["a.mcap", "c.mcap"]


def zstd_bomb(size: int) -> bytes:
    return zstandard.ZstdCompressor(level=19).compress(bytes(size))


HOSTILE = {
    "record of 64 GiB": b"\x06" + struct.pack("<Q", 64 * 2**30) + bytes(64),
    "record of 2^64-1": b"\x06" + struct.pack("<Q", 2**64 - 1) + bytes(64),
    "chunk of 64 GiB": files.chunk(b"x", 0, 0, uncompressed_size=64 * 2**30, compression="zstd"),
    "zstd bomb": files.chunk(
        zstd_bomb(300 * 2**20), 0, 0, uncompressed_size=30 * 2**20, compression="zstd"
    ),
    "zstd garbage": files.chunk(b"\x28\xb5\x2f\xfd" + b"\xff" * 64, 0, 0, compression="zstd"),
    "lz4 garbage": files.chunk(b"\x04\x22\x4d\x18" + b"\xff" * 64, 0, 0, compression="lz4"),
    "unknown compression": files.chunk(b"x", 0, 0, compression="rot13"),
    "bad UTF-8 in metadata": b"\x0c" + struct.pack("<QI", 12, 4) + b"\xff\xfe\xfd\xfc" + bytes(4),
    "metadata of 4 GiB": b"\x0c" + struct.pack("<QII", 8, 0, 2**32 - 1),
    "record inside a chunk too long": files.chunk(b"\x05" + struct.pack("<Q", 2**63), 0, 0),
    "message without a head": files.chunk(b"\x05" + struct.pack("<Q", 3) + b"abc", 0, 0),
    "channel without an end": files.chunk(b"\x04" + struct.pack("<QHHI", 8, 1, 1, 2**31), 0, 0),
    "schema that is none": files.chunk(b"\x03" + struct.pack("<Q", 1) + b"\x01", 0, 0),
    "chunk without checksum": files.chunk(b"\x05" + struct.pack("<Q", 0), 0, 0, uncompressed_crc=0),
    "opcode of nobody": b"\x77" + struct.pack("<Q", 4) + b"abcd",
    "message outside a chunk": b"\x05" + struct.pack("<QHIQQ", 22, 2, 1, T0, T0),
    "zeros": bytes(100),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_records(tmp_path: Path, name: str) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    octets = files.hot_octets([ITEMS[:2]], topics=TOPICS) + HOSTILE[name]
    found, recording = read(tmp_path / "hot" / "1.mcap", octets)
    assert recording is not None
    assert found == truth(tmp_path)[:2]
    assert recording.damage
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 * 1024


def test_footer_with_a_tail_that_never_ends(tmp_path: Path) -> None:
    path = tmp_path / "s.mcap"
    path.write_bytes(sealed_octets(tmp_path))
    with path.open("r+b") as file:
        file.truncate(2**33)
    recording = open_recording(path)
    assert len(list(recording)) == 4
    assert "no MCAP magic" in str(recording.damage[0])


def test_a_message_that_is_not_of_its_schema(tmp_path: Path) -> None:
    bad = files.Item("/roc1/sample", T0 + 2, b"\xff\xff\xff")
    recording = open_recording(files.write_sealed(tmp_path / "a.mcap", [ITEMS[0], bad, ITEMS[1]]))
    assert [sample.seq for sample in recording] == [1, 2]
    assert "/roc1/sample: not a message of its schema" in str(recording.damage[0])

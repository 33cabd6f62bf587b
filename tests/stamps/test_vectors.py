"""Every stamp of tests/vectors/stamps: to its time and flags, by us and by the second decoder."""

from __future__ import annotations

import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import stamp_oracle

from roclog.decode import TimeFlag as RecordedTimeFlag
from roclog.stamps import StampDecoder, Weekday, encode_stamp, parse_zone, weekday_of
from roclog.time_flags import TimeFlag

PATH = Path(__file__).parents[1] / "vectors/stamps/stamps.toml"
VECTORS: list[dict[str, Any]] = tomllib.loads(PATH.read_text(encoding="utf-8"))["stamp"]
EACH = pytest.mark.parametrize(
    "vector", VECTORS, ids=[f"{n}-{v['source'][:70]}" for n, v in enumerate(VECTORS)]
)
KEYS = {
    "source", "octets", "device_time", "flags", "zone", "year_pivot", "lenient", "read_at",
    "changed_after", "weekday",
}  # fmt: skip
NOW = "2026-11-23T12:00:00Z"


def ns(text: str | None) -> int | None:
    if text is None:
        return None
    moment = datetime.fromisoformat(text)
    assert moment.tzinfo == UTC
    return int(moment.replace(microsecond=0).timestamp()) * 10**9 + moment.microsecond * 1000


def host(vector: dict[str, Any]) -> dict[str, Any]:
    return {
        "read_at": ns(vector.get("read_at", NOW)),
        "changed_after": ns(vector.get("changed_after")),
    }


def expected(vector: dict[str, Any]) -> tuple[int, set[str]]:
    return (ns(vector["device_time"]) if vector["device_time"] else 0) or 0, set(vector["flags"])


@EACH
def test_decodes(vector: dict[str, Any]) -> None:
    assert vector.keys() <= KEYS
    octets = bytes.fromhex(vector["octets"])
    decoder = StampDecoder(
        parse_zone(vector.get("zone", "UTC")),
        year_pivot=vector.get("year_pivot", 70),
        lenient=vector.get("lenient", False),
    )
    stamp = decoder.decode(octets, **host(vector))
    found = {str(flag.name).lower() for flag in stamp.flags}
    assert (stamp.device_time, found) == expected(vector)
    assert stamp.octets == octets
    assert decoder.decode(octets, **host(vector)) == stamp, "from memory"


@EACH
def test_the_second_decoder_agrees(vector: dict[str, Any]) -> None:
    found = stamp_oracle.decode(
        bytes.fromhex(vector["octets"]),
        vector.get("zone", "UTC"),
        pivot=vector.get("year_pivot", 70),
        lenient=vector.get("lenient", False),
        **host(vector),
    )
    assert found == expected(vector)


@EACH
def test_encodes(vector: dict[str, Any]) -> None:
    """A stamp without a fault is what the encoder makes of its time."""
    harmless = {"su", "time_ambiguous", "future", "date_inferred"}
    if not vector["device_time"] or not set(vector["flags"]) <= harmless:
        return
    octets = bytes.fromhex(vector["octets"])
    instant, _ = expected(vector)
    encoded = encode_stamp(
        instant,
        parse_zone(vector.get("zone", "UTC")),
        size=len(octets),
        year_pivot=vector.get("year_pivot", 70),
        weekday=Weekday(vector.get("weekday", "unused")),
    )
    assert encoded == octets


@pytest.mark.parametrize(
    "vector", [v for v in VECTORS if "weekday" in v], ids=lambda v: v["octets"]
)
def test_weekday(vector: dict[str, Any]) -> None:
    ways = [way.value for way in weekday_of(bytes.fromhex(vector["octets"]))]
    assert ways == ([vector["weekday"]] if vector["weekday"] else [])


def test_flag_numbers_are_for_ever() -> None:
    assert {flag.name.lower(): flag.value for flag in TimeFlag if flag.name} == stamp_oracle.NAMES
    assert RecordedTimeFlag is TimeFlag


def test_every_flag_of_a_stamp_has_a_vector() -> None:
    seen = {flag for vector in VECTORS for flag in vector["flags"]}
    assert seen == set(stamp_oracle.NAMES) - {"layout_ambiguous"}, "the PDU's own flag"

"""The map against what the manual prints; see the package for its title and address."""

from __future__ import annotations

from roclog_met_one import REGISTER_MAP

from roclog.testing import Vector, check_register_map, decode_block, request_pdu

VECTORS = [
    Vector(
        'table 16, note 1: 0x3838, 0x3031 and 0x0000 are the model number "8801"',
        "identity",
        {15: "3838 3031 0000"},
        {"model": "8801"},
    ),
    Vector(
        "table 16, 38 and 39: 100 = V1.00",
        "identity",
        {38: f"{100:04X} {100:04X}"},
        {"firmware_version": 1.0, "hardware_version": 1.0},
    ),
    Vector(
        "table 19: the upper ends of month (12), day (31), hour (23), minute and second (59)",
        "sample",
        {500: f"{9999:04X} {12:02X}{31:02X} {23:04X} {59:02X}{59:02X} {23:04X} {59:02X}{59:02X}"},
        {
            "year": 9999,
            "day": 1231,
            "hour": 23,
            "time": 59 * 60 + 59,
            "period_hours": 23,
            "period": 59 * 60 + 59,
        },
    ),
    Vector(
        "table 19: counts up to 4,294,967,295; temperature in 0.1 degrees, humidity in 0.1 %",
        "sample",
        {511: "FFFF FFFF", 544: f"{215:04X} {503:04X}"},
        {"count_1": 4294967295, "temperature": 21.5, "humidity": 50.3},
    ),
]


def test_the_map_and_what_the_manual_prints() -> None:
    check_register_map(REGISTER_MAP, VECTORS)


def test_the_time_of_a_record() -> None:
    values = decode_block(REGISTER_MAP, "sample", {500: "07EA 0B17 0006 0005"})
    assert values["device_time"] == "2026-11-23T06:00:05Z"


def test_a_record_is_one_request_for_registers_500_to_547() -> None:
    assert request_pdu(REGISTER_MAP, "sample").hex(" ") == "03 01 f4 00 30"

"""Inputs with time stamps: which requests read a list, and what their answers say.

The document ("A technique for implementation of Time Stamping of Data using the MODBUS Encapsulated
Interface Transport") tabulates registers as all values, then all stamps, and prints examples with
each value before its stamp. Both have the same length, so an answer alone cannot always tell which
it is. Here a stamp is so many octets; what they mean is another module's matter.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from roclog.modbus.request import ReadStamped

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from roclog.modbus.request import Mei


class Layout(StrEnum):
    """Order of values and stamps in an answer about registers."""

    INTERLEAVED = "interleaved"
    """Value, stamp, value, stamp: the examples."""
    GROUPED = "grouped"
    """All values, then all stamps: the tables."""


@dataclass(frozen=True, slots=True)
class StampedPoint:
    """One input as it was answered.

    value: 0 or 1 of a discrete input, 0 to 65535 of a register. stamp: 4 or 7 octets.
    """

    address: int
    value: int
    stamp: bytes


@dataclass(frozen=True, slots=True)
class StampedAnswer:
    """All inputs of one answer.

    spare_bits: what stands in the last status octet above the last input, moved down to bit 0;
    anything but 0 contradicts the specification and takes nothing from the values.
    """

    points: tuple[StampedPoint, ...]
    spare_bits: int = 0


def split(mei: Mei, address: int, count: int) -> tuple[ReadStamped, ...]:
    """The fewest requests that read ``count`` inputs from ``address`` on.

    Raises:
        ValueError: no inputs, or inputs that do not exist.
    """
    if count < 1 or not 0 <= address <= 0x10000 - count:
        raise ValueError(f"{count} inputs from {address} on do not exist")
    end = address + count
    return tuple(
        ReadStamped(mei, start, min(mei.most, end - start))
        for start in range(address, end, mei.most)
    )


def parse(request: ReadStamped, pdu: bytes, layout: Layout = Layout.INTERLEAVED) -> StampedAnswer:
    """Take a checked answer apart. Discrete inputs have one layout only."""
    if request.mei.is_discrete:
        return _discrete(request, pdu)
    octets = pdu[3:]
    size = request.mei.stamp_size
    values, stamps = (2, 2 * request.count) if layout is Layout.GROUPED else (2 + size, 2)
    stamp_step = size if layout is Layout.GROUPED else 2 + size
    points = []
    for i in range(request.count):
        (value,) = struct.unpack_from(">H", octets, i * values)
        start = stamps + i * stamp_step
        points.append(StampedPoint(request.address + i, value, octets[start : start + size]))
    return StampedAnswer(tuple(points))


def _discrete(request: ReadStamped, pdu: bytes) -> StampedAnswer:
    size = request.mei.stamp_size
    status = int.from_bytes(pdu[4 : 4 + request.status_size], "little")
    stamps = pdu[5 + request.status_size :]
    points = tuple(
        StampedPoint(request.address + i, status >> i & 1, stamps[i * size : (i + 1) * size])
        for i in range(request.count)
    )
    return StampedAnswer(points, spare_bits=status >> request.count)


def plausible_layout(
    request: ReadStamped, pdu: bytes, is_plausible: Callable[[bytes], bool]
) -> Layout | None:
    """The one layout in which every stamp of a checked answer is plausible.

    None: they are in both, or in neither; so always with one register or discrete inputs. Then the
    answer says nothing about the layout.
    """
    fits = [
        layout
        for layout in Layout
        if all(is_plausible(point.stamp) for point in parse(request, pdu, layout).points)
    ]
    return fits[0] if len(fits) == 1 else None


class LayoutProbe:
    """Finds the layout by asking: one register, then it and its neighbour, then the one again.

    An answer about one register is the same in both layouts. Where it is the same before and after,
    the register held that value and stamp in between as well, so the layout that does not show them
    is the wrong one; no clock and no knowledge of stamps is needed. Send ``request`` and ``take``
    its checked answer until ``request`` is None; ``skip`` where the device refuses it.

    addresses: first registers of the pairs to ask for, in order, until one of them decides.
    attempts: how often a pair is asked for whose first register changes meanwhile.
    layout: None until it is known, and where no pair decided: then the answers are ambiguous.

    Raises:
        ValueError: a MEI type of discrete inputs, or registers that do not exist.
    """

    def __init__(self, mei: Mei, addresses: Iterable[int], attempts: int = 3) -> None:
        if mei.is_discrete:
            raise ValueError("discrete inputs have one layout only")
        self.layout: Layout | None = None
        self._pairs = [
            (ReadStamped(mei, address, 1), ReadStamped(mei, address, 2)) for address in addresses
        ]
        self._attempts = attempts
        self._left = attempts
        self._before: bytes | None = None
        self._both: bytes | None = None

    @property
    def request(self) -> ReadStamped | None:
        """What to send next; None when the probe is over."""
        if self.layout is not None or not self._pairs:
            return None
        one, two = self._pairs[0]
        return two if self._before is not None and self._both is None else one

    def take(self, pdu: bytes) -> None:
        """The checked answer to ``request``."""
        if self._before is None:
            self._before = pdu
        elif self._both is None:
            self._both = pdu
        elif pdu == self._before:
            self._decide(self._before, self._both)
        else:
            self._before, self._both = pdu, None
            self._left -= 1
            if not self._left:
                self.skip()

    def skip(self) -> None:
        """Go on to the next pair: this one cannot be read."""
        del self._pairs[:1]
        self._before = self._both = None
        self._left = self._attempts

    def _decide(self, alone: bytes, both: bytes) -> None:
        one, two = self._pairs[0]
        known = parse(one, alone).points[0]
        fits = [layout for layout in Layout if parse(two, both, layout).points[0] == known]
        if len(fits) == 1:
            self.layout = fits[0]
        else:
            self.skip()

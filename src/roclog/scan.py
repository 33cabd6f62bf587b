"""Finds the units on one connection: ``scan``.

Every unit is asked with function 17, Report Server ID, and anything intact that comes back proves
that it is there. A conforming device answers a function that it lacks with exception 1 before it
looks at any data (Application Protocol V1.1b3, figure 9 and section 7). Why this function:

- The request is the function code alone. It names no address that a read could act upon or clear,
  and carries nothing that could be taken for data. Servers that do not know how long the request of
  a function is that they lack stay in step; behind function 43 libmodbus loses the next request.
- Function 8 is answered with its own request, which an adapter with local echo gives for every
  unit. A read of registers may act or clear; one that is malformed asks for trouble.
- The standard has function 17 for serial lines only. A TCP or UDP server refuses it then, which
  proves as much.

Seen to be missed: a server of npm's modbus-serial, which leaves this function unanswered, and one
of libmodbus on a line, asked 0.3 s after a unit that is not there (after 0.6 s it answers).

Units of a hiac-roc are asked for their identity instead, as `check --probe` does. When all have
been asked, those that answered and are not configured are asked for their device identification,
function 43 with MEI type 14, over TCP each on a connection of its own.

Exceptions 10 and 11 are a gateway's, and say that nobody answers behind it (section 7).
"""

from __future__ import annotations

import asyncio
import socket
from dataclasses import dataclass, replace
from enum import Enum
from math import inf
from typing import TYPE_CHECKING, Final

from roclog.bus.tally import Tally
from roclog.bus.timing import Framing
from roclog.connect import make_bus
from roclog.decode import decode
from roclog.devices import hiac_roc
from roclog.errors import GATEWAY_CODES, DeviceError, ExceptionAnswer, LinkDown, WrongAnswer
from roclog.modbus.identification import (
    ReadDeviceIdentification,
    ReportServerId,
    objects,
    server_id,
    server_text,
)
from roclog.modbus.request import EXCEPTION_BIT
from roclog.request_plan import read_request
from roclog.word_types import block_words

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from roclog.bus.bus import Bus
    from roclog.clock import Clock
    from roclog.config.settings import Connection, Device, Settings
    from roclog.modbus.request import Request

SERIAL_UNITS: Final = range(1, 248)
"""Modbus over Serial Line V1.02, section 2.2; 0 is the broadcast, which nobody answers."""
SERVER_UNITS: Final = (0, *SERIAL_UNITS, 255)
"""Messaging on TCP/IP V1.0b, section 4.4.1.1: 255 and 0 are the server itself."""
_QUESTION: Final = 4
"""Octets of the frame on a line."""
_REOPENING: Final = 0.25, 0.5, 1.0, 1.5
"""Seconds to wait for a link that was lost; the bus tries at least every two."""
_MOST_LOSSES: Final = 3
_LEAST_ALIKE: Final = 3
_BASIC_OBJECTS: Final = 3


class State(Enum):
    """What is known of a unit."""

    ANSWERS = "answers"
    UNCLEAR = "unclear"
    """Something came, both times, and no intact answer."""
    ABSENT = "absent"
    """A gateway says so."""
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class Finding:
    """What one unit said.

    answer: in words. pdu: of an intact answer. exception: its code. identity: what the unit says
    of itself. identification: objects of function 43/14. devices: of the configuration.
    """

    unit: int
    state: State
    answer: str
    pdu: bytes = b""
    exception: int | None = None
    identity: str = ""
    identification: tuple[tuple[int, str], ...] = ()
    devices: tuple[str, ...] = ()

    @property
    def is_there(self) -> bool:
        return self.state is State.ANSWERS


class Scan:
    """One pass over the units of a connection; ``findings`` grow while it runs.

    problem: why it ended before all units were asked. stray_octets: on a line, beside the answers.
    """

    def __init__(self, bus: Bus, units: Iterable[int], devices: Iterable[Device]) -> None:
        self.units = tuple(sorted(set(units)))
        self.findings: dict[int, Finding] = {}
        self.problem = ""
        self.stray_octets = 0
        self._bus = bus
        self._bus.expects_silence = True
        self._devices = tuple(devices)
        self._is_line = bus.timing.framing is Framing.RTU
        self._was_open = False
        self._silent_at = -inf
        self._losses = 0

    async def run(self, progress: Callable[[str, int, int], None]) -> None:
        """progress: is told what is being done, how much of it is through, and how much it is.

        Raises:
            LinkDown: the connection cannot be opened; nothing was sent.
        """
        try:
            for count, unit in enumerate(self.units, start=1):
                self.findings[unit] = await self._ask(unit)
                progress("asking", count, len(self.units))
            await self._wait_for_late_answers()
            unknown = self._unknown()
            for count, unit in enumerate(unknown, start=1):
                self.findings[unit] = await self._identified(self.findings[unit])
                progress("identifying", count, len(unknown))
        except LinkDown as error:
            if not self._was_open:
                raise
            self.problem = str(error)
        finally:
            self._bus.close()

    @property
    def late_units(self) -> list[int]:
        """Over TCP and UDP, the units of answers that came too late, as often as they did."""
        return self._bus.late_units

    async def _wait_for_late_answers(self) -> None:
        """Each unit's answer may come in the time-out of the next one; behind the last is none."""
        left = self._silent_at + self._bus.timing.timeout / 1e9 - self._now()
        if left > 0 and not self._is_line and self._bus.is_open:
            await asyncio.sleep(left)

    @staticmethod
    def _now() -> float:
        return asyncio.get_running_loop().time()

    @property
    def alike(self) -> frozenset[int]:
        """Units of a server that says the same for most of them: it may not look at the unit."""
        groups: dict[bytes, list[int]] = {}
        for finding in self.findings.values():
            if finding.is_there and not finding.devices:
                groups.setdefault(finding.pdu, []).append(finding.unit)
        most = max(groups.values(), key=len, default=[])
        if self._is_line or len(most) < max(_LEAST_ALIKE, len(self.findings) / 2):
            return frozenset()
        return frozenset(most)

    def _unknown(self) -> list[int]:
        """Units to identify; of those that are alike, the first."""
        alike = sorted(self.alike)
        return [
            finding.unit
            for finding in self.findings.values()
            if finding.is_there and not finding.devices
            if finding.unit not in alike[1:]
        ]

    async def _ask(self, unit: int) -> Finding:
        """What was spoilt is asked for once more: the answer of another may have been late."""
        devices = [device for device in self._devices if device.unit == unit]
        finding = await self._ask_once(unit, devices)
        if finding.state is State.UNCLEAR:
            finding = await self._ask_once(unit, devices)
        return replace(finding, devices=tuple(device.name for device in devices))

    async def _ask_once(self, unit: int, devices: list[Device]) -> Finding:
        roc = next((d for d in devices if d.profile.name == hiac_roc.REGISTER_MAP.name), None)
        request = ReportServerId() if roc is None else read_request(hiac_roc.IDENTITY)
        tally = Tally()
        try:
            pdu = await self._transact(unit, request, tally)
        except LinkDown as error:
            self._count_loss(error, tally)
            return Finding(unit, State.UNCLEAR, self._words(error))
        except ExceptionAnswer as refusal:
            is_gateway = refusal.code in GATEWAY_CODES and not self._is_line
            state = State.ABSENT if is_gateway else State.ANSWERS
            octets = bytes([refusal.function | EXCEPTION_BIT, refusal.code])
            text = str(refusal).partition(" to function")[0]
            return Finding(unit, state, text, octets, refusal.code)
        except WrongAnswer as error:
            return self._wrong(unit, error)
        except DeviceError as error:
            spoilt = tally.crc_errors or not tally.requests
            self._silent_at = self._now()
            return Finding(unit, State.UNCLEAR if spoilt else State.SILENT, self._words(error))
        if roc is not None:
            return Finding(unit, State.ANSWERS, "identity", pdu, identity=_roc_text(roc, pdu))
        text = server_text(server_id(pdu))
        return Finding(unit, State.ANSWERS, "server id", pdu, identity=text)

    def _wrong(self, unit: int, error: WrongAnswer) -> Finding:
        """An intact answer of another kind. On a line it may be another unit's, which is late."""
        if not self._is_line:
            state = State.UNCLEAR if error.is_strange else State.ANSWERS
            return Finding(unit, state, self._words(error), b"" if error.is_strange else error.raw)
        sender, pdu = error.raw[0], error.raw[1:-2]
        if sender == unit:
            return Finding(unit, State.ANSWERS, self._words(error), pdu)
        before = self.findings.get(sender)
        if before is not None and not before.is_there:
            answer = f"too late, when unit {unit} was asked"
            self.findings[sender] = replace(before, state=State.ANSWERS, answer=answer, pdu=pdu)
        return Finding(unit, State.UNCLEAR, f"an answer of unit {sender}")

    def _words(self, error: DeviceError) -> str:
        return str(error).removeprefix(f"{self._bus.link.name}: ")

    async def _identified(self, finding: Finding) -> Finding:
        """With its device identification, where it has one.

        A TCP server that does not know how long this request is takes what follows for another
        one. So nothing follows on its connection.
        """
        found: dict[int, str] = {}
        following: int | None = 0
        while following is not None and len(found) < _BASIC_OBJECTS:
            tally = Tally()
            try:
                request = ReadDeviceIdentification(following)
                pdu = await self._transact(finding.unit, request, tally)
            except LinkDown as error:
                self._count_loss(error, tally)
                break
            except DeviceError:
                break
            finally:
                if self._bus.timing.framing is Framing.MBAP_STREAM:
                    self._bus.close()
            texts, following = objects(pdu)
            if not texts.keys() - found.keys():
                break
            found |= texts
        text = ", ".join(filter(None, found.values())) or finding.identity
        return replace(finding, identity=text, identification=tuple(sorted(found.items())))

    async def _transact(self, unit: int, request: Request, tally: Tally) -> bytes:
        """The PDU of the answer; raises as Bus.transact.

        A link that was lost is waited for, where nothing was sent yet.
        """
        for pause in (*_REOPENING, None):
            try:
                pdu = (await self._bus.transact(unit, request, tally)).pdu
            except LinkDown:
                if tally.requests or not self._was_open or pause is None:
                    raise
                await asyncio.sleep(pause)
            except DeviceError:
                self._losses = 0
                raise
            else:
                self._losses = 0
                return pdu
            finally:
                self._was_open |= tally.requests > 0
                self._count_strays(tally)
        raise AssertionError("the last attempt returns or raises")

    def _count_strays(self, tally: Tally) -> None:
        self.stray_octets += tally.discarded_octets if self._is_line else 0

    def _count_loss(self, error: LinkDown, tally: Tally) -> None:
        """Raises the error where it is of no use to go on."""
        self._losses += 1
        if not tally.requests or self._losses >= _MOST_LOSSES:
            raise error


def refusal(settings: Settings, name: str) -> str:
    """Why the connection must not be scanned; empty where it may be."""
    wanted = settings.connections[name]
    for device in settings.devices.values():
        connection = settings.connections[device.connection]
        if not device.profile.dialect.has_functions or connection.port != wanted.port:
            continue
        same = connection.host.lower() == wanted.host.lower()
        if same or not _addresses(connection.host).isdisjoint(_addresses(wanted.host)):
            return (
                f"{name} is not scanned: {device.name} ({device.profile.name}) is there, whose "
                "registers are functions, and a request may call one"
            )
    return ""


def _addresses(host: str) -> set[str]:
    """Of a host; none where its name is not known."""
    try:
        return {str(address[0]) for *_, address in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError):
        return set()


def questions(connection: Connection) -> tuple[int, ...]:
    """Units that are asked where nothing else is said."""
    return tuple(SERIAL_UNITS) if connection.is_serial else SERVER_UNITS


def hurried(connection: Connection, timeout: int | None) -> Connection:
    """With another time-out, and late answers waited for accordingly; None leaves it as it is."""
    if timeout is None:
        return connection
    late_answer = None if connection.late_answer is None else 2 * timeout
    return replace(connection, timeout=timeout, late_answer=late_answer)


def silent_cost(connection: Connection) -> int:
    """Nanoseconds that a unit which does not answer takes.

    On a line nothing is sent while its answer may still come.
    """
    waited = max(connection.timeout, connection.silence)
    return max(_QUESTION * connection.character + waited, connection.late_answer or 0)


def open_scan(
    settings: Settings, connection: Connection, units: Iterable[int], clock: Clock
) -> Scan:
    """connection: of the settings, perhaps hurried."""
    devices = [d for d in settings.devices.values() if d.connection == connection.name]
    return Scan(make_bus(connection, [], clock), units, devices)


def _roc_text(device: Device, pdu: bytes) -> str:
    block = hiac_roc.IDENTITY
    values = decode(block, block_words(block, pdu[2:]), device.word_order).values
    texts = (value.strip() for value in values if isinstance(value, str))
    return ", ".join(filter(None, texts))

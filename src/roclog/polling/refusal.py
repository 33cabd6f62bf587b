"""A refusal in words, with what the device itself says of it where that can be asked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roclog.errors import GATEWAY_CODES, DeviceError, ExceptionAnswer
from roclog.modbus.functions import (
    REMOTE_EXECUTION_ERROR,
    command_status,
    status_request,
)

if TYPE_CHECKING:
    from roclog.bus.bus import Bus
    from roclog.bus.tally import Tally
    from roclog.modbus.dialect import Dialect


def is_refusal(error: DeviceError) -> bool:
    """The device itself said no. A gateway's word for a silent device is a time-out."""
    return isinstance(error, ExceptionAnswer) and error.code not in GATEWAY_CODES


async def described(
    refusal: ExceptionAnswer, unit: int, bus: Bus, tally: Tally, dialect: Dialect
) -> str:
    """Where a register is a function, ask for the status of the last call: at once, and once.

    Does not raise DeviceError: the refusal is what is to be told.
    """
    if not dialect.has_functions:
        return str(refusal)
    text = str(refusal)
    if refusal.code == REMOTE_EXECUTION_ERROR:
        text += ", remote execution error"
    request = status_request(dialect)
    try:
        answer = await bus.transact(unit, request, tally)
    except DeviceError as error:
        return f"{text}; the status of the last call is not known: {error}"
    status = command_status(request.payload(answer.pdu), dialect)
    return f"{text}; status of the last call: {status}"

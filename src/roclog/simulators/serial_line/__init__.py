"""A serial line between two pseudo-terminals on which every octet takes its time.

A pseudo-terminal accepts any baud rate and ignores it. Between the two of this line lies a
half-duplex RS-485 line, worked out in `wire`; any client and any server can be put on either end,
because both are ordinary terminals:

    python -m roclog.simulators.serial_line --baud 9600 --link-a client --link-b server
"""

from roclog.simulators.serial_line.line import SerialLine
from roclog.simulators.serial_line.statistics import Statistics
from roclog.simulators.serial_line.wire import LineSettings

__all__ = ["LineSettings", "SerialLine", "Statistics"]

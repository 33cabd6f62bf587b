"""Simulated devices for trying configurations and for learning; the logger never imports them."""

from roclog.simulators.endpoints import PtyEndpoint, RtuOverTcpEndpoint, TcpEndpoint, UdpEndpoint
from roclog.simulators.hiac_roc import SimulatedRoc
from roclog.simulators.serial_line import LineSettings, SerialLine, Statistics
from roclog.simulators.server import SimulatedDevice, SimulatorServer

__all__ = [
    "LineSettings",
    "PtyEndpoint",
    "RtuOverTcpEndpoint",
    "SerialLine",
    "SimulatedDevice",
    "SimulatedRoc",
    "SimulatorServer",
    "Statistics",
    "TcpEndpoint",
    "UdpEndpoint",
]

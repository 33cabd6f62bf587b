"""Simulated devices for trying configurations and for learning; the logger never imports them."""

from roclog.simulators.endpoints import PtyEndpoint, RtuOverTcpEndpoint, TcpEndpoint, UdpEndpoint
from roclog.simulators.hiac_roc import SimulatedRoc
from roclog.simulators.mei_timestamped import Quirk, SimulatedStampedInputs
from roclog.simulators.mpa_48 import SimulatedMpa48
from roclog.simulators.msx_e3317 import SimulatedMsxE3317
from roclog.simulators.serial_line import LineSettings, SerialLine, Statistics
from roclog.simulators.server import SimulatedDevice, SimulatorServer

__all__ = [
    "LineSettings",
    "PtyEndpoint",
    "Quirk",
    "RtuOverTcpEndpoint",
    "SerialLine",
    "SimulatedDevice",
    "SimulatedMpa48",
    "SimulatedMsxE3317",
    "SimulatedRoc",
    "SimulatedStampedInputs",
    "SimulatorServer",
    "Statistics",
    "TcpEndpoint",
    "UdpEndpoint",
]

"""Starts a ROC as a process of its own."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.process import PATIENCE, Child, until
from bench.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Self

_LAUNCHER = Path(__file__).with_name("roc_process.py")


class Roc:
    """A device with a name. Options are those of tests/peers/roc.py, by their Python names.

    One more is ``under``: a command that runs the device, such as ``ip netns exec``.
    """

    def __init__(
        self, folder: Path, name: str = "roc1", *, line: str = "tcp", **options: Any
    ) -> None:
        under: Sequence[str] = options.pop("under", ())
        self.name = name
        self.line = line
        self.options = options
        self._log = folder / f"{name}.truth.jsonl"
        where = ["--tcp", "127.0.0.1:0"] if line == "tcp" else ["--pty", str(folder / name)]
        command = [*under, sys.executable, str(_LAUNCHER), *where, "--truth", str(self._log)]
        for key, value in options.items():
            if value is not False:
                command.append("--" + key.replace("_", "-"))
                if value is not True:
                    command.append(str(value))
        self.child = Child(command, folder / f"{name}.peer")
        try:
            said = until(lambda: self._listening() or self.child.code, f"{name} to listen")
            assert isinstance(said, str), self.child.talk()
        except BaseException:
            self.child.kill()
            raise
        self.address = said.split()[1]

    @property
    def truth(self) -> Truth:
        return Truth(self._log)

    def wait_for(self, event: str, number: int = 1, seconds: float = PATIENCE) -> None:
        until(lambda: self.truth.count(event) >= number, f"{number} x {event}", seconds)

    def wait(self, seconds: float) -> Truth:
        """Until it has made its last sample and ended by itself."""
        self.child.wait(seconds)
        return self.truth

    def end(self) -> Truth:
        self.child.stop()
        return self.truth

    def toml(self, connection: str = "", device: str = "") -> str:
        """Its part of a configuration, with further lines for the two tables."""
        where = f'transport = "rtu"\nport = "{self.address}"'
        if self.line == "tcp":
            where = f'transport = "tcp"\nhost = "127.0.0.1"\nport = {self.address}'
        return (
            f"[connections.{self.name}_line]\n{where}\n{connection}\n"
            f'[devices.{self.name}]\nprofile = "hiac-roc"\nconnection = "{self.name}_line"\n'
            f"unit = {self.options.get('unit', 138)}\n{device}\n"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.child.kill()

    def _listening(self) -> str:
        said = self.child.said()
        return said if said.startswith("listening ") and said.endswith("\n") else ""

"""The recorder under test: the real command in a real process."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

from bench.process import Child

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

ROCLOG = (sys.executable, "-m", "roclog")


def roclog(*arguments: object, seconds: float = 60) -> subprocess.CompletedProcess[str]:
    """Run another command to its end."""
    command = [*ROCLOG, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)


class Recorder:
    """One configuration; ``start`` may be called again after the process has ended."""

    def __init__(
        self, folder: Path, *devices: str, segment: str = "1h", directory: Path | None = None
    ) -> None:
        self.folder = folder
        self.directory = directory or folder / "recordings"
        self.config = folder / "roclog.toml"
        self.config.write_text(
            f'[recording]\ndirectory = "{self.directory}"\n'
            f'segment = {{ duration = "{segment}" }}\n' + "\n".join(devices)
        )
        self._starts = 0

    def start(
        self,
        *arguments: str,
        under: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
    ) -> Child:
        """under: a command that runs the recorder, such as strace with its options."""
        self._starts += 1
        command = [*under, *ROCLOG, "record", str(self.config), *arguments]
        log = self.folder / f"recorder{self._starts}"
        return Child(command, log, environment=environment)

    def hot(self) -> list[Path]:
        return sorted((self.directory / "hot").glob("*.mcap"))

    def sealed(self) -> list[Path]:
        return sorted(self.directory.glob("[0-9]*/*/*/*.mcap"))

    def wait_for_hot(self, child: Child) -> None:
        """The first segment is open: it records."""
        child.while_it_runs(self.hot, "the first segment")

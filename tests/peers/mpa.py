"""An Insite IG MPA-48 to test a logger with: relays and sensors that change, faults on demand."""

from __future__ import annotations

import asyncio

from mpa_model import Model
from mpa_options import Options, parse_options
from roc_links import Faults as LinkFaults
from served import Served


class Faults(LinkFaults):
    """With short answers and those of another unit."""

    def __init__(self, options: Options) -> None:
        more = {"short": options.short, "other_unit": options.other_unit}
        super().__init__(options)  # type: ignore[arg-type]
        ok = self._fates.index("ok")
        self._weights[ok] = max(0.0, self._weights[ok] - sum(more.values()))
        self._fates += more
        self._weights += more.values()


class MpaDevice(Served):
    def __init__(self, options: Options) -> None:
        super().__init__(options)
        self.model: Model = Model(options, self.truth)

    def faults(self) -> Faults:
        return Faults(self.options)

    def begin(self) -> None:
        """Everything changes at every multiple of the period, whatever the load is."""
        period = self.options.period
        if period <= 0:
            return
        loop = asyncio.get_running_loop()
        started = loop.time()

        def change(n: int) -> None:
            self.model.change()
            loop.call_at(started + (n + 1) * period, change, n + 1)

        loop.call_at(started + period, change, 1)


if __name__ == "__main__":
    MpaDevice(parse_options()).process()

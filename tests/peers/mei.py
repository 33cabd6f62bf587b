"""A device with time-stamped inputs to test a logger with: events at a rate, faults on demand."""

from __future__ import annotations

import asyncio

from mei_model import Model
from mei_options import Options, parse_options
from roc_links import Faults
from roc_options import rng
from served import Served


class Events:
    """Event k comes at about k / rate seconds, whatever the load is."""

    def __init__(self, options: Options, model: Model) -> None:
        self._options = options
        self._model = model
        self._random = rng(options.seed, "schedule")
        self._loop = asyncio.get_running_loop()
        self._started = self._loop.time()
        self._k = 0

    def start(self) -> None:
        if self._options.rate > 0 and self._k != (self._options.events or -1):
            self._k += 1
            due = self._started + (self._k + self._random.uniform(-0.5, 0.5)) / self._options.rate
            self._loop.call_at(due, self._happen)

    def _happen(self) -> None:
        self._model.event()
        self.start()


class MeiDevice(Served):
    def __init__(self, options: Options) -> None:
        super().__init__(options)
        self.model = Model(options, self.truth)

    def faults(self) -> Faults:
        return Faults(self.options)

    def begin(self) -> None:
        Events(self.options, self.model).start()


if __name__ == "__main__":
    MeiDevice(parse_options()).process()

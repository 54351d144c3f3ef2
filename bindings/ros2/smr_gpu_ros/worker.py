"""`Worker`: a thread that takes the images that wait, so that the executor never does."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Job = TypeVar("Job")


class Worker(Generic[Job]):
    """Calls `work` with one job after the other, in a thread of its own.

    Args:
        work: must not raise.
        room: jobs that may wait; the oldest is dropped for a new one.
    """

    def __init__(self, work: Callable[[Job], None], room: int) -> None:
        self._work = work
        self._room = room
        self._dropped = 0
        self._waiting: deque[Job] = deque()
        self._stopped = False
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="detector")
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Jobs that were dropped since the start."""
        return self._dropped

    def put(self, job: Job) -> None:
        """Adds a job; returns at once."""
        with self._change:
            self._waiting.append(job)
            self._drop()
            self._change.notify()

    def set_room(self, room: int) -> None:
        """Changes how many jobs may wait, at least 1."""
        with self._change:
            self._room = room
            self._drop()

    def stop(self) -> None:
        """Ends the thread behind the job that it does; those that wait are left."""
        with self._change:
            self._stopped = True
            self._change.notify()
        self._thread.join()

    def _drop(self) -> None:
        while len(self._waiting) > self._room:
            self._waiting.popleft()
            self._dropped += 1

    def _run(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._waiting or self._stopped)
                if self._stopped:
                    return
                job = self._waiting.popleft()
            self._work(job)

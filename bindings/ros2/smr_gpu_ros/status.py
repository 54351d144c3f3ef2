"""`Status`: counts what happens to images and tells it as a diagnostic."""

import threading
import time
from statistics import mean

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue


class Status:
    """Counters that several threads may change."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received = self._answered = self._drawn = self._failed = self._lost = 0
        self._last_error = ""
        # Since the last report.
        self._since = time.monotonic()
        self._recent_received = 0
        self._recent_s: list[float] = []
        self._recent_fault = ""

    def received(self) -> None:
        """An image came."""
        with self._lock:
            self._received += 1
            self._recent_received += 1

    def answered(self, seconds: float) -> None:
        """Its detections are published, so long after it came."""
        with self._lock:
            self._answered += 1
            self._recent_s.append(seconds)

    def drew(self) -> None:
        """A drawn image is published."""
        with self._lock:
            self._drawn += 1

    def failed(self, error: str) -> None:
        """An image has no answer."""
        with self._lock:
            self._failed += 1
            self._last_error = self._recent_fault = error

    def fault(self, error: str) -> None:
        """Something else went wrong."""
        with self._lock:
            self._last_error = self._recent_fault = error

    def lost(self, count: int) -> None:
        """So many images were lost on their way to the node."""
        with self._lock:
            self._lost += count

    def report(self, dropped: int, problem: str, remark: str, facts: dict[str, str]) -> DiagnosticStatus:
        """What happened since the last report, and in all.

        Args:
            dropped: images that were dropped since the start.
            problem: why no image can be answered, or nothing.
            remark: what to know about answers, or nothing.
            facts: further values.
        """
        with self._lock:
            now = time.monotonic()
            seconds, self._since = now - self._since, now
            recent, self._recent_s = self._recent_s, []
            came, self._recent_received = self._recent_received, 0
            fault, self._recent_fault = self._recent_fault, ""
            values = {
                "images a second": f"{came / seconds:.1f}",
                "answers a second": f"{len(recent) / seconds:.1f}",
                "latency, mean, ms": f"{1e3 * mean(recent):.1f}" if recent else "",
                "latency, longest, ms": f"{1e3 * max(recent):.1f}" if recent else "",
                "received": str(self._received),
                "answered": str(self._answered),
                "drawn": str(self._drawn),
                "dropped": str(dropped),
                "failed": str(self._failed),
                "lost on the way": str(self._lost),
                "last error": self._last_error,
                **facts,
            }
        if problem or fault:
            level, message = DiagnosticStatus.ERROR, problem or fault
        elif not came:
            level, message = DiagnosticStatus.WARN, "no image came"
        elif remark:
            level, message = DiagnosticStatus.WARN, remark
        else:
            level, message = DiagnosticStatus.OK, "images are answered"
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        return DiagnosticStatus(level=level, message=message, values=pairs)
